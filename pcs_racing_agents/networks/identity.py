"""Which game a network or a tree belongs to: what is seen, which moves there are, and between which policies."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError
from pcs_racing.game.rules import RaceGame

__all__ = ["GameIdentity", "check_same_game", "game_identity"]


class GameIdentity(NamedTuple):
    """What a network must know of the game that it was made for.

    Attributes
    ----------
    elements : tuple of str
        Names of the numbers of an observation, in order: the encoding of a history.
    moves : tuple of str
        Names of the moves, in order.
    epsilon : tuple of float
        How far the moves go.
    archive : str
        Name of the archive of policies.
    archive_sha256 : str
        Its :attr:`pcs_racing.PolicyArchive.content_hash`.
    preset : str
        Name of the rules of the race.
    """

    elements: tuple[str, ...]
    moves: tuple[str, ...]
    epsilon: tuple[float, ...]
    archive: str
    archive_sha256: str
    preset: str


def game_identity(game: RaceGame) -> GameIdentity:
    """Return what networks and trees keep of the game that they belong to."""
    epsilon = game.config.epsilon
    return GameIdentity(
        elements=tuple(element.name for element in game.observation_elements),
        moves=game.move_names,
        epsilon=epsilon if isinstance(epsilon, tuple) else (epsilon,),
        archive=game.archive.name,
        archive_sha256=game.archive.content_hash,
        preset=game.config.race.name,
    )


def check_same_game(own: GameIdentity, other: GameIdentity, who: str, what: str) -> None:
    """Check that another game shows the same, and has the same moves on the same archive.

    The other may have the move "stay" in addition. The preset and the archive's name may differ.

    Parameters
    ----------
    own, other : GameIdentity
    who, what : str
        What they belong to, for the message.

    Raises
    ------
    InputError
        If it does not; the first difference is named.
    """
    if own.elements != other.elements:
        raise InputError(f"{who} {_difference(own.elements, other.elements, 'sees', what)}")
    if other.moves not in (own.moves, (*own.moves, "stay")):
        raise InputError(f"{who} {_difference(own.moves, other.moves, 'values moves', what)}")
    if own.epsilon != other.epsilon:
        raise InputError(f"{who} was made for moves of epsilon {_list(own.epsilon)}; {what} has {_list(other.epsilon)}")
    if own.archive_sha256 != other.archive_sha256:
        raise InputError(
            f"{who} was made for archive {own.archive!r} (sha256 {own.archive_sha256[:12]}); "
            f"{what} has archive {other.archive!r} (sha256 {other.archive_sha256[:12]})"
        )


def _list(values: Sequence[Any]) -> str:
    return ", ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _difference(own: tuple[str, ...], other: tuple[str, ...], verb: str, what: str) -> str:
    """Say in a clause where two lists of names differ first."""
    if len(own) != len(other):
        return f"{verb} {_short(own)}; {what} has {_short(other)}"
    i = next(i for i, (a, b) in enumerate(zip(own, other, strict=True)) if a != b)
    return f"{verb} {own[i]!r} at place {i}; {what} has {other[i]!r} there"


def _short(names: tuple[str, ...]) -> str:
    return f"{len(names)} ({_list(names)})" if len(names) <= 6 else f"{len(names)} ({names[0]} to {names[-1]})"
