"""Races in which a network learns to drive by lidar, in batches, as in `line_races`.

A group is a batch of races on one circuit against one family of opponents. One compiled call drives
all races of a group for 0.1 s: it takes the commands, drives, rewards, starts ended races again,
scans, and asks a teacher with a map for its command in the same place. Threads share the groups.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from line_races import (
    STEP,
    Batch,
    Circuit,
    begin_race,
    circuit,
    count_race,
    drawn_pairs,
    in_turn,
    start_states,
)
from numpy.typing import NDArray

from pcs_racing import load_track, racer, run_races
from pcs_racing.base.compilation import compiled, inner_kernel
from pcs_racing.envs.draws import Randomization
from pcs_racing.planners import view as _view
from pcs_racing.planners.calling import call_control, call_plan
from pcs_racing.planners.field.lidar_ppo import (
    MEMORY,
    PUSH,
    SCRATCH,
    SEEN,
    WEIGHTS,
    lay_command,
    max_curvature,
    observe,
    plan_by_theta,
)
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.pursuit import pursuit_arc
from pcs_racing.planners.scanning import follow_scan
from pcs_racing.planners.view import PATH_COLUMNS, PATH_POINTS, VIEW_SIZE
from pcs_racing.race.conditions import AS_THE_SETUP, vehicle_rows
from pcs_racing.race.config import CONTEST
from pcs_racing.race.driving import largest_scratch, pointers_of
from pcs_racing.race.kernel import (
    WORK_SIZE,
    Crew,
    Races,
    Scratch,
    advance_races,
    fill_view,
    parts_for,
)
from pcs_racing.race.races import RaceSetup
from pcs_racing.race.state import take as take_races
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between, shorter_way

FAMILIES = {
    "self": 14,
    "pure-pursuit": 8,
    "lattice": 5,
    "stanley": 2,
    "spliner": 2,
    "gap-follower": 7,
    "disparity-extender": 2,
}
"""Families of opponents, with the number of their groups of 40."""
OF_LINES = ("pure-pursuit", "lattice", "stanley", "spliner")
SLOWDOWN = (1.0, 0.75, 1.0, 0.6, 0.85, 0.5, 1.0)
"""Factors of the speeds of planners that follow lines, group after group."""
REST = replace(CONTEST, start_gap=3.0, start_spacing=0.0, start_speed=0.0, duration=16.0)
REST_EVERY = 3  # groups; one of them starts at rest, 3 m apart

# Opponents in self-play: the network itself, the network at a share of its speed, a frozen one.
LIVE, SLOW, FROZEN = 0, 1, 2
OLD = 4  # frozen networks
AIM, AIM_TIME = 0.5, 0.2  # m and s: distance of the point of the teacher's path that it aims at
HELD = 1.2  # a speed that is held for 0.1 s changes the car's speed by 0.63 of the difference
BENDS, WIDTHS = 10, 4  # places ahead that the critic knows
EXTRA = 13 + 2 * BENDS + 2 * WIDTHS + len(FAMILIES)
WIDE = SEEN + EXTRA
ACTIONS = 2

LEARNER = Planner(name="learner", parameters=(), control=follow_scan, memory_size=MEMORY)
BY_THETA = Planner(
    name="lidar-ppo",
    parameters=(
        Parameter("speed_share", 0.3, 1.1, 1.0, "factor of the speed"),
        *(Parameter(f"number{k}", -1e3, 1e3, 0.0, "weight") for k in range(WEIGHTS)),
    ),
    plan=plan_by_theta,
    control=follow_scan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
)


class Options(NamedTuple):
    """Numbers of the reward, for the compiled loop."""

    progress: float = 0.01  #: Reward of a metre.
    gain: float = 0.02  #: Reward of a metre gained on the other car, up to a lead of `far`.
    far: float = 20.0  #: m.
    passing: float = 1.0  #: Reward of the way from `near` behind to `near` ahead.
    near: float = 2.0  #: m.
    win: float = 1.0  #: Reward of a win; a loss costs the same.
    fault: float = 2.0  #: Cost of an own fault, in addition to the lost race.


@inner_kernel(forceinline=True)
def _bounded(value, bound):
    return min(max(value, -bound), bound)


@inner_kernel(forceinline=True)
def _worth(lead, options):
    """Return the worth of a lead (m); its increase is the reward of a car."""
    close = _bounded(lead / options.near, 1.0)
    return options.gain * _bounded(lead, options.far) + 0.5 * options.passing * close


@inner_kernel(forceinline=True)
def _reward(state, race, end_tick, before, options, out):
    """Write the rewards of the last 0.1 s; return whether the race ended."""
    ended = state.tick[race] >= end_tick
    crashed = state.crash[race, 0] != 0 or state.crash[race, 1] != 0
    lead = state.progress[race, 0] - state.progress[race, 1]
    gained = _worth(lead, options) - _worth(before[0] - before[1], options)
    won = 0.0
    if crashed:
        at_fault = (1 if state.fault[race, 0] > 0 else 0) - (1 if state.fault[race, 1] > 0 else 0)
        won = -1.0 * at_fault
    elif ended and abs(lead) > 0.01:
        won = 1.0 if lead > 0.0 else -1.0
    for car in range(len(out)):
        sign = 1.0 if car == 0 else -1.0
        driven = state.progress[race, car] - before[car]
        out[car] = options.progress * driven + sign * (gained + options.win * won)
        if crashed and state.fault[race, car] > 0:
            out[car] -= options.fault
            if won == 0.0:
                out[car] -= options.win
    return crashed or ended


@inner_kernel
def _tell(track, view, left, slow, family, out):
    """Write the critic's extra inputs, all of order one, into ``out``, shape (EXTRA,)."""
    line, count = track.line, track.line.shape[0]
    s, v = view[_view.OWN_S], view[_view.OWN_V]
    here = int(s / track.ds) % count
    gap = view[_view.GAP]
    near_gap = shorter_way(track.length, gap)
    near = max(1.0 - abs(near_gap) / 10.0, 0.0)
    course = view[_view.OWN_PSI] + view[_view.OWN_BETA]
    out[0] = left
    out[1] = _bounded(gap / 3.0, 1.0)
    out[2] = _bounded(gap / 20.0, 1.0)
    out[3] = view[_view.OWN_D]
    out[4] = 3.0 * angle_between(course, line[here, _frenet.PSI])
    out[5] = v / 8.0
    out[6] = 2.0 * (v / line[here, _frenet.SPEED] - 1.0)
    out[7] = 5.0 * view[_view.OWN_BETA]
    out[8] = near * _bounded(near_gap / 2.0, 2.0)
    out[9] = near * (view[_view.OPP_D] - view[_view.OWN_D])
    out[10] = near * _bounded(view[_view.OPP_D_DOT], 2.0)
    out[11] = near * (view[_view.OPP_V] - v) / 3.0
    out[12] = slow
    for j in range(BENDS):
        i = int((s + j * (0.6 + 0.15 * v)) / track.ds) % count
        out[13 + j] = 2.0 * line[i, _frenet.KAPPA]
        out[13 + BENDS + j] = line[i, _frenet.SPEED] / 8.0 - 1.0
    for j in range(WIDTHS):
        i = int((s + j * (0.6 + 0.2 * v)) / track.ds) % count
        out[13 + 2 * BENDS + j] = min(line[i, _frenet.LEFT], 2.0)
        out[13 + 2 * BENDS + WIDTHS + j] = min(line[i, _frenet.RIGHT], 2.0)
    out[13 + 2 * BENDS + 2 * WIDTHS :] = 0.0
    out[13 + 2 * BENDS + 2 * WIDTHS + family] = 1.0


@inner_kernel
def _teach(track, teacher, theta, view, memory, scratch, path, command, out):
    """Write the teacher's command as the network would give it: the arc to its path, its speed."""
    call_plan(teacher[0], (track, theta, view, memory, scratch, path))
    call_control(teacher[1], (track, theta, view, memory, scratch, path, command))
    v = view[_view.OWN_V]
    reach, at, far = AIM + AIM_TIME * v, 0, 0.0
    for j in range(PATH_POINTS):
        dx = path[j, _view.PATH_X] - view[_view.OWN_X]
        dy = path[j, _view.PATH_Y] - view[_view.OWN_Y]
        at, far = j, np.sqrt(dx * dx + dy * dy)
        if far > reach:
            break
    arc = pursuit_arc(
        view, path[at, _view.PATH_X], path[at, _view.PATH_Y], path[0, _view.PATH_KAPPA]
    )
    out[0] = _bounded(arc / max_curvature(v), 1.0)
    out[1] = _bounded(HELD * (command[1] - v) / PUSH, 1.0)


@inner_kernel(forceinline=True)
def _share(kind, draw):
    """Return the speed share of the second car: a number drawn uniformly decides it."""
    if kind == LIVE:
        return 1.0
    if kind == SLOW:
        return 0.4 + 0.65 * draw
    return 1.0 if draw < 0.5 else 0.4 + 1.3 * (draw - 0.5)


@compiled
def play(
    track, state, pool, thetas, span, theta, who, draws, key, drawn, vehicles, crew, settings,
    options, family, slow, kinds, shares, teacher, lesson, lessons, ways, taught, actions, seen,
    rewards, ended, tally, size, first,
):  # fmt: skip
    """Take the commands, drive for 0.1 s, reward, start ended races again, scan, and teach.

    With ``first`` the races are only scanned. ``kinds`` (races,) are the opponents of self-play,
    ``shares`` (races, 2) the speed shares; ``lessons`` and ``ways`` hold memory and path of the
    teacher, whose memory is empty if there is no teacher.
    """
    races, learners = actions.shape[:2]
    scratch, work, view = np.empty(size), np.zeros(WORK_SIZE), np.empty(VIEW_SIZE)
    before, command = np.empty((races, 2)), np.zeros(2)
    if not first:
        for race in range(races):
            for car in range(learners):
                fill_view(track, state, race, car, vehicles[race], settings, view)
                lay_command(
                    view,
                    shares[race, car],
                    state.memory[race, car],
                    _bounded(actions[race, car, 0], 1.0),
                    _bounded(actions[race, car, 1], 1.0),
                    state.path[race, car],
                )
        before[:] = state.progress
        batch = Races(state, theta, vehicles)
        advance_races(track, batch, settings, crew, STEP, 0, races, Scratch(scratch, work))
        for race in range(races):
            over = _reward(state, race, settings.end_tick, before[race], options, rewards[race])
            ended[race] = over
            if over:
                count_race(state, race, tally[0])
                begin_race(race, state, pool, thetas, span, theta, who, draws, key, drawn, vehicles)
                lessons[race] = 0.0
                draw = np.float64(state.seed[race] >> np.uint64(40)) / 2.0**24
                shares[race, 1] = _share(kinds[race], draw)
    for race in range(races):
        for car in range(learners):
            fill_view(track, state, race, car, vehicles[race], settings, view)
            out = seen[race, car]
            own = scratch[SCRATCH - SEEN : SCRATCH]
            observe(track, view, shares[race, car], state.memory[race, car], scratch, own)
            for k in range(SEEN):
                out[k] = own[k]
            left = 1.0 - state.tick[race] / settings.end_tick
            other = slow * shares[race, 1 - car]
            own = scratch[:EXTRA]
            _tell(track, view, left, other, family, own)
            for k in range(EXTRA):
                out[SEEN + k] = own[k]
            if lessons.shape[2] > 0:
                _teach(
                    track, teacher, lesson, view, lessons[race, car], scratch, ways[race, car],
                    command, taught[race, car],
                )  # fmt: skip


def opponents(family: str) -> list[Policy]:
    """Return the policies of a family of the zoo, the default first."""
    early = "lattice:early,pace="
    texts = {
        "pure-pursuit": [
            *["pure-pursuit"] * 4,
            *(f"pure-pursuit:pace={pace}" for pace in (0.0, 0.3, 0.7, 0.9)),
            "pure-pursuit:follow_distance=0",
            "pure-pursuit:pace=0.2,follow_distance=0",
        ],
        "lattice": [
            *["lattice:early"] * 2,
            *(f"{early}{pace}" for pace in (0.0, 0.3, 0.6, 0.8)),
            f"{early}0.3,blocking=0.8",
            "lattice",
        ],
        "stanley": ["stanley", *(f"stanley:pace={pace}" for pace in (0.0, 0.3, 0.7))],
        "spliner": ["spliner", *(f"spliner:pace={pace}" for pace in (0.0, 0.3, 0.7))],
        "gap-follower": ["gap-follower"]
        + [f"gap-follower:top_speed={top}" for top in (3.0, 4.0, 5.0, 6.0)],
        "disparity-extender": ["disparity-extender", "disparity-extender:calm"]
        + [f"disparity-extender:top_speed={top}" for top in (3.0, 4.5)],
    }
    return [racer(text) for text in texts[family]]


class Group:
    """Races on one circuit against one family of opponents."""

    def __init__(
        self, circuit: Circuit, family: str, cars: int, seed: int, number: int, teacher: Policy,
        ranges: Randomization,
    ) -> None:  # fmt: skip
        self.family, self.number, track = family, list(FAMILIES).index(family), circuit.track
        self.name, self.teacher = track.name, teacher
        self.policies = policies = [] if family == "self" else opponents(family)
        other = policies[0].planner if policies else LEARNER
        self.thetas = np.zeros((max(1, len(policies)), max(1, len(other.parameters))))
        for row, policy in zip(self.thetas, policies, strict=False):
            row[: len(policy.parameters)] = policy.parameters
        self.learners = 2 if family == "self" else 1
        self.races = max(1, cars // self.learners)
        planners = (LEARNER, other)
        setup = RaceSetup(track, CONTEST, planners, max_delays=ranges.max_delays)
        if number % REST_EVERY == 0:
            setup = replace(setup, rules=replace(REST, speed_range=setup.speed_range))
        self.slow = SLOWDOWN[number % len(SLOWDOWN)] if family in OF_LINES else 1.0
        self.track = track.arrays
        self.settings = setup.settings._replace(
            ittc_horizon=0.0,
            speed_low=self.slow * setup.settings.speed_low,
            speed_high=self.slow * setup.settings.speed_high,
        )
        # The teacher is as fast as in a race at full speed; its settings are in its view.
        drivers = pointers_of(AS_THE_SETUP.shares(setup.planners, self.races), self.races)
        self.vehicles = vehicle_rows(setup.vehicles, self.races)
        self.drawn = drawn_pairs(ranges, seed)
        self.crew = Crew(drivers, parts_for(self.settings, self.drawn, False))
        self.size = max(SCRATCH, largest_scratch((other, teacher.planner)), EXTRA)
        rng = np.random.default_rng(seed)
        self.key = np.uint64(rng.integers(2**63))
        self.pool = start_states(setup, circuit.lines, rng)
        self.state = take_races(self.pool, rng.integers(len(self.pool.tick), size=self.races))
        self.theta = np.zeros((self.races, 2, self.thetas.shape[1]))
        self.who = np.zeros(self.races, np.int64)
        self.draws = np.arange(self.races, dtype=np.uint64) << np.uint64(32)
        self.ended = np.zeros(self.races, np.bool_)
        self.tally = np.zeros((1, 4))
        # Half of the races of self-play are against a network that does not learn there.
        row = np.arange(self.races) + number
        old = FROZEN + row // 4 % OLD
        self.kinds = np.where(row % 4 < 2, LIVE, np.where(row % 4 == 2, SLOW, old))
        if family != "self":
            self.kinds[:] = LIVE
        self.shares = np.ones((self.races, 2))
        self.shares[:, 1] = [
            _share_of(kind, draw)
            for kind, draw in zip(self.kinds, rng.uniform(size=self.races), strict=True)
        ]
        self.lessons = np.zeros((self.races, self.learners, max(1, teacher.planner.memory_total)))
        self.ways = np.zeros((self.races, self.learners, PATH_POINTS, PATH_COLUMNS))
        self.teacher_at = pointers_of(AS_THE_SETUP.shares((teacher.planner,), 1), 1)[0][0]
        self.lesson = teacher.parameters.copy() if len(teacher.parameters) else np.zeros(1)
        for race in range(self.races):
            begin_race(race, self.state, self.pool, self.thetas, self.span, self.theta, self.who,
                       self.draws, self.key, self.drawn, self.vehicles)  # fmt: skip
        # Races end at different times, so that a batch holds all parts of a race.
        self.state.tick[:] = STEP * rng.integers(self.settings.end_tick // STEP, size=self.races)

    @property
    def cars(self) -> int:
        """Number of cars that networks drive."""
        return self.races * self.learners

    @property
    def span(self) -> tuple[int, int]:
        """First opponent to draw, and the last one + 1."""
        return 0, len(self.thetas)

    @property
    def drivers_of_cars(self) -> NDArray[np.int64]:
        """Kind of the network of each car, shape (cars,)."""
        kinds = np.zeros((self.races, self.learners), np.int64)
        kinds[:, -1] = self.kinds
        return kinds.ravel()

    def saved(self) -> list[NDArray[Any]]:
        """Return all that changes while races go on, for a checkpoint."""
        own = self.who, self.draws, self.shares, self.lessons, self.ways, self.vehicles
        return [*self.state, *own]

    def restore(self, saved: Sequence[NDArray[Any]]) -> None:
        """Go on from a checkpoint."""
        for array, value in zip(self.saved(), saved, strict=True):
            array[:] = value
        if self.theta.shape[2] == self.thetas.shape[1]:
            self.theta[:, 1] = self.thetas[self.who]

    def play(
        self, actions: Any, taught: Any, seen: Any, rewards: Any, ended: Any, *, options: Options,
        first: bool = False, teach: bool = True,
    ) -> None:  # fmt: skip
        """Drive for 0.1 s; see `play`."""
        two = (self.races, self.learners)
        lessons = self.lessons if teach else self.lessons[:, :, :0].copy()
        play(
            self.track, self.state, self.pool, self.thetas, self.span, self.theta, self.who,
            self.draws, self.key, self.drawn, self.vehicles, self.crew, self.settings, options,
            self.number, self.slow, self.kinds, self.shares, self.teacher_at, self.lesson, lessons,
            self.ways, taught.reshape(*two, ACTIONS), actions.reshape(*two, ACTIONS),
            seen.reshape(*two, WIDE), rewards.reshape(two), self.ended, self.tally, self.size,
            first,
        )  # fmt: skip
        ended.reshape(two)[:] = self.ended[:, None]


def _share_of(kind: int, draw: float) -> float:
    return float(getattr(_share, "py_func", _share)(kind, draw))


class LidarBatch(Batch):
    """Batch with commands of the network and of the teacher."""

    def __init__(
        self, groups: Sequence[Group], pool: ThreadPoolExecutor, threads: int, options: Options
    ) -> None:
        super().__init__(groups, pool, threads, WIDE, options=options)
        self.kinds = np.concatenate([group.drivers_of_cars for group in groups])
        self.actions = np.zeros((self.cars, ACTIONS), np.float32)
        self.taught = np.zeros((self.cars, ACTIONS), np.float32)

    def price(self, fault: float) -> None:
        """Change the cost of an own fault."""
        self.given["options"] = self.given["options"]._replace(fault=fault)


def make_groups(
    circuits: Sequence[Circuit], cars: int, seed: int, teacher: Policy, ranges: Randomization
) -> list[Group]:
    """Return a group for each circuit, with ``cars`` cars, families alternately."""
    families = in_turn(FAMILIES, seed)
    return [
        Group(one, family, cars, 1000 * seed + k, k, teacher, ranges)
        for k, (one, family) in enumerate(zip(circuits, families, strict=False))
    ]


def compile_for(family: str, teacher: Policy) -> None:
    """Compile, for all later processes, the code of the races against a family."""
    group = Group(circuit("Pipkin"), family, 2, 0, 1, teacher, Randomization())
    two = np.zeros((group.cars, ACTIONS), np.float32)
    seen, ended = np.zeros((group.cars, WIDE), np.float32), np.zeros(group.cars, np.bool_)
    for first in (True, False):
        group.play(
            two, two.copy(), seen, np.zeros(group.cars), ended, options=Options(), first=first
        )
    rival = group.policies[0] if group.policies else "pure-pursuit"
    run_races(load_track("Pipkin"), BY_THETA.policy(), rival, "contest", seed=0, threads=1)
