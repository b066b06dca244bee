"""Competitors: the players of a game, and the only function that asks for their moves.

A competitor has one of these kinds:

- a **predictor**: ``predict(observation, state, episode_start, deterministic)``, as in models of
  Stable-Baselines3;
- a **decider**: ``decide(game, state, car)``, for a search with the simulator;
- a **function** ``f(observation, generator) -> move``;
- a **fixed policy**, which makes no moves: a :class:`PolicySet` or a single
  :class:`~pcs_racing.planners.planner.Policy`;
- a **chooser**: ``choose(observation)``, which chooses a policy before each race of a match
  (:mod:`pcs_racing.game.match`). It keeps that policy in the races of a match. In a single game, a
  competitor that is only a chooser also keeps its policy.

Competitors may always stay, whatever moves the rules offer:
:attr:`pcs_racing.game.rules.RaceGame.competitor_moves`.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.game.competitor_collections import collections
from pcs_racing.game.moves import check_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.planners.own_files import one_line
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy, planner_names
from pcs_racing.planners.shipped import split_name

Observation = NDArray[np.float32]
Function = Callable[[Observation, np.random.Generator], Any]


@runtime_checkable
class Predictor(Protocol):
    """A model that predicts moves in a batch of games, with the interface of Stable-Baselines3."""

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return moves for observations, shape (n, D), and the state for the next call, or None."""


@runtime_checkable
class Decider(Protocol):
    """A competitor that decides by the whole state of a game, such as a search."""

    name: str

    def decide(self, game: RaceGame, state: GameState, car: int) -> ArrayLike:
        """Return the moves of one car in B games, shape (B,); games are decided independently."""


@runtime_checkable
class Chooser(Protocol):
    """A player of a match that chooses the policy of each race before its start."""

    def choose(self, observation: Observation) -> ArrayLike:
        """Return policies of the archive, shape (n,), for observations of n matches, shape (n, D).

        :func:`pcs_racing.game.observation.match_elements` defines the D numbers.
        """


@dataclass(frozen=True, eq=False)
class RandomMoves:
    """A competitor with moves drawn uniformly from the allowed moves, by the game's generator."""

    name: str = "random-moves"


@dataclass(frozen=True)
class SameMove:
    """A competitor that always makes the same move."""

    name: str
    move: int

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], None]:
        """Return the move for each observation."""
        return np.full(len(observation), self.move), None


@dataclass(frozen=True, eq=False)
class PolicySet:
    """A competitor without moves: one of its policies, drawn for each game, drives to the end."""

    name: str
    policies: tuple[Policy, ...]  #: Policies of one planner, at least one.


Competitor = Predictor | Decider | PolicySet | RandomMoves | Policy | Chooser | Function
"""Competitors of all kinds."""


def competitor_name(competitor: Any) -> str:
    """Return a competitor's name: its own, or the name of its function or class."""
    name = getattr(competitor, "name", None) or getattr(competitor, "__name__", None)
    return name if isinstance(name, str) else type(competitor).__name__


def driver_policies(competitor: Any) -> tuple[Policy, ...]:
    """Return the policies of a competitor that makes no moves; none for other competitors."""
    if isinstance(competitor, Policy):
        return (competitor,)
    return competitor.policies if isinstance(competitor, PolicySet) else ()


def is_model(candidate: Any) -> bool:
    """Return whether an object is a model for steering and speed.

    Such models are a ``.zip``, a torch module, or a model with two numbers in an action.
    """
    if isinstance(candidate, str | Path):
        return str(candidate).endswith(".zip")
    torch = sys.modules.get("torch")
    space = getattr(candidate, "action_space", None)
    plain = (
        torch is not None
        and isinstance(candidate, torch.nn.Module)
        and not hasattr(candidate, "predict")
    )
    return plain or (hasattr(candidate, "predict") and getattr(space, "shape", None) == (2,))


def check_competitor(game: RaceGame, competitor: Any) -> None:
    """Check, before any race, that a competitor can take part in a game.

    The check calls the competitor's method ``check_fits(game)``, if there is one, and compares
    ``observation_space`` and ``action_space`` of a model.
    """
    # arrays have a method `choose`, too
    if isinstance(competitor, type | np.ndarray | np.generic) or not (
        isinstance(competitor, RandomMoves | Predictor | Decider | PolicySet | Policy | Chooser)
        or callable(competitor)
    ):
        raise InputError(
            f"{competitor!r} is not a competitor; it must be a policy, have predict(observation,"
            " state, episode_start, deterministic), decide(game, state, car) or"
            " choose(observation), or be a PolicySet or a function of (observation, generator)"
        )
    if hasattr(competitor, "check_fits"):
        competitor.check_fits(game)
    # An agent around a model of Stable-Baselines3 has no spaces of its own.
    model = getattr(competitor, "model", competitor)
    size, moves = len(game.observation_elements), game.competitor_moves
    shape = getattr(getattr(model, "observation_space", None), "shape", None)
    if shape is not None and tuple(shape) != (size,):
        raise InputError(
            f"competitor {competitor_name(competitor)!r} takes observations of shape"
            f" {tuple(shape)}; in this game they have shape ({size},)"
        )
    count = getattr(getattr(model, "action_space", None), "n", None)
    if count is not None and int(count) > len(moves):
        raise InputError(
            f"competitor {competitor_name(competitor)!r} has {int(count)} moves; this game has"
            f" {len(moves)} ({', '.join(moves)})"
        )


def ask_moves(
    competitor: Any,
    game: RaceGame,
    state: GameState,
    car: int,
    *,
    rows: NDArray[np.int64] | None = None,
    observation: Observation | None = None,
    memories: list[Any] | None = None,
    generators: Sequence[np.random.Generator] | None = None,
    deterministic: bool = True,
) -> NDArray[np.int64]:
    """Ask a competitor for the moves of one car in a batch of B games.

    Returns indices in :attr:`RaceGame.competitor_moves`, shape (B,); 0 for a fixed policy and in
    games without a request.

    The request covers the games ``rows``, by default all, except finished games. ``observation``,
    shape (B, D), is the car's observation, if it is known already. ``memories``, of length B, are
    overwritten: the state that a predictor returned for its next call in each game, None at a
    game's beginning; without them each call is a predictor's first. Functions and
    :class:`RandomMoves` draw from the ``generators`` of the games. A predictor that is not
    ``deterministic`` draws its move, by a generator of its own, instead of taking the best move.
    """
    names = game.competitor_moves
    moves = np.zeros(state.games, np.int64)
    if driver_policies(competitor):
        return moves
    going = ~game.done(state)
    rows = np.flatnonzero(going) if rows is None else rows[going[rows]]
    if len(rows) == 0:
        return moves
    answer: Any
    player = f"competitor {competitor_name(competitor)!r}"
    with one_line(player):  # any error of their code
        if isinstance(competitor, RandomMoves):
            allowed = [np.flatnonzero(mask) for mask in game.action_mask(state)[rows, car]]
            drawn = [
                each[generators[row].integers(len(each))]
                for row, each in zip(rows, allowed, strict=True)
            ]  # type: ignore[index]
            answer = np.array(drawn)
        elif isinstance(competitor, Decider):
            answer = competitor.decide(game, take_games(state, rows), car)
        # A mere chooser keeps its policy; a chooser that can also predict is asked below.
        elif isinstance(competitor, Chooser) and not isinstance(competitor, Predictor):
            answer = np.full(len(rows), len(names) - 1)  # stay
        else:
            seen = (game.observation(state)[:, car] if observation is None else observation)[rows]
            if isinstance(competitor, Predictor):
                answer = _predicted(competitor, seen, rows, memories, deterministic)
            else:
                answer = [
                    competitor(one, generators[row]) for row, one in zip(rows, seen, strict=True)
                ]  # type: ignore[index]
    moves[rows] = check_moves(answer, names, rows.shape, ("game",), rows=rows, player=player)
    return moves


def _predicted(
    competitor: Predictor,
    seen: Observation,
    rows: NDArray[np.int64],
    memories: list[Any] | None,
    deterministic: bool,
) -> Any:
    """Return the moves of a predictor.

    A predictor with a state is asked game by game, because games begin at different times.
    """
    kept = [None] * len(rows) if memories is None else [memories[row] for row in rows]
    # One call for all games, unless the answer shows that the predictor has a state.
    if all(memory is None for memory in kept):
        moves, memory = _answer(competitor, seen, None, np.ones(len(rows), np.bool_), deterministic)
        if memory is None or memories is None:
            return moves
    asked: list[Any] = []
    for row, one, memory in zip(rows, seen, kept, strict=True):
        move, memories[row] = _answer(
            competitor, one[None], memory, np.array([memory is None]), deterministic
        )  # type: ignore[index]
        asked.append(move[0])
    return asked


def _answer(
    competitor: Predictor,
    seen: Observation,
    memory: Any,
    first: NDArray[np.bool_],
    deterministic: bool,
) -> tuple[NDArray[Any], Any]:
    answer = competitor.predict(seen, memory, first, deterministic)
    try:
        moves, after = answer
        return np.asarray(moves).reshape(len(seen)), after
    except (TypeError, ValueError):
        raise InputError(
            f"competitor {competitor_name(competitor)!r}: predict returned {answer!r:.80}; it must"
            f" return a pair: {len(seen)} moves, and a state or None"
        ) from None


NEVER_SWITCH = "never-switch"
RANDOM_MOVES = "random-moves"
ALWAYS = "always-"


def competitor_names(game: RaceGame) -> list[str]:
    """Return the sorted names of all competitors for a game; planner policies have more forms."""
    names = {NEVER_SWITCH, RANDOM_MOVES, *planner_names()}
    names |= {ALWAYS + move for move in game.competitor_moves}
    for collection in collections():
        names |= {
            name
            for name in collection.names(game.archive, game.config)
            if not name.startswith(ALWAYS)
        }
    return sorted(names)


def make_competitor(text: str, game: RaceGame) -> Competitor:
    """Make a competitor for a game from its name.

    "never-switch": a policy of the archive, drawn for each game and kept; "random-moves";
    "always-<move>"; a policy such as "lattice:pace=0.8"; or the name of a registered competitor,
    such as "cfr-argmax", with its options, or a model's file, "model.zip".
    """
    if text == RANDOM_MOVES:
        return RandomMoves()
    if text == NEVER_SWITCH:
        return PolicySet(text, tuple(game.archive.policy(i) for i in range(len(game.archive))))
    if text.startswith(ALWAYS):
        wanted = "".join(text.removeprefix(ALWAYS).split())
        for i, move in enumerate(game.competitor_moves):
            if "".join(move.split()) == wanted:
                return SameMove(f"{ALWAYS}{move}", i)
    name = split_name(text)[0]
    if name in planner_names():
        return parse_policy(text)
    # Last: other packages are only imported for names that are not ours.
    for collection in collections():
        if is_model(text) or name in collection.names(game.archive, game.config):
            made: Competitor = collection.make(text, game.archive, game.config)
            return made
    raise UnknownNameError(f"opponent {text!r} is unknown; {choices(text, competitor_names(game))}")
