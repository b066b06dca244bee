"""Construction of a game tree by simulation: its root, and its levels, each in one batch."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_seed, check_whole
from pcs_racing.base.typing import Indices
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.reward import reward
from pcs_racing.game.rules import REDRAWS, RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.trees.driving import drive_children, finish
from pcs_racing_agents.trees.tree import PolicyPaths, RaceTree, check_size, policy_paths

NOISY_SEEDS = 4


class Root(NamedTuple):
    """Root of a tree: policies, start and noise."""

    policies: Indices  #: shape (2,)
    start_s: float  #: Arc length of the start line, m.
    side: int  #: Side of car 0: 0 on the left or in front.
    seeds: NDArray[np.uint64]  #: shape (S,): Keys of the games.


def choose_pairs(archive: PolicyArchive, count: int, seed: int = 0) -> Indices:
    """Choose pairs of starting policies, shape (count, 2).

    The policies are a diverse choice of about ``2 sqrt(count)`` policies of the archive
    (:func:`select_diverse`), and both policies of a pair differ. No pair repeats, in either order,
    before all pairs have occurred once.

    Parameters
    ----------
    count : int
        Number of pairs, 1 to 100,000.
    seed : int
        Seed of the choice.
    """
    from pcs_racing_agents.policies.diverse import select_diverse

    check_whole("pairs", count, 1, 100_000)
    check_seed(seed, maximum=2**64)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    size = min(len(archive), int(np.ceil(2.0 * np.sqrt(count))))
    pool = select_diverse(archive, size, rng=rng)
    every = np.stack(np.triu_indices(size, min(size - 1, 1)), axis=1)
    rounds = [rng.permutation(every) for _ in range(-(-count // len(every)))]
    return pool[rng.permuted(np.concatenate(rounds)[:count], axis=1)]


def default_seeds(game: RaceGame) -> int:
    """Return the default number of noise seeds of a root: 1 without noise, 4 with noise."""
    return NOISY_SEEDS if game.rules.steering_noise > 0.0 else 1


def draw_root(game: RaceGame, policies: Indices, seeds: int, rng: np.random.Generator) -> Root:
    """Draw start line, side and noise for a pair of policies; no car crashes before the first move.

    A root has ``seeds`` games, which differ only in their noise.
    """
    # Like `RaceGame.reset`, it draws again after a crash, up to a limit of attempts: a pair that
    # always crashes has a tree of crashes only.
    noisy = game.rules.steering_noise > 0.0
    start_s, side, kept = 0.0, 0, np.zeros(0, np.uint64)
    for _ in range(REDRAWS):
        start_s, side = float(rng.choice(game.start_lines)), int(rng.integers(2))
        kept = np.zeros(0, np.uint64)
        for _ in range(REDRAWS if noisy else 1):
            keys = rng.integers(2**64, size=seeds - len(kept), dtype=np.uint64)
            starts = Starts(np.full(len(keys), start_s), np.full(len(keys), side))
            crashed = game.reset(keys, policies=policies, starts=starts).race.crashed
            kept = np.concatenate([kept, keys[~crashed]])
            if len(kept) == seeds:
                return Root(policies, start_s, side, kept)
    missing = rng.integers(2**64, size=seeds - len(kept), dtype=np.uint64)
    return Root(policies, start_s, side, np.concatenate([kept, missing]))


def build_tree(
    game: RaceGame,
    policies: ArrayLike,
    start: Starts | tuple[float, int],
    seeds: ArrayLike | None = None,
    *,
    share: bool = True,
) -> RaceTree:
    """Build the tree of all moves in a game from one start.

    Histories of moves that pass through the same policies are driven once. A crash ends its branch.
    The last step of two cars out of each other's sight is combined from their single drives
    (:mod:`pcs_racing_agents.trees.driving`). None of that changes a bit of the result.

    Parameters
    ----------
    game : RaceGame
        Game; both cars drive policies of its archive.
    policies : array of int, shape (2,)
        Starting policies of the cars.
    start : Starts of one start, or (float, int)
        Arc length of the start line (m) and side.
    seeds : array of int, shape (S,), optional
        Keys of the games, as for :meth:`RaceGame.reset`; key 0 by default. A single key without
        steering noise.
    share : bool
        Whether to combine last steps from single drives instead of driving all of them.
    """
    check_game(game)
    place = start if isinstance(start, Starts) else Starts(*(np.array([value]) for value in start))
    if len(place) != 1:
        raise InputError(f"there are {len(place)} starts; a tree has one")
    keys = np.atleast_1d(np.asarray(0 if seeds is None else seeds))
    if keys.ndim != 1 or len(keys) == 0 or len(np.unique(keys)) != len(keys):
        raise InputError(f"seeds are {seeds!r}; give one or more different whole numbers from 0")
    if len(keys) > 1 and game.rules.steering_noise == 0.0:
        raise InputError(
            f"there are {len(keys)} seeds, but no steering noise: every seed drives the same;"
            " give one"
        )
    pair = np.asarray(policies)
    if pair.shape != (2,) or (pair < 0).any():
        raise InputError(
            f"policies are {policies!r}; give two policies of archive {game.archive.name!r}"
        )
    root = game.reset(keys, policies=pair, starts=place.take(np.zeros(len(keys), np.int64)))
    moves, table = game.rules.moves, game.table[:, : game.offered]
    paths = [policy_paths(table, int(policy), moves) for policy in pair]
    grown = [_grow(game, take_games(root, [i]), paths, share) for i in range(len(keys))]
    payoffs, leads, estimates, over, numbers = zip(*grown, strict=True)
    driven, live, crashed = np.array(numbers, np.int64).T
    return RaceTree(
        policies=pair.astype(np.int64),
        start_s=float(place.s[0]),
        side=int(place.side[0]),
        seeds=keys.astype(np.uint64),
        handicaps=root.race.handicap,
        table=table,
        points=game.points,
        path_payoffs=np.stack(payoffs),
        path_leads=tuple(np.stack(level) for level in zip(*leads, strict=True)),
        path_estimates=tuple(np.stack(level) for level in zip(*estimates, strict=True)),
        path_over=tuple(np.stack(level) for level in zip(*over, strict=True)),
        driven=driven,
        live=live,
        crashed=crashed,
    )


def check_game(game: RaceGame) -> None:
    """Check that trees of a game can be built."""
    if game.rules.laps is not None:
        # A last step is combined from single drives, and so must not end with a lap of either car.
        raise InputError(
            f"laps is {game.rules.laps}; a game tree needs races by time: take rules without laps"
        )
    for car, planner in enumerate(game.setup.planners):
        if planner.name != game.archive.planner:
            raise InputError(
                f"car {car} is driven by planner {planner.name!r}; in a game tree both cars drive"
                f" policies of archive {game.archive.name!r} (planner {game.archive.planner!r})"
            )
    check_size(game.offered, game.rules.moves)


Grown = tuple[
    NDArray[np.float32],
    list[NDArray[np.float64]],
    list[NDArray[np.float32]],
    list[NDArray[np.bool_]],
    tuple[int, int, int],
]


def _grow(game: RaceGame, root: GameState, paths: Sequence[PolicyPaths], share: bool) -> Grown:
    """Build the tree of one seed: payoffs, and for each level leads, estimates and ended races."""
    moves, axes = game.rules.moves, len(game.characteristics)
    races = root.race  # races of the level that go on
    row = np.where(races.crashed, -1, 0).reshape(1, 1)  # row in `races` of each pair, -1 if over
    payoffs = np.where(races.crashed, reward(game.rules, races, 0), 0.0).reshape(1, 1)
    leads = [root.leads[:, 0].reshape(1, 1)]
    estimates = [root.estimates[:, :, 0].reshape(1, 1, 2, axes).astype(np.float32)]
    over = [row < 0]
    driven = live = 1
    for k in range(1, moves + 1):
        # A pair of paths continues the race of the pair of their parents. The paths of the two cars
        # are independent: all pairs of them form a matrix.
        above = np.ix_(*(path.parent[k] for path in paths))
        parents, payoffs = row[above], payoffs[above]
        at = np.nonzero(parents >= 0)
        rows = parents[at]
        policies = np.stack([path.policy[k][i] for path, i in zip(paths, at, strict=True)], axis=1)
        live += len(rows)
        crashed = parents < 0
        if k == moves:
            ends, count = finish(game, races, rows, policies, share=share)
            crashed[at] = ends.crash.any(axis=1)
            # The end after a crash or after all moves: in both cases k moves were made.
            payoffs[at] = reward(game.rules, ends.as_races(), k)
            driven += count
            break
        below, measured = drive_children(game, races, rows, policies)
        crashed[at] = below.crashed
        payoffs[at] = np.where(below.crashed, reward(game.rules, below, k), 0.0)
        leads.append(_scatter(below.lead, at, parents.shape))
        estimates.append(_scatter(measured.astype(np.float32), at, parents.shape))
        over.append(crashed)
        # A crash ends its branch: only the other races have children.
        go_on = np.flatnonzero(~below.crashed)
        row = np.full(parents.shape, -1)
        row[at[0][go_on], at[1][go_on]] = np.arange(len(go_on))
        races = type(below)._make(array[go_on] for array in below)
        driven += len(rows)
    # A pair of paths counts once for every joint history along it.
    weights = [np.bincount(path.history[moves]) for path in paths]
    crashes = int(weights[0] @ crashed.astype(np.int64) @ weights[1])
    return payoffs.astype(np.float32), leads, estimates, over, (driven, live, crashes)


def _scatter(
    values: NDArray[Any], at: tuple[NDArray[np.intp], ...], shape: tuple[int, ...]
) -> NDArray[Any]:
    array = np.zeros((*shape, *values.shape[1:]), values.dtype)
    array[at] = values
    return array
