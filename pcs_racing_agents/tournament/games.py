"""Games of several egos against one opponent with equal starts; common parts are simulated once.

A step of a race depends only on the previous state and the policies of the step. All egos begin
with the same policies, so the first step of a game is the same for all egos; a later step is the
same for all egos with the same policies so far. The games are branches of a tree, and each step of
the tree is simulated once. The results are bit-identical to separate games: they do not depend on
the batch, on the number of threads, or on earlier games.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Indices
from pcs_racing.game.players import Competitor, ask_moves, check_competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.planners.planner import PolicySet
from pcs_racing.planners.racers import own_name
from pcs_racing.race.config import DT
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.base.jobs import Arrays
from pcs_racing_agents.tournament.races import narrow

CARS = ("ego", "opponent")


def variant_count(game: RaceGame, competitor: Competitor) -> int:
    """Return the number of a competitor's variants: a planner's policies, or the archive's size."""
    return len(competitor.policies) if isinstance(competitor, PolicySet) else len(game.archive)


def game_between(game: RaceGame, ego: Competitor, opponent: Competitor) -> RaceGame:
    """Return the game of two competitors: with the move "stay" and their planners."""
    planners = [car.planner if isinstance(car, PolicySet) else None for car in (ego, opponent)]
    rules = game.rules if game.rules.stay else replace(game.rules, stay=True)
    game = replace(game, rules=rules, ego_planner=planners[0], opponent_planner=planners[1])
    for car in (ego, opponent):
        check_competitor(game, car)
    return game


def race_columns(
    game: RaceGame,
    egos: Sequence[Competitor],
    opponent: Competitor,
    variants: Indices,
    starts: Starts,
    keys: NDArray[np.uint64],
) -> list[Arrays]:
    """Play the same B games with each of K egos; a planner as ego must be the only ego.

    Parameters
    ----------
    variants : ndarray of int, shape (B, 2)
        Variant of each car: index of the start policy in the archive, or of a planner's policy.
    keys : ndarray of int, shape (B,)
        Keys of the games.

    Returns
    -------
    list of K dict of ndarray
        Result columns of a :class:`pcs_racing_agents.tournament.races.RaceTable` by name. ``moves``
        are indices of moves; the extra column ``noise`` holds the keys of the steering noise.
    """
    game = game_between(game, egos[0], opponent)
    for ego in egos[1:]:
        check_competitor(game, ego)
    for car, competitor in enumerate((egos[0], opponent)):
        count = variant_count(game, competitor)
        wrong = np.flatnonzero((variants[:, car] < 0) | (variants[:, car] >= count))
        if len(wrong):
            raise InputError(
                f"game {wrong[0]}: the {CARS[car]}'s variant is {variants[wrong[0], car]}; "
                f"{own_name(competitor)!r} has variants 0 to {count - 1}"
            )
    games = _drive(game, egos, opponent, variants.astype(np.int64), starts, keys)
    return [_columns(game, games, k) for k in range(len(egos))]


class _SharedGames(NamedTuple):
    """B games of m moves for each of K egos."""

    state: GameState  #: Final states of all distinct games.
    branch: Indices  #: shape (K, B): Row in ``state`` of each ego's games.
    #: shape (K, B, 2, m + 1): Archive policy of each step; -1 for a planner and after a crash.
    path: Indices
    moves: Indices  #: shape (K, B, 2, m): Moves; -1 for a planner and after a crash.


def _drive(
    game: RaceGame,
    egos: Sequence[Competitor],
    opponent: Competitor,
    variants: Indices,
    starts: Starts,
    keys: NDArray[Any],
) -> _SharedGames:
    """Simulate the branches of all games, step by step."""
    games, steps = len(variants), game.rules.moves
    planned = [
        [car.policies[i] for i in variants[:, place]] if isinstance(car, PolicySet) else None
        for place, car in enumerate((egos[0], opponent))
    ]
    # A planner's variant is no archive policy: -1 marks its column.
    first = np.where([policies is None for policies in planned], variants, -1)
    state = game.reset(keys, policies=first, starts=starts, egos=planned[0], opponents=planned[1])
    # Initially game k of every ego is row k of the state. A row is copied only when its egos part,
    # so the state grows with the number of distinct games. Rows never merge, since their histories
    # differ.
    branch = np.tile(np.arange(games), (len(egos), 1))
    path = np.full((len(egos), games, 2, steps + 1), -1, np.int64)
    moves = np.full((len(egos), games, 2, steps), -1, np.int64)
    path[..., 0] = first
    # A model's memory belongs to a game. An ego has one memory for each game, the opponent one for
    # each branch, because within a branch it can't distinguish the egos.
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
            if not isinstance(ego, PolicySet):
                own[k], memories[k] = _ask_ego(ego, game, state, branch[k], seen, memories[k])
                moves[k, running[k], 0, step] = own[k, running[k]]
        replies = np.zeros(state.games, np.int64)
        if planned[1] is None:
            replies = ask_moves(
                opponent, game, state, 1, observation=seen[:, 1], memories=opponent_memories
            )
            moves[running, 1, step] = replies[branch][running]
        # Egos with different moves to the same policy stay in one branch. Finished games count as
        # policy 0: they are not simulated, and must not multiply.
        policies = np.where(running, game.table[state.policy[branch, 0], own], 0)
        _, chosen, after = np.unique(
            branch * len(game.archive) + policies, return_index=True, return_inverse=True
        )
        parents = branch.reshape(-1)[chosen]
        both = np.stack([own.reshape(-1)[chosen], replies[parents]], axis=1)
        opponent_memories = _branched(opponent_memories, parents)
        state = game.step(take_games(state, parents), both, checked=True)
        branch = after.reshape(branch.shape)
        path[running, :, step + 1] = state.policy[branch][running]
    return _SharedGames(state, branch, path, moves)


def _ask_ego(
    ego: Competitor,
    game: RaceGame,
    state: GameState,
    rows: Indices,
    seen: NDArray[np.float32],
    memories: list[Any],
) -> tuple[Indices, list[Any]]:
    """Return an ego's moves and its updated memories for its games, given as rows of a state."""
    # ask_moves indexes memories by row of the state. Games of several egos may share a row, so each
    # ego has its own list.
    remembered: list[Any] = [None] * state.games
    for row, memory in zip(rows, memories, strict=True):
        remembered[row] = memory
    moves = ask_moves(ego, game, state, 0, rows=rows, observation=seen[:, 0], memories=remembered)
    return moves[rows], [remembered[row] for row in rows]


def _branched(memories: list[Any], parents: Indices) -> list[Any]:
    """Return the memory of each branch; parting branches get copies, since memories are mutable."""
    if all(memory is None for memory in memories):
        return [None] * len(parents)
    # Copies only for parting games: in all other games the model continues with its object.
    parted = np.bincount(parents) > 1
    return [
        copy.deepcopy(memories[parent]) if parted[parent] else memories[parent]
        for parent in parents
    ]


def _columns(game: RaceGame, games: _SharedGames, ego: int) -> Arrays:
    """Return the results of one ego's games."""
    state = take_games(games.state, games.branch[ego])
    race = state.race
    return {
        "lead": race.lead,
        "winner": game.winner(state),
        # A race has one code. The code of a car contact is higher than the wall code: after a
        # contact one car may hit a wall.
        "crash": race.crash.max(axis=1),
        # Faults that did not end the race are only counted in the state.
        "fault": game.fault(state).astype(np.int8),
        "overtakes": narrow(race.overtakes),
        "duration": np.asarray(race.tick * DT, np.float64),
        "path": narrow(games.path[ego]),
        "moves": narrow(games.moves[ego]),
        "best_laps": race.best_lap,
        "noise": race.seed,
        "observations": game.observation(state),
    }
