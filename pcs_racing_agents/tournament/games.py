"""Games of several egos from the same starts against one opponent, driven once for as long as they are the same.

A step of a race follows from the state before it and from the policies that drive it. All egos begin with the same
policies, so the first step of a game is the same for all of them; later ones are the same for those whose policies
were the same so far. Their games are the branches of a tree, and each of its steps is driven once. The results are
those of games that are driven one by one, to the bit: they do not depend on the batch that a game is driven in, on the
number of threads, or on earlier games.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import ask_moves, check_competitor, competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.race.config import DT
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, Driver
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.tournament.races import narrow

Indices = NDArray[np.int64]

CARS = ("ego", "opponent")


def variant_count(game: RaceGame, competitor: Competitor) -> int:
    """Return how many variants a competitor has: a driver's policies, else the archive's, with which it may start."""
    return len(competitor.policies) if isinstance(competitor, Driver) else len(game.archive)


def game_between(game: RaceGame, ego: Competitor, opponent: Competitor) -> RaceGame:
    """Return the game in which two competitors meet: with the move "stay", and with their planners."""
    planners = [car.planner if isinstance(car, Driver) else None for car in (ego, opponent)]
    config = game.config if game.config.stay else replace(game.config, stay=True)
    game = replace(game, config=config, ego_planner=planners[0], opponent_planner=planners[1])
    for car in (ego, opponent):
        check_competitor(game, car)
    return game


def race_columns(
    game: RaceGame,
    egos: Sequence[Competitor],
    opponent: Competitor,
    policies: ArrayLike,
    starts: Starts,
    seeds: ArrayLike,
) -> list[Arrays]:
    """Play the same B games with each of K egos, several of them only if none is a driver.

    Parameters
    ----------
    policies : array_like of int, shape (B, 2)
        Variant of each car: the policy of the archive to start with; for a driver which of its policies.
    seeds : array_like of int, shape (B,)
        Keys of the games.

    Returns
    -------
    list of K dict of ndarray
        By name what a :class:`pcs_racing_agents.tournament.races.RaceTable` says of how the races went. ``moves`` are
        indices of moves, and ``noise`` (which it lacks) the keys of the steering noise.
    """
    if not egos or (len(egos) > 1 and any(isinstance(ego, Driver) for ego in egos)):
        raise InputError(
            f"egos are {', '.join(map(competitor_name, egos)) or 'nobody'}; give one or more, a driver only alone"
        )
    game = game_between(game, egos[0], opponent)
    for ego in egos[1:]:
        check_competitor(game, ego)
    # No conversion to whole numbers here: policies given as 2.7 or True would become others without a word.
    keys, variants = np.asarray(seeds), np.asarray(policies)
    if variants.shape != (len(starts), 2) or variants.dtype.kind not in "iu" or keys.shape != (len(starts),):
        raise InputError(
            f"there are {len(starts)} starts, policies of shape {variants.shape} and seeds of shape {keys.shape}; they "
            f"must be whole numbers of shape ({len(starts)}, 2) and ({len(starts)},)"
        )
    for car, competitor in enumerate((egos[0], opponent)):
        count = variant_count(game, competitor)
        wrong = np.flatnonzero((variants[:, car] < 0) | (variants[:, car] >= count))
        if len(wrong):
            raise InputError(
                f"game {wrong[0]}: the {CARS[car]}'s variant is {variants[wrong[0], car]}; "
                f"{competitor_name(competitor)!r} has variants 0 to {count - 1}"
            )
    games = _drive(game, egos, opponent, variants.astype(np.int64), starts, keys)
    return [_columns(game, games, k) for k in range(len(egos))]


class _SharedGames(NamedTuple):
    """B games of each of K egos, of m moves."""

    state: GameState  #: The ends of all different games.
    branch: Indices  #: shape (K, B): Where in ``state`` each ego's games are.
    path: Indices  #: shape (K, B, 2, m + 1): Policy driven in each step; -1 for a driver and after a crash.
    moves: Indices  #: shape (K, B, 2, m): Moves made; -1 for a driver and after a crash.


def _drive(
    game: RaceGame,
    egos: Sequence[Competitor],
    opponent: Competitor,
    variants: Indices,
    starts: Starts,
    keys: NDArray[Any],
) -> _SharedGames:
    """Drive the branches of all games, step by step."""
    games, steps = len(variants), game.config.moves
    drivers = [
        [car.policies[i] for i in variants[:, place]] if isinstance(car, Driver) else None
        for place, car in enumerate((egos[0], opponent))
    ]
    # A driver's variant is no policy of the archive; -1 leaves its place to it.
    first = np.where([driver is None for driver in drivers], variants, -1)
    state = game.reset(keys, policies=first, starts=starts, egos=drivers[0], opponents=drivers[1])
    # At first every ego's game k is row k of the state. A row is copied only when its egos part, so the state grows
    # with the number of different games; rows never join again, since what was driven differs from there on.
    branch = np.tile(np.arange(games), (len(egos), 1))
    path = np.full((len(egos), games, 2, steps + 1), -1, np.int64)
    moves = np.full((len(egos), games, 2, steps), -1, np.int64)
    path[..., 0] = first
    # A model's memory belongs to a game. The egos have one for each of their games, the opponent one for each branch,
    # because in one branch it cannot know which of the egos it meets.
    memories: list[list[Any]] = [[None] * games for _ in egos]
    opponent_memories: list[Any] = [None] * games
    for step in range(steps):
        over = game.done(state)
        if over.all():
            break
        running = ~over[branch]
        seen = game.observation(state)
        own = np.zeros(branch.shape, np.int64)
        for k, ego in enumerate(egos):
            if not isinstance(ego, Driver):
                own[k], memories[k] = _ask_ego(ego, game, state, branch[k], seen, memories[k])
                moves[k, running[k], 0, step] = own[k, running[k]]
        replies = np.zeros(state.games, np.int64)
        if drivers[1] is None:
            replies = ask_moves(opponent, game, state, 1, observation=seen[:, 1], memories=opponent_memories)
            moves[running, 1, step] = replies[branch][running]
        # Two egos with different moves that lead to the same policy go on together. Games that are over count as
        # policy 0: they are not driven, and must not multiply.
        policies = np.where(running, game.next_policy(state.policy[branch, 0], own), 0)
        _, chosen, after = np.unique(branch * len(game.archive) + policies, return_index=True, return_inverse=True)
        parents = branch.reshape(-1)[chosen]
        both = np.stack([own.reshape(-1)[chosen], replies[parents]], axis=1)
        opponent_memories = _branched(opponent_memories, parents)
        state = game.apply(take_games(state, parents), both)
        branch = after.reshape(branch.shape)
        path[running, :, step + 1] = state.policy[branch][running]
    return _SharedGames(state, branch, path, moves)


def _ask_ego(
    ego: Competitor, game: RaceGame, state: GameState, rows: Indices, seen: NDArray[np.float32], memories: list[Any]
) -> tuple[Indices, list[Any]]:
    """Moves of an ego in its games, which are some rows of a state, and what it remembers of each of them after it."""
    # ask_moves knows memories by the row of the state; several egos' games may lie in the same row, so each ego has
    # a list of its own.
    remembered: list[Any] = [None] * state.games
    for row, memory in zip(rows, memories, strict=True):
        remembered[row] = memory
    moves = ask_moves(ego, game, state, 0, rows=rows, observation=seen[:, 0], memories=remembered)
    return moves[rows], [remembered[row] for row in rows]


def _branched(memories: list[Any], parents: Indices) -> list[Any]:
    """What is remembered in each branch; branches that part do not share what may be changed in place."""
    if all(memory is None for memory in memories):
        return [None] * len(parents)
    # Copied only where games part: in all others the model goes on with its own object.
    parted = np.bincount(parents) > 1
    return [copy.deepcopy(memories[parent]) if parted[parent] else memories[parent] for parent in parents]


def _columns(game: RaceGame, games: _SharedGames, ego: int) -> Arrays:
    """Results of the games of one of several egos."""
    state = take_games(games.state, games.branch[ego])
    race = state.race
    return {
        "lead": race.lead,
        "winner": game.winner(state),
        # A race has one code. That of a contact of the cars is the higher one: it may end at a wall for one of them.
        "crash": race.crash.max(axis=1),
        # Faults that did not end a race are only counted in its state.
        "fault": game.fault(state).astype(np.int8),
        "overtakes": narrow(race.overtakes),
        "duration": np.asarray(race.tick * DT, np.float64),
        "path": narrow(games.path[ego]),
        "moves": narrow(games.moves[ego]),
        "noise": race.seed,
        "observations": game.observation(state),
    }
