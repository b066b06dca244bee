"""Identity of a game: archive, moves and observations of a network, an agent, a fit or a tree."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.config import GameConfig
from pcs_racing.game.moves import STAY, move_names
from pcs_racing.game.observation import observation_elements


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
    preset: str  #: Name of the rules of the race.
    decisions: int = 0  #: Number of moves of each player.


class _HasRules(Protocol):
    """A game, or an archive with rules; the archive has the axes of the game."""

    @property
    def archive(self) -> PolicyArchive: ...

    @property
    def config(self) -> GameConfig: ...


def game_identity(game: _HasRules) -> GameIdentity:
    """Return the identity of a game, or of an agent's archive and rules."""
    archive, config = game.archive, game.config
    names = move_names(archive, config.epsilon)
    elements = observation_elements(get_characteristics(archive.characteristics), config.moves)
    return GameIdentity(
        elements=tuple(element.name for element in elements),
        moves=names if config.stay else names[:-1],
        epsilon=config.epsilon if isinstance(config.epsilon, tuple) else (config.epsilon,),
        archive=archive.name,
        archive_sha256=archive.content_hash,
        preset=config.race.name,
        decisions=config.moves,
    )


def check_same_game(
    own: GameIdentity, other: GameIdentity, owner: str, other_owner: str = "the game"
) -> None:
    """Check that two games have the same number of moves, observations, moves and archive.

    The other game may have the move "stay" in addition. The preset and the archive's name may
    differ: an artifact made under other rules of the race may be tried. The owners name the
    artifacts or games in the message.
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
    # The move "stay" can always be offered: a player that never stays plays the same game.
    if own.moves and other.moves not in (own.moves, (*own.moves, STAY)):
        raise InputError(
            f"{owner} {_difference(own.moves, other.moves, 'values moves', other_owner)}"
        )
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
