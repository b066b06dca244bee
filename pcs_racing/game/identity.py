"""Identity of a game: archive, moves and observations of a network, an agent, a fit or a tree."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError, check_names, check_text, check_whole
from pcs_racing.game.moves import STAY
from pcs_racing.race.config import check_epsilon


class GameIdentity(NamedTuple):
    """The game of an artifact, as plain values that a manifest can hold; any track belongs to it.

    A manifest need not record all of it: names of elements and moves follow from the archive,
    epsilon and the number of decisions. A value that is not recorded is empty or 0, and is not
    compared.
    """

    #: Names of the numbers of an observation, in order: the encoding of a history.
    elements: tuple[str, ...]
    moves: tuple[str, ...]  #: Names of the moves, in order.
    epsilon: tuple[float, ...]  #: Lengths of the moves, in units of the archive's range.
    archive: str  #: Name of the archive of policies.
    archive_sha256: str  #: Hash of the archive, :attr:`pcs_racing.game.PolicyArchive.content_hash`.
    rules: str  #: Name of the rules.
    decisions: int = 0  #: Number of moves of each player.


def plain_identity(identity: GameIdentity) -> dict[str, Any]:
    """Return the recorded values of an identity, for a manifest."""
    values = {key: value for key, value in identity._asdict().items() if value}
    return {key: list(one) if isinstance(one, tuple) else one for key, one in values.items()}


def read_identity(values: Mapping[str, Any]) -> GameIdentity:
    """Return the identity of a game from plain values, such as a manifest's."""
    for key in ("epsilon", "archive", "archive_sha256", "rules"):
        if key not in values:
            raise InputError(f"a description of a game lacks {key!r}")
    return GameIdentity(
        elements=check_names("elements", values["elements"]) if "elements" in values else (),
        moves=check_names("moves", values["moves"]) if "moves" in values else (),
        epsilon=check_epsilon(values["epsilon"]),
        archive=check_text("archive", values["archive"]),
        archive_sha256=check_text("archive_sha256", values["archive_sha256"]),
        rules=check_text("rules", values["rules"]),
        decisions=check_whole("decisions", values.get("decisions", 0), 0),
    )


def check_same_game(
    own: GameIdentity, other: GameIdentity, owner: str, other_owner: str = "the game"
) -> None:
    """Check that two games have the same number of moves, observations, moves and archive.

    The move "stay" is not compared: a player may always stay, and a player without "stay" plays
    the same game. The names of rules and archive may differ: an artifact made under other rules may
    be tried. The owners name the artifacts or games in the message.
    """
    if own.decisions and other.decisions and own.decisions != other.decisions:
        raise InputError(
            f"{owner} was made for games of {own.decisions} moves; {other_owner} has"
            f" {other.decisions}"
        )
    if own.elements and own.elements != other.elements:
        raise InputError(
            f"{owner} {_difference(own.elements, other.elements, 'sees', other_owner)}"
        )
    mine, theirs = (tuple(one for one in game.moves if one != STAY) for game in (own, other))
    if own.moves and mine != theirs:
        raise InputError(f"{owner} {_difference(mine, theirs, 'values moves', other_owner)}")
    if own.epsilon != other.epsilon:
        raise InputError(
            f"{owner} was made for moves of epsilon {_list(own.epsilon)}; {other_owner} has"
            f" {_list(other.epsilon)}"
        )
    if own.archive_sha256 != other.archive_sha256:
        raise InputError(
            f"{owner} was made for archive {own.archive!r} (sha256 {own.archive_sha256[:12]}); "
            f"{other_owner} has archive {other.archive!r} (sha256 {other.archive_sha256[:12]})"
        )


def _list(values: Sequence[Any]) -> str:
    return ", ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _difference(own: tuple[str, ...], other: tuple[str, ...], verb: str, other_owner: str) -> str:
    """Return a clause that names the first difference between two lists of names."""
    if len(own) != len(other):
        return f"{verb} {_short(own)}; {other_owner} has {_short(other)}"
    i = next(i for i, (a, b) in enumerate(zip(own, other, strict=True)) if a != b)
    return f"{verb} {own[i]!r} at place {i}; {other_owner} has {other[i]!r} there"


def _short(names: tuple[str, ...]) -> str:
    return (
        f"{len(names)} ({_list(names)})"
        if len(names) <= 6
        else f"{len(names)} ({names[0]} to {names[-1]})"
    )
