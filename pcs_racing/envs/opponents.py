"""Who plays against the agent of a duel: strategies by name, trained models, functions, and mixtures of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy, planner_names

__all__ = ["NEVER_SWITCH", "RANDOM_MOVES", "Opponent", "Predictor", "parse_opponents"]

NEVER_SWITCH = "never-switch"
RANDOM_MOVES = "random-moves"
ALWAYS = "always-"
STAY = "stay"

Observation = NDArray[np.float32]
Mask = NDArray[np.bool_]
Chooser = Callable[[Observation, np.random.Generator], Any]


@runtime_checkable
class Predictor(Protocol):
    """What Stable-Baselines3's models offer, and any strategy may: a move for every observation of a batch."""

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the moves for observations of shape (n, D), and what it wants to be handed the next time."""


@dataclass(frozen=True, eq=False)
class Opponent:
    """One of the opponents that an episode may have.

    Attributes
    ----------
    name : str
        What infos call it.
    weight : float
        How often it is drawn, in relation to the others.
    player : Predictor, callable, int or None
        Who chooses its moves; a whole number makes the same move again and again, None draws moves.
    driver : Policy, NEVER_SWITCH or None
        For an opponent that makes no moves: what it drives with, or that a policy of the archive is drawn.
    """

    name: str
    weight: float
    player: Predictor | Chooser | int | None = None
    driver: Policy | str | None = None


def parse_opponents(given: Any, moves: Sequence[str]) -> list[Opponent]:
    """Read the argument ``opponent`` of a duel.

    Parameters
    ----------
    given : str, Policy, Predictor, callable, or list of (weight, opponent)
    moves : sequence of str
        Names of the game's moves.

    Raises
    ------
    InputError
        If it is none of these, or a weight is impossible.
    UnknownNameError
        If a name is unknown.
    """
    if not isinstance(given, list | tuple):
        return [_one(given, 1.0, moves)]
    if not given:
        raise InputError("opponent is an empty list; give at least one (weight, opponent)")
    opponents = []
    for i, entry in enumerate(given):
        if not isinstance(entry, list | tuple) or len(entry) != 2:
            raise InputError(f"opponent {i} of the mixture is {entry!r}; it must be a pair (weight, opponent)")
        weight = entry[0]
        number = isinstance(weight, int | float | np.integer | np.floating) and not isinstance(weight, bool)
        if not number or not 0.0 < weight < np.inf:
            raise InputError(f"the weight of opponent {i} is {weight!r}; it must be a finite number above 0")
        opponents.append(_one(entry[1], float(weight), moves))
    return opponents


def _one(given: Any, weight: float, moves: Sequence[str]) -> Opponent:
    if isinstance(given, str):
        return _by_name(given, weight, moves)
    if isinstance(given, Policy):
        return Opponent(given.name, weight, driver=given)
    if isinstance(given, Predictor) and not isinstance(given, type):
        _check_moves(given, moves)
        return Opponent(_name(given), weight, player=given)
    if callable(given) and not isinstance(given, type):
        return Opponent(str(getattr(given, "__name__", type(given).__name__)), weight, player=given)
    raise InputError(
        f"opponent {given!r} is no opponent; it must be a name, a policy, an object with predict(observation, state, "
        "episode_start, deterministic), a function of (observation, generator), or a list of (weight, opponent)"
    )


def _check_moves(given: Predictor, moves: Sequence[str]) -> None:
    """Refuse a model that was trained with more moves than there are; others show it when they make such a move."""
    count = getattr(getattr(given, "action_space", None), "n", None)
    if isinstance(count, int | np.integer) and count > len(moves):
        raise InputError(
            f"opponent {_name(given)!r} chooses among {count} moves, and here are {len(moves)} ({', '.join(moves)})"
            + _if_stay("its last is", count - 1, moves)
        )


def _if_stay(what: str, move: int, moves: Sequence[str]) -> str:
    """What to do about a move one beyond those that there are, which probably is "stay"."""
    if move != len(moves) or STAY in moves:
        return ""
    return f"; if {what} 'stay', which these rules do not offer, make the environment with stay=True"


def _name(given: Any) -> str:
    return str(getattr(given, "name", type(given).__name__))


def _by_name(name: str, weight: float, moves: Sequence[str]) -> Opponent:
    if name == RANDOM_MOVES:
        return Opponent(name, weight)
    if name == NEVER_SWITCH:
        return Opponent(name, weight, driver=NEVER_SWITCH)
    if name.startswith(ALWAYS):
        wanted = "".join(name.removeprefix(ALWAYS).split())
        for i, move in enumerate(moves):
            if "".join(move.split()) == wanted:
                return Opponent(f"{ALWAYS}{move}", weight, player=i)
    elif name.partition(":")[0].strip() in planner_names():
        return Opponent(name, weight, driver=parse_policy(name))
    known = [NEVER_SWITCH, RANDOM_MOVES, *(ALWAYS + move for move in moves)]
    raise UnknownNameError(
        f"opponent {name!r} is unknown; there are {', '.join(known)}, and policies of the planners "
        f"{', '.join(planner_names())}"
    )


def choose(
    opponent: Opponent,
    observations: Observation,
    masks: Mask,
    rngs: Sequence[np.random.Generator],
    memories: list[Any],
    deterministic: bool,
) -> list[Any]:
    """Moves of one opponent in several games.

    Parameters
    ----------
    observations : ndarray, shape (n, D)
        What it sees in each of them.
    masks : ndarray, shape (n, M)
        Moves that it may make.
    rngs : sequence of n Generator
        The games' own generators: whatever is drawn is drawn from these.
    memories : list of length n
        What a predictor asked to be handed again in each game, None in a game's first step; overwritten.
    deterministic : bool
        Whether predictors take their best move or draw one (from a generator of their own).
    """
    player = opponent.player
    if opponent.driver is not None:
        return [0] * len(rngs)
    if player is None:
        return [np.flatnonzero(mask)[rng.integers(int(mask.sum()))] for mask, rng in zip(masks, rngs, strict=True)]
    if isinstance(player, int):
        return [player] * len(rngs)
    if not isinstance(player, Predictor):
        return [player(seen, rng) for seen, rng in zip(observations, rngs, strict=True)]
    if all(memory is None for memory in memories):
        moves, memory = _asked(opponent, observations, None, np.ones(len(rngs), np.bool_), deterministic)
        if memory is None:
            return list(moves)
    chosen = []
    for i, seen in enumerate(observations):  # one that remembers is asked game by game
        first = np.array([memories[i] is None])
        moves, memories[i] = _asked(opponent, seen[None], memories[i], first, deterministic)
        chosen.append(moves[0])
    return chosen


def _asked(
    opponent: Opponent, observations: Observation, memory: Any, first: Mask, deterministic: bool
) -> tuple[NDArray[Any], Any]:
    """What a predictor answers: a move for each observation, and what it wants to be handed again."""
    answer = opponent.player.predict(observations, memory, first, deterministic)  # type: ignore[union-attr]
    try:
        moves, after = answer
        return np.asarray(moves).reshape(len(observations)), after
    except (TypeError, ValueError):
        raise InputError(
            f"opponent {opponent.name!r}: predict returned {answer!r:.80}; it must return a pair: "
            f"{len(observations)} moves, and a state or None"
        ) from None


def as_array(value: Any) -> NDArray[Any]:
    """Return what somebody handed over as an array; an empty one of objects where it is none, to be refused by type."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError):  # lists of different lengths
        return np.empty(0, object)


def checked_move(opponent: Opponent, move: Any, moves: Sequence[str]) -> int:
    """Return a move that an opponent chose as the number that it is.

    Raises
    ------
    InputError
        If it is no move of the game.
    """
    value = as_array(move)
    whole = value.shape == () and value.dtype.kind in "iu"
    if not whole or not 0 <= value < len(moves):
        known = f"it must be a whole number from 0 to {len(moves) - 1} ({', '.join(moves)})"
        shown = int(value) if whole else move
        hint = _if_stay("it means", shown, moves) if whole else ""
        raise InputError(f"opponent {opponent.name!r} chose {shown!r:.80}; {known}{hint}")
    return int(value)
