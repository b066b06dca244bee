"""Payoffs of all pairs of a pool of policies, each fixed for a whole race.

The payoffs define the game of choosing a policy before the start;
:mod:`pcs_racing_agents.policies.headroom` analyses it.
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Run, run_races

Floats = NDArray[np.float64]

_RACES_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class PolicyPool:
    """Pool of policies, and the races that decide its payoffs."""

    policies: tuple[Policy, ...]  #: N >= 3 policies.
    #: Tracks, or their names or folders, which workers on other machines load themselves.
    tracks: tuple[Track | str, ...]
    config: RaceConfig
    #: Races of every pair on every track, alternately from both sides of the grid on each line.
    races: int = 64
    folds: int = 16  #: Number of disjoint sets of start lines with equally many races.
    seed: int = 0  #: Root seed of start lines and noise. Every race has its own noise.

    def __post_init__(self) -> None:
        if len(self.policies) < 3:
            raise InputError(
                f"the pool holds {len(self.policies)} policies; a cycle needs at least 3"
            )
        if not self.tracks:
            raise InputError("there are no tracks; name at least one")
        check_whole("folds", self.folds, 2, 1000)
        check_whole("races", self.races, 2 * self.folds, 1_000_000)
        if self.races % (2 * self.folds):
            raise InputError(
                f"races is {self.races}; it must be a multiple of twice the folds, {2 * self.folds}"
            )

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairs of policies, the lower index first; a policy also races against itself."""
        return list(combinations_with_replacement(range(len(self.policies)), 2))

    def starts(self, number: int) -> tuple[Track, Starts]:
        """Return a track and the starts of its races: two on each line, from both sides."""
        track = as_track(self.tracks[number])
        rules = replace(self.config, start_lines=self.races // 2)
        lines = start_lines(track, rules, np.random.SeedSequence(self.seed, spawn_key=(number,)))
        return track, Starts(np.repeat(lines, 2), np.tile([0, 1], len(lines)))

    def noise(self, *key: int) -> NDArray[np.uint64]:
        """Return noise keys of the races of a pair.

        The keys depend on the numbers of the pair and not on the block of its races.
        """
        seeds = np.random.SeedSequence(self.seed, spawn_key=key)
        return seeds.generate_state(self.races, np.uint64).astype(np.uint64)

    def by_fold(self, scores: Floats) -> Floats:
        """Return mean payoffs by fold and slot, shape (..., F, 2), of scores, shape (..., R)."""
        folds = scores.reshape(*scores.shape[:-1], -1, self.folds, 2)
        return np.asarray(folds.mean(axis=-3) - 0.5)


def pool_payoffs(pool: PolicyPool, *, name: str = "pairs", **run: Unpack[Run]) -> Floats:
    """Race all pairs of a pool; return mean payoffs, shape (T, F, N, N), antisymmetric.

    The mean covers the slots in the result of :func:`slot_payoffs` for the same arguments.
    """
    return np.asarray(slot_payoffs(pool, name=name, **run).mean(axis=2))


def slot_payoffs(pool: PolicyPool, *, name: str = "pairs", **run: Unpack[Run]) -> Floats:
    """Race all pairs of a pool, as tasks of this name; return payoffs by slot of the grid.

    Returns
    -------
    ndarray, shape (T, F, 2, N, N)
        Score of the row's policy against the column's policy minus one half, for every track, fold
        and slot of the row's policy: 0 on the left or in front, 1 on the right or behind. A tie and
        a no-contest crash count one half. The mean over the slots is antisymmetric.
    """
    step = max(1, _RACES_AT_ONCE // pool.races)
    blocks = [pool.pairs[first : first + step] for first in range(0, len(pool.pairs), step)]
    tasks = [(pool, track, block) for track in range(len(pool.tracks)) for block in blocks]
    results = run_races(name, _race_block, tasks, **run)
    count = len(pool.policies)
    payoffs = np.zeros((len(pool.tracks), pool.folds, 2, count, count))
    for (_, track, block), result in zip(tasks, results, strict=True):
        for (i, j), won in zip(block, result["payoffs"], strict=True):
            if i == j:
                # Both cars have the same policy: a win of one slot is a loss of the other, so one
                # number describes both.
                front = (won[:, 0] - won[:, 1]) / 2.0
                won = np.stack([front, -front], axis=1)
            payoffs[track, :, :, i, j] = won
            payoffs[track, :, :, j, i] = -won[:, ::-1]
    return payoffs


def _race_block(
    task: tuple[PolicyPool, int, list[tuple[int, int]]], threads: int | None = None
) -> Arrays:
    """Race some pairs on a track; return payoffs by fold and slot, shape (pairs, F, 2)."""
    pool, number, pairs = task
    track, starts = pool.starts(number)
    scores = np.empty((len(pairs), pool.races))
    for row, (i, j) in enumerate(pairs):
        ego, rival = pool.policies[i], pool.policies[j]
        setup = RaceSetup(track, pool.config, (ego.planner, rival.planner))
        state = start_races(setup, starts, pool.noise(number, i, j))
        theta = np.stack([pad_parameters([policy], setup.theta_size)[0] for policy in (ego, rival)])
        # The kernel reads a row for each race, although the policies are the same in all of them.
        theta = np.ascontiguousarray(np.broadcast_to(theta, (pool.races, *theta.shape)))
        advance(setup, state, theta, pool.config.ticks, threads=threads, ittc=False)
        scores[row] = race_scores(winners(pool.config, state))
    return {"payoffs": pool.by_fold(scores)}


def race_scores(winner: NDArray[np.int8]) -> Floats:
    """Return the score of car 0 in finished races: 1 for a win, 0 for a loss, else one half."""
    return np.where(winner == 0, 1.0, np.where(winner == 1, 0.0, 0.5))


def spanning_policies(archive: PolicyArchive, size: int) -> tuple[list[str], tuple[Policy, ...]]:
    """Return names and policies of a pool evenly spaced along an archive's first axis."""
    size = check_whole("size", size, 3, len(archive))
    order = np.argsort(archive.coordinates[:, 0], kind="stable")
    indices = order[np.linspace(0, len(order) - 1, size).round().astype(np.intp)]
    return [f"{archive.name} {i}" for i in indices], tuple(archive.policy(int(i)) for i in indices)
