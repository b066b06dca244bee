"""Agents: the protocol of the players of a game, the conversion to it, and the request for moves.

An agent has a ``name`` and a method ``act(observations, turn)``, which returns the moves of one car
in a batch of games (:class:`SupportsAct`). A :class:`PolicySet` also takes part in games, without
moves. :func:`as_agent` converts other objects to one of the two:

- a :class:`~pcs_racing.planners.planner.Policy`, which makes no moves;
- a model with ``predict(observation, state, episode_start, deterministic)``, as in
  Stable-Baselines3;
- a function ``f(observation, generator) -> move``.

Agents may always stay, whatever moves the rules offer:
:attr:`pcs_racing.game.rules.RaceGame.competitor_moves`.
"""

import sys
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_text
from pcs_racing.base.errors import InputError, UnknownNameError, choices, one_line
from pcs_racing.game.moves import check_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy, planner_names
from pcs_racing.planners.shipped import split_name

Observation = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Turn:
    """Games at a move of one car, for agents that need more than their observations."""

    game: RaceGame
    games: GameState  #: Batch that contains the games.
    rows: Indices  #: shape (n,): Indices of the n games in ``games`` and ``generators``.
    car: int  #: Car of the agent, 0 or 1.
    #: Value of the agent for each of the n games, None before its first move; ``act`` may replace
    #: the entries, and the next turn has the new values.
    memories: list[Any]
    generators: Sequence[np.random.Generator]  #: Random generators of the batch.
    deterministic: bool  #: False if a model may draw its moves, by a generator of its own.

    @property
    def state(self) -> GameState:
        """Copy of the states of the n games."""
        return take_games(self.games, self.rows)

    @property
    def stay(self) -> int:
        """Move that keeps the policy."""
        return len(self.game.competitor_moves) - 1


@runtime_checkable
class SupportsAct(Protocol):
    """An agent: a player of the game with a name."""

    @property
    def name(self) -> str:
        """Name in tables."""

    def act(self, observations: Observation, turn: Turn) -> ArrayLike:
        """Return the moves in n games, shape (n,), from observations of shape (n, D).

        Moves are indices of :attr:`RaceGame.competitor_moves`. Each game is decided independently,
        so that batches of all sizes give the same moves.
        """


@dataclass(frozen=True, eq=False)
class PolicySet:
    """A competitor without moves: one of its policies, drawn for each game, drives to the end."""

    name: str
    policies: tuple[Policy, ...]  #: Policies of one planner, at least one.


Competitor = SupportsAct | PolicySet
"""An agent, or policies without moves."""


@dataclass(frozen=True, eq=False)
class RandomMoves:
    """An agent with moves drawn uniformly from the allowed moves, by the game's generator."""

    name: str = "random-moves"

    def act(self, observations: Observation, turn: Turn) -> list[Any]:
        """Return an allowed move for each game."""
        masks = turn.game.action_mask(turn.games)[turn.rows, turn.car]
        allowed = [np.flatnonzero(mask) for mask in masks]
        return [
            moves[turn.generators[row].integers(len(moves))]
            for row, moves in zip(turn.rows.tolist(), allowed, strict=True)
        ]


@dataclass(frozen=True)
class SameMove:
    """An agent that always makes the same move."""

    name: str
    move: int

    def act(self, observations: Observation, turn: Turn | None = None) -> Indices:
        """Return the move for each game."""
        return np.full(len(observations), self.move)


@dataclass(frozen=True, eq=False)
class FunctionAgent:
    """An agent of a function of one observation and the game's generator."""

    name: str
    function: Callable[[Observation, np.random.Generator], Any]

    def act(self, observations: Observation, turn: Turn) -> list[Any]:
        """Return the function's move for each game."""
        return [
            self.function(one, turn.generators[row])
            for row, one in zip(turn.rows, observations, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class ModelAgent:
    """An agent of a model with the method ``predict`` of Stable-Baselines3."""

    name: str
    model: Any

    def act(self, observations: Observation, turn: Turn) -> Any:
        """Return the moves that the model predicts.

        A model with a state is asked game by game, because games begin at different times.
        """
        # One call for all games, unless the answer shows that the model has a state.
        if all(memory is None for memory in turn.memories):
            first = np.ones(len(observations), np.bool_)
            moves, memory = self._predict(observations, None, first, turn)
            if memory is None:
                return moves
        asked = []
        for i, memory in enumerate(turn.memories):
            first = np.array([memory is None])
            move, turn.memories[i] = self._predict(observations[i : i + 1], memory, first, turn)
            asked.append(move[0])
        return asked

    def _predict(
        self, observations: Observation, memory: Any, first: NDArray[np.bool_], turn: Turn
    ) -> tuple[NDArray[Any], Any]:
        answer = self.model.predict(observations, memory, first, turn.deterministic)
        try:
            moves, after = answer
            return np.asarray(moves).reshape(len(observations)), after
        except (TypeError, ValueError):
            raise InputError(
                f"competitor {self.name!r}: predict returned {answer!r:.80}; it must return a"
                f" pair: {len(observations)} moves, and a state or None"
            ) from None


def as_agent(given: Any, name: str | None = None) -> Competitor:
    """Convert an object to an agent, or to policies without moves; agents are returned unchanged.

    ``name`` replaces the object's own name. The module lists the objects.
    """
    own = competitor_name(given) if name is None else check_text("an agent's name", name)
    if isinstance(given, type):
        raise _no_agent(given)
    if hasattr(given, "act") or isinstance(given, PolicySet):
        return _renamed(given, own)
    if isinstance(given, Policy):
        return PolicySet(own, (given,))
    if hasattr(given, "predict"):
        return ModelAgent(own, given)
    if not callable(given):
        raise _no_agent(given)
    return FunctionAgent(own, given)


def _no_agent(given: Any) -> InputError:
    return InputError(
        f"{given!r} is not a competitor; it must be a policy, a PolicySet, a function of"
        " (observation, generator), or have act(observations, turn) or predict(observation, state,"
        " episode_start, deterministic)"
    )


def _renamed(agent: Any, name: str) -> Any:
    """Return an agent with a name; the agent itself, if it has this name."""
    if getattr(agent, "name", None) == name:
        return agent
    named = copy(agent)
    try:
        object.__setattr__(named, "name", name)  # agents may be frozen
    except AttributeError:
        raise InputError(
            f"{agent!r} has a name of its own, {agent.name!r}; it can't be called {name!r}"
        ) from None
    return named


def competitor_name(competitor: Any) -> str:
    """Return a competitor's name: its own, or the name of its function or class."""
    name = getattr(competitor, "name", None) or getattr(competitor, "__name__", None)
    return name if isinstance(name, str) else type(competitor).__name__


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


def check_competitor(game: RaceGame, competitor: Competitor) -> None:
    """Check, before any race, that a competitor can take part in a game.

    The check calls the competitor's method ``check_fits(game)``, if there is one, and compares
    ``observation_space`` and ``action_space`` of a model.
    """
    # An agent around a model has no check and no spaces of its own.
    model = getattr(competitor, "model", competitor)
    if hasattr(model, "check_fits"):
        model.check_fits(game)
    model = getattr(model, "model", model)
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
    competitor: Competitor,
    game: RaceGame,
    state: GameState,
    car: int,
    *,
    rows: Indices | None = None,
    observation: Observation | None = None,
    memories: list[Any] | None = None,
    generators: Sequence[np.random.Generator] = (),
    deterministic: bool = True,
) -> Indices:
    """Ask a competitor for the moves of one car in a batch of B games.

    Returns indices in :attr:`RaceGame.competitor_moves`, shape (B,); 0 for policies without moves
    and in games without a request.

    The request covers the games ``rows``, by default all, except finished games. ``observation``,
    shape (B, D), is the car's observation, if it is known already. ``memories``, of length B, are
    overwritten (:attr:`Turn.memories`); without them each turn is an agent's first.
    """
    moves = np.zeros(state.games, np.int64)
    if isinstance(competitor, PolicySet):
        return moves
    going = ~game.done(state)
    rows = np.flatnonzero(going) if rows is None else rows[going[rows]]
    if len(rows) == 0:
        return moves
    seen = game.observation(state)[:, car] if observation is None else observation
    kept = [None] * len(rows) if memories is None else [memories[row] for row in rows.tolist()]
    turn = Turn(game, state, rows, car, kept, generators, deterministic)
    player = f"competitor {competitor.name!r}"
    with one_line(player):  # any error of their code
        answer = competitor.act(seen[rows], turn)
    if memories is not None:
        for row, memory in zip(rows.tolist(), kept, strict=True):
            memories[row] = memory
    names = game.competitor_moves
    moves[rows] = check_moves(answer, names, rows.shape, ("game",), rows=rows, player=player)
    return moves


ENTRY_POINTS = "pcs_racing.opponents"
"""Entry point group for a distribution's module of competitors, with ``names`` and ``make``."""

NEVER_SWITCH = "never-switch"
RANDOM_MOVES = "random-moves"
ALWAYS = "always-"


def collections() -> list[Any]:
    """Return the modules of competitors of all distributions."""
    modules = []
    for point in _declared():
        try:
            modules.append(point.load())
        except Exception as error:  # any error of a third-party module at its import
            raise InputError(
                f"the competitors {point.name!r} can't be loaded from {point.value}: {error}"
            ) from error
    return modules


@lru_cache(maxsize=1)
def _declared() -> EntryPoints:
    return entry_points(group=ENTRY_POINTS)


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
        return as_agent(parse_policy(text))
    # Last: other packages are only imported for names that are not ours.
    for collection in collections():
        if is_model(text) or name in collection.names(game.archive, game.config):
            return as_agent(collection.make(text, game.archive, game.config))
    raise UnknownNameError(f"opponent {text!r} is unknown; {choices(text, competitor_names(game))}")
