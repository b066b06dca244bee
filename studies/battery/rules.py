"""Rules of the hidden battery, and races under them.

Each car has energy for some seconds of boost, refilled before each race; the opponent does not know
how much. Every few seconds both cars move: hold, boost or charge. A move is a pace of the planner:
a boost is the planner's own pace, holding is `SPEED_SCALE` slower, and charging is slower by as
much again. A boost works only near the opponent. Gaps are in bins, from the car's point of view.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.config import CONTEST
from pcs_racing.race.races import RaceSetup, advance, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

HOLD, BOOST, CHARGE = range(3)
SPEED_SCALE = 0.25
"""Difference of the speed scale between two neighbouring moves."""
EDGES = np.array([-8.0, -5.0, -3.0, -2.0, -1.2, -0.6, 0.0, 0.6, 1.2, 2.0, 3.0, 5.0, 8.0])
"""Edges of the bins of the gap, m; above 0 the car leads."""
GAPS = len(EDGES) + 1
MIDDLES = np.concatenate([[-10.0], 0.5 * (EDGES[1:] + EDGES[:-1]), [10.0]])


def gap_bins(leads: Floats) -> Indices:
    """Return the bins of gaps in m."""
    return np.searchsorted(EDGES, leads, side="right")


@dataclass(frozen=True)
class Rules:
    """Rules of the battery. Energy is counted in units: a charging move gains one."""

    energy: tuple[float, ...] = (2.0, 6.0, 12.0)  #: Types of a car: boost in a race, s.
    step: float = 2.0  #: Time from move to move, s.
    reach: float = 8.0  #: Max gap at which a boost works, m; an edge of the bins or infinite.
    charge: float = 0.5  #: Steps of boost that a charging move gains; 0 for no such move.

    @property
    def steps(self) -> int:
        """Number of moves in a race."""
        return round(CONTEST.seconds / self.step)

    @property
    def moves(self) -> int:
        """Number of different moves."""
        return 3 if self.charge > 0.0 else 2

    @property
    def cost(self) -> int:
        """Units that a boost spends."""
        return round(1.0 / self.charge) if self.charge > 0.0 else 1

    @cached_property
    def full(self) -> tuple[int, ...]:
        """Units of each type at the start of a race."""
        return tuple(round(one * self.cost / self.step) for one in self.energy)

    def after(self, full: int) -> Indices:
        """Return the units left after each move, shape (moves, full + 1)."""
        left = np.arange(full + 1)
        every = [left, np.maximum(left - self.cost, 0), np.minimum(left + 1, full)]
        return np.stack(every[: self.moves])

    def works(self, full: int) -> NDArray[np.bool_]:
        """Return where a boost works, by gap and units left, shape (GAPS, full + 1)."""
        near = np.abs(MIDDLES) < self.reach
        return near[:, None] & (np.arange(full + 1) >= self.cost)

    def effective(self, moves: Indices, gaps: Indices, left: Indices) -> Indices:
        """Return the moves with holding in place of boosts that do not work."""
        works = self.works(max(self.full))[gaps, left]
        return np.where((moves == BOOST) & ~works, HOLD, moves)


class Raced(NamedTuple):
    """Races of a batch: B races of N steps."""

    moves: Indices  #: shape (N, B, 2)
    leads: Floats  #: shape (N + 1, B): Lead of car 0 at the start and after each step, m.
    score: Floats  #: shape (B,): Score of car 0: a win 1, a tie a half.
    last: Indices  #: shape (B,): Step in which a crash ended the race; N if there was none.


Choose = Callable[[int, Floats, NDArray[np.bool_]], Indices]
"""Function from the step, the leads of car 0 and whether races are over, (B,), to both cars' moves,
(B, 2).
"""


def move_parameters(setup: RaceSetup, policy: Policy, moves: Indices) -> Floats:
    """Return the planner's parameters for moves, shape (..., P)."""
    pace, behind = policy.planner.indices(["pace", "pace_behind"])
    low, high = setup.speed_range
    slower = np.array([1.0, 0.0, 2.0])[moves] * SPEED_SCALE / (high - low)
    theta = np.broadcast_to(policy.parameters, (*moves.shape, setup.theta_size)).copy()
    theta[..., pace] = np.maximum(theta[..., pace] - slower, 0.0)
    theta[..., behind] = 0.0
    return theta


def race(
    track: Track,
    planner: str,
    rules: Rules,
    starts: Starts,
    seeds: NDArray[np.uint64],
    choose: Choose,
) -> Raced:
    """Race a batch step by step."""
    policy = parse_policy(planner)
    setup = RaceSetup(track, CONTEST, (policy.planner, policy.planner))
    state = start_races(setup, starts, seeds)
    ticks = round(100.0 * rules.step)
    leads, moves = [state.lead], []
    for step in range(rules.steps):
        moves.append(choose(step, leads[-1], state.over))
        theta = move_parameters(setup, policy, moves[-1])
        advance(setup, state, theta, ticks, threads=1, ittc=False)
        leads.append(state.lead)
    won = winners(CONTEST, state)
    last = np.where(state.crashed, (state.tick - 1) // ticks, rules.steps)
    return Raced(np.array(moves), np.array(leads), np.where(won < 0, 0.5, won == 0), last)
