"""Players of the game: agents, constant players, readers of texts and objects, moves on request.

An agent has a ``name`` and a method ``act(observations, turn)``, which returns the moves of one car
in a batch of games (:class:`SupportsAct`). A :class:`pcs_racing.planners.planner.PolicySet` also
takes part in games, without moves. Agents may stay under all rules:
:attr:`pcs_racing.game.rules.RaceGame.moves`.
"""

import hashlib
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import kernel
from pcs_racing.base.errors import InputError, one_line
from pcs_racing.base.seeds import GOLDEN, scramble_one
from pcs_racing.base.typing import Indices
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.identity import check_same_game, read_identity
from pcs_racing.game.moves import STAY, check_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.planners.planner import Policy, PolicySet
from pcs_racing.planners.racers import Racer, Reader, Request, own_name, racer

Observation = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Turn:
    """Games at a move of one car, for agents that need more than their observations."""

    game: RaceGame
    games: GameState  #: Batch that contains the games.
    rows: Indices  #: shape (n,): Indices of the n games in ``games``.
    car: int  #: Car of the agent, 0 or 1.
    #: Value of the agent for each of the n games, None before its first move; ``act`` may replace
    #: the entries, and the next turn has the new values.
    memories: list[Any]
    deterministic: bool  #: False if a model may draw its moves, by a generator of its own.

    @property
    def state(self) -> GameState:
        """Copy of the states of the n games."""
        return take_games(self.games, self.rows)

    @property
    def stay(self) -> int:
        """Move that keeps the policy."""
        return len(self.game.moves) - 1

    def generator(self, row: int) -> np.random.Generator:
        """Return the generator of a game's move: a function of the game's key, step and car."""
        key = int(self.games.race.seed[row])
        return np.random.default_rng([key, int(self.games.step[row]), self.car])


@runtime_checkable
class SupportsAct(Protocol):
    """An agent: a player of the game with a name."""

    @property
    def name(self) -> str:
        """Name in tables."""

    def act(self, observations: Observation, turn: Turn) -> ArrayLike:
        """Return the moves in n games, shape (n,), from observations of shape (n, D).

        Moves are indices of :attr:`RaceGame.moves`. Each game is decided independently,
        so that batches of all sizes give the same moves.
        """


Competitor = SupportsAct | PolicySet
"""An agent, or policies without moves."""


@kernel
def _hash(words, seed, out):
    first = scramble_one((seed + np.uint64(1)) * GOLDEN)
    for row in range(words.shape[0]):
        state = first
        for column in range(words.shape[1]):
            state = scramble_one((state ^ np.uint64(words[row, column])) + GOLDEN)
        out[row] = state


def hash_rows(rows: Observation, seed: int) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each row (B, D): splitmix64 (Steele et al. 2014) over its words."""
    # -0 and 0 are the same number
    words = np.ascontiguousarray(rows + np.float32(0.0)).view(np.uint32)
    out = np.empty(len(rows), np.uint64)
    _hash(words, np.uint64(seed), out)
    return out


def draw(probabilities: NDArray[np.float64], observations: Observation, seed: int) -> Indices:
    """Draw a column of each row of probabilities (B, M) by the hash of the observation (B, D).

    The columns have shape (B,). The same agent makes the same move for the same observation, in a
    batch of any size, so a race can be simulated again to the last bit. To an opponent that does
    not know the seed, the moves are as good as random.
    """
    share = (hash_rows(observations, seed) >> np.uint64(11)).astype(np.float64) * 2.0**-53
    edges = np.cumsum(probabilities, axis=1)
    # The share is scaled by the total: rounding in the sum never leaves a gap at the end.
    column = (edges <= (share * edges[:, -1])[:, None]).sum(axis=1)
    last = probabilities.shape[1] - 1 - np.argmax(probabilities[:, ::-1] > 0.0, axis=1)
    return np.minimum(column, last)


@dataclass(frozen=True)
class ConstantPlayer:
    """An agent with the same probabilities of the moves in every situation."""

    name: str
    chances: tuple[float, ...]  #: Probability of each of the M moves; they sum to 1.
    seed: int = 0  #: Seed of the draws.

    @property
    def content_hash(self) -> str:
        """SHA-256 of the probabilities and the seed."""
        return hashlib.sha256(f"{self.chances} {self.seed}".encode()).hexdigest()

    def probabilities(self, observations: ArrayLike) -> NDArray[np.float64]:
        """Return the probabilities of the moves, shape (B, M), for observations (B, D)."""
        return np.tile(self.chances, (len(np.asarray(observations)), 1))

    def act(self, observations: ArrayLike, turn: Turn | None = None) -> Indices:
        """Return a move for each game, shape (B,)."""
        rows = np.asarray(observations, np.float32)
        return draw(self.probabilities(rows), rows, self.seed)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game has as many moves."""
        if len(game.moves) != len(self.chances):
            raise InputError(
                f"agent {self.name!r} has {len(self.chances)} moves; this game has"
                f" {len(game.moves)}"
            )


NEVER_SWITCH = "never-switch"
RANDOM_MOVES = "random-moves"
ALWAYS = "always-"


def always(game: RaceGame, move: str, *, name: str | None = None, seed: int = 0) -> ConstantPlayer:
    """Return an agent that makes the same move at every step."""
    index = game.move(move)
    chances = np.eye(len(game.moves))[index]
    plain = "".join(game.moves[index].split())
    return ConstantPlayer(name or f"{ALWAYS}{plain}", tuple(chances.tolist()), seed)


def never_switch(game: RaceGame, *, name: str = NEVER_SWITCH, seed: int = 0) -> ConstantPlayer:
    """Return an agent that keeps its initial policy: the paper's non-GT agent."""
    return always(game, STAY, name=name, seed=seed)


def random_moves(game: RaceGame, *, name: str = RANDOM_MOVES, seed: int = 0) -> ConstantPlayer:
    """Return an agent that draws each move uniformly among the moves that the rules offer."""
    count, offered = len(game.moves), game.offered
    return ConstantPlayer(name, (1.0 / offered,) * offered + (0.0,) * (count - offered), seed)


@dataclass(frozen=True, eq=False)
class FunctionAgent:
    """An agent of a function of one observation and a generator, a function of the game's key."""

    name: str
    function: Callable[[Observation, np.random.Generator], Any]

    def act(self, observations: Observation, turn: Turn) -> list[Any]:
        """Return the function's move for each game."""
        return [
            self.function(one, turn.generator(row))
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


def competitor(
    given: Any,
    game: Any,
    code: bool = False,
    *,
    name: str | None = None,
    like: Any = None,
    seed: int = 0,
) -> Competitor:
    """Return the agent, or the policies without moves, of a text or an object.

    The arguments are as in :func:`pcs_racing.planners.racers.racer`.
    """
    found = racer(given, game, code, name=name, like=like, seed=seed)
    return PolicySet(found.name, (found,)) if isinstance(found, Policy) else found


def read_player(request: Request) -> Racer | None:
    """Return a constant player, a policy of an archive, or an agent in memory."""
    given, text = request.given, request.text
    if text == NEVER_SWITCH:
        return never_switch(request.asked_game, seed=request.seed)
    if text == RANDOM_MOVES:
        return random_moves(request.asked_game, seed=request.seed)
    if text.startswith(ALWAYS):
        return always(request.asked_game, text.removeprefix(ALWAYS), seed=request.seed)
    place = re.fullmatch(r"(.+)\[(\d{1,9})\]", text)
    if place:
        return load_archive(place[1]).policy(int(place[2]))
    if text:
        return None
    if isinstance(given, PolicySet) or hasattr(given, "act"):
        return given
    if inspect.isroutine(given) and _inputs(given) == 2:
        return FunctionAgent(own_name(given), given)
    return None


def _inputs(function: Any) -> int:
    """Return the number of a function's arguments without defaults; 0 if it can't be read."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 0
    return sum(
        one.default is one.empty and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
        for one in parameters
    )


PLAYERS = Reader(read_player, lambda: (NEVER_SWITCH, RANDOM_MOVES))


def model_agent(model: Any, name: str, origin: Any, game: RaceGame) -> ModelAgent:
    """Return the agent of a model; ``origin`` is the game of its training, as plain values."""
    if origin is not None:
        check_same_game(read_identity(origin), game.identity, f"model {name!r}")
    return ModelAgent(name, model)


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
    size, moves = len(game.observation_elements), game.moves
    shape = getattr(getattr(model, "observation_space", None), "shape", None)
    if shape is not None and tuple(shape) != (size,):
        raise InputError(
            f"competitor {own_name(competitor)!r} takes observations of shape"
            f" {tuple(shape)}; in this game they have shape ({size},)"
        )
    count = getattr(getattr(model, "action_space", None), "n", None)
    if count is not None and int(count) > len(moves):
        raise InputError(
            f"competitor {own_name(competitor)!r} has {int(count)} moves; this game has"
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
    deterministic: bool = True,
) -> Indices:
    """Ask a competitor for the moves of one car in a batch of B games.

    Returns indices in :attr:`RaceGame.moves`, shape (B,); 0 for policies without moves
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
    turn = Turn(game, state, rows, car, kept, deterministic)
    player = f"competitor {competitor.name!r}"
    with one_line(player):  # any error of their code
        answer = competitor.act(seen[rows], turn)
    if memories is not None:
        for row, memory in zip(rows.tolist(), kept, strict=True):
            memories[row] = memory
    names = game.moves
    moves[rows] = check_moves(answer, names, rows.shape, ("game",), rows=rows, player=player)
    return moves
