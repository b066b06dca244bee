"""Match play: two competitors, many games at once, from given starts.

This is the one place where agents and drivers are let loose on each other; tournaments, the cells of a study and the
search for the best plan all play through :func:`play_games`. What comes of a game depends on the game alone: not on
the batch that it is played in, on the number of threads, or on what was played before.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.game import RaceGame, take_games
from pcs_racing.game.state import GameState
from pcs_racing.planners.planner import Policy
from pcs_racing.race.kernel import DT
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Agent, Competitor, Decider, Driver, as_competitor

__all__ = [
    "Matches",
    "check_competitor",
    "game_between",
    "join_matches",
    "moves_of",
    "name_of",
    "play_games",
    "variant_count",
]

BATCH = 4096  # games advanced together: bounded memory

CARS = ("ego", "opponent")


class Matches(NamedTuple):
    """What came of a batch of B games of m moves; the ego drove car 0.

    Attributes
    ----------
    lead : ndarray, shape (B,)
        Progress of the ego minus that of the opponent at the end, m.
    winner : ndarray, shape (B,), int8
        0 for the ego, 1 for the opponent, -1 for a tie and for a crash that pays nobody.
    utility : ndarray, shape (B,)
        What the game paid to the ego.
    crash : ndarray, shape (B, 2), int8
        0 none, 1 into a wall, 2 with the other car.
    fault : ndarray, shape (B, 2), int8
        1 for a car that is to blame for the crash.
    overtakes : ndarray, shape (B, 2), int64
        How often each passed the other.
    duration : ndarray, shape (B,)
        Length of the race, s; shorter after a crash.
    policy : ndarray, shape (B, 2, m + 1), int64
        Policy of the archive that was driven in each step; -1 for a driver and for steps after a crash.
    moves : ndarray, shape (B, 2, m), int64
        Moves made; -1 for a driver and after a crash.
    noise : ndarray, shape (B,), uint64
        Key of the noise, with which :func:`pcs_racing_agents.tournament.watching.record_match` drives a game again.
    seen : ndarray, shape (B, 2, D), float32
        What both saw at the end: everything that they saw on the way.
    """

    lead: NDArray[np.float64]
    winner: NDArray[np.int8]
    utility: NDArray[np.float64]
    crash: NDArray[np.int8]
    fault: NDArray[np.int8]
    overtakes: NDArray[np.int64]
    duration: NDArray[np.float64]
    policy: NDArray[np.int64]
    moves: NDArray[np.int64]
    noise: NDArray[np.uint64]
    seen: NDArray[np.float32]

    @property
    def tie(self) -> NDArray[np.bool_]:
        """Whether a game ended level, without a crash, shape (B,)."""
        return (self.winner < 0) & ~self.crash.any(axis=1)

    @property
    def score(self) -> NDArray[np.float64]:
        """Score of the ego, shape (B,): 1 for a win, a half for a tie, else 0 (a crash that pays nobody included)."""
        return (self.winner == 0) + 0.5 * self.tie


def join_matches(parts: "list[Matches]") -> Matches:
    """Join batches into one."""
    return Matches._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def variant_count(game: RaceGame, competitor: Competitor) -> int:
    """Return how many variants a competitor has: a driver's policies, else the archive's, with which it may start."""
    return len(competitor.policies) if isinstance(competitor, Driver) else len(game.archive)


def game_between(game: RaceGame, ego: Competitor, opponent: Competitor) -> RaceGame:
    """Return the game in which two competitors meet: with the move "stay", and with their planners.

    Raises
    ------
    InputError
        If one of them does not fit the game.
    """
    planners = [car.planner if isinstance(car, Driver) else None for car in (ego, opponent)]
    config = game.config if game.config.stay else replace(game.config, stay=True)
    arena = replace(game, config=config, ego_planner=planners[0], opponent_planner=planners[1])
    for car in (ego, opponent):
        check_competitor(arena, car)
    return arena


def check_competitor(game: RaceGame, competitor: Competitor) -> None:
    """Check that a competitor can take part in a game, as far as can be seen beforehand.

    Raises
    ------
    InputError
        If an agent is made for another archive or other rules, or a model sees or moves otherwise.
    """
    if isinstance(competitor, Agent):
        competitor.setting.check_fits(game, competitor.name)
    model = getattr(competitor, "model", competitor)
    size, moves = len(game.observation_elements), len(game.move_names)
    shape = getattr(getattr(model, "observation_space", None), "shape", None)
    if shape is not None and tuple(shape) != (size,):
        raise InputError(
            f"agent {name_of(competitor)!r} sees observations of shape {tuple(shape)}; this game shows ({size},)"
        )
    count = getattr(getattr(model, "action_space", None), "n", None)
    if count is not None and int(count) > moves:
        raise InputError(
            f"agent {name_of(competitor)!r} has {int(count)} moves; this game has {moves} "
            f"({', '.join(game.move_names)})"
        )


def play_games(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    policies: ArrayLike,
    starts: Starts,
    seeds: ArrayLike,
) -> Matches:
    """Play games between two competitors.

    Parameters
    ----------
    game : RaceGame
        Track, archive and rules. The move "stay" is added if the rules do not offer it; who does not know it just never
        makes it.
    ego, opponent : Agent, Driver, Policy, or object with ``predict`` or ``decide``
        Who drives car 0 and car 1.
    policies : array_like of int, shape (B, 2)
        Variant of each: the policy of the archive to start with; for a driver which of its policies.
    starts : Starts
        B of them.
    seeds : array_like of int, shape (B,)
        Keys of the games' noise.

    Returns
    -------
    Matches

    Raises
    ------
    InputError
        If a competitor does not fit the game, a variant does not exist, the numbers do not agree, or somebody makes a
        move that there is not.
    """
    cars = (as_competitor(ego), as_competitor(opponent))
    arena = game_between(game, *cars)
    keys = np.asarray(seeds)
    chosen = np.asarray(policies)
    if chosen.shape != (len(starts), 2) or chosen.dtype.kind not in "iu" or keys.shape != (len(starts),):
        raise InputError(
            f"there are {len(starts)} starts, policies of shape {chosen.shape} and seeds of shape {keys.shape}; they "
            f"must be whole numbers of shape ({len(starts)}, 2) and ({len(starts)},)"
        )
    for car, who in enumerate(cars):
        count = variant_count(arena, who)
        wrong = np.flatnonzero((chosen[:, car] < 0) | (chosen[:, car] >= count))
        if len(wrong):
            raise InputError(
                f"game {wrong[0]}: the {CARS[car]}'s variant is {chosen[wrong[0], car]}; {name_of(who)!r} has variants "
                f"0 to {count - 1}"
            )
    parts = []
    for first in range(0, max(len(starts), 1), BATCH):
        rows = np.arange(first, min(first + BATCH, len(starts)))
        parts.append(_play(arena, cars, chosen[rows].astype(np.int64), starts.take(rows), keys[rows]))
    return join_matches(parts)


def _play(
    arena: RaceGame,
    cars: tuple[Competitor, Competitor],
    chosen: NDArray[np.int64],
    starts: Starts,
    keys: NDArray[Any],
) -> Matches:
    steps = arena.config.moves
    drivers = [
        [who.policies[i] for i in chosen[:, car]] if isinstance(who, Driver) else None for car, who in enumerate(cars)
    ]
    acts = np.array([driver is None for driver in drivers])
    first = np.where(acts, chosen, -1)
    state = arena.reset(keys, policies=first, starts=starts, egos=drivers[0], opponents=drivers[1])
    policy = np.full((len(chosen), 2, steps + 1), -1, np.int64)
    moves = np.full((len(chosen), 2, steps), -1, np.int64)
    policy[:, :, 0] = first
    memories: list[Any] = [None, None]
    for step in range(steps):
        going = np.flatnonzero(~arena.done(state))
        if len(going) == 0:
            break
        seen = arena.observation(state)
        actions = np.zeros((len(chosen), 2), np.int64)
        for car, who in enumerate(cars):
            if acts[car]:
                actions[:, car], memories[car] = _ask(who, arena, state, seen[:, car], car, memories[car])
                moves[going, car, step] = actions[going, car]
        state = arena.step(state, actions)
        policy[going, :, step + 1] = state.policy[going]
    race = state.race
    return Matches(
        lead=race.lead,
        winner=arena.winner(state),
        utility=arena.utility(state)[:, 0],
        crash=race.crash,
        fault=race.fault,
        overtakes=race.overtakes,
        duration=np.asarray(race.tick * DT, np.float64),
        policy=policy,
        moves=moves,
        noise=race.seed,
        seen=arena.observation(state),
    )


def moves_of(who: Competitor, game: RaceGame, state: GameState, car: int) -> NDArray[np.int64]:
    """Ask for the moves of one car in a batch of B games, shape (B,); 0 in games that are over, and for drivers.

    Parameters
    ----------
    who : Competitor
        A model that wants to remember is asked as at the beginning of a game.
    game : RaceGame
    state : GameState
    car : int

    Raises
    ------
    InputError
        If the answer is not one move for each game.
    """
    return _ask(who, game, state, game.observation(state)[:, car], car, None)[0]


def _ask(
    who: Competitor, game: RaceGame, state: GameState, seen: NDArray[np.float32], car: int, memory: Any
) -> tuple[NDArray[np.int64], Any]:
    """Moves of one car in all games, and what it wants to be handed the next time."""
    going = ~game.done(state)
    actions = np.zeros(state.games, np.int64)
    if isinstance(who, Driver):
        return actions, memory
    answer: Any
    if isinstance(who, Decider):
        rows = np.flatnonzero(going)
        answer = np.asarray(who.decide(game, take_games(state, rows), car))
    else:
        # Games that are over are asked about, too: whoever remembers keeps one memory for each game of the batch.
        rows = np.arange(state.games)
        answer, memory = who.predict(seen, memory, np.full(state.games, memory is None), True)
        answer = np.asarray(answer)
    if answer.shape != rows.shape or answer.dtype.kind not in "iu":
        raise InputError(
            f"agent {name_of(who)!r} returned moves of shape {answer.shape} and type {answer.dtype} for {len(rows)} "
            "games; they must be whole numbers, one for each"
        )
    wrong = np.flatnonzero((answer < 0) | (answer >= len(game.move_names)))
    if len(wrong):
        raise InputError(
            f"agent {name_of(who)!r} made move {answer[wrong[0]]} in game {rows[wrong[0]]}; there are moves 0 to "
            f"{len(game.move_names) - 1} ({', '.join(game.move_names)})"
        )
    actions[rows] = answer
    actions[~going] = 0
    return actions, memory


def name_of(who: Any) -> str:
    """Return the name of a competitor; of a model without one that of its class."""
    return str(getattr(who, "name", type(who).__name__))
