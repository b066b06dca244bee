"""Races in which a network learns to choose among the candidates of the lattice, in batches.

A group is a batch of races on one circuit against one family of opponents. One compiled call drives
all races of a group for 0.1 s: it takes the chosen candidates, drives, rewards, starts ended races
again, and describes the next candidates. Threads share the groups.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import cycle, pairwise
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing import load_track, racer
from pcs_racing.base.compilation import compiled, inner_kernel
from pcs_racing.base.seeds import GOLDEN, scramble_one
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.draws import Randomization, draw_vehicles
from pcs_racing.envs.random_circuits import RandomCircuits, random_circuit
from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.candidates import SIGHT
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.line_ppo import (
    ASSERTIVENESS,
    CONTEXT,
    FIRST,
    LAID,
    LATTICE_SIZE,
    MEMORY,
    MOVE,
    PACE,
    PAIR,
    PARAMETERS,
    RISK,
    SPEED,
    STYLE,
    TOTAL,
    WEIGHTS,
    describe,
    plan_by_theta,
    put_away,
    put_back,
    take,
)
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.calibrating import hazard_scan
from pcs_racing.race.conditions import AS_THE_SETUP, vehicle_rows
from pcs_racing.race.config import CONTEST, Rules
from pcs_racing.race.driving import pointers_of
from pcs_racing.race.kernel import (
    WORK_SIZE,
    Crew,
    Races,
    Scratch,
    advance_races,
    fill_view,
    parts_for,
)
from pcs_racing.race.races import RaceSetup, start_lines
from pcs_racing.race.start_grid import Starts, place_on_grid
from pcs_racing.race.state import RaceState, take as take_races
from pcs_racing.track.track import Track

STEP = 10  # simulation steps of 0.01 s from one choice to the next
HELD_OUT = ("Saltmere", "Vellindra")
FEATURES = CONTEXT + MOVE * GOALS + SPEED * SPEEDS + PAIR * CANDIDATES
FAMILIES = {
    "self": 12,
    "frozen": 6,
    "lattice": 9,
    "iterated-best-response": 2,
    "spliner": 2,
    "stanley": 1,
    "pure-pursuit": 2,
    "gap-follower": 6,
    "disparity-extender": 2,
}
"""Families of opponents, with the number of their groups of 42."""
EXTRA = 3 + len(FAMILIES)  # features of the critic: time left, lead twice, family
WIDE = FEATURES + EXTRA

# Reward: for a metre, for a metre gained on the other car, for a win (a loss costs the same).
# Leads count up to `LEAD` m. Cost of an own fault at risk 0 and 1. Price of a lead and of a win at
# assertiveness 0 and 1, and cost of 0.1 s within `CLOSE` m of the other car at assertiveness 0.
PROGRESS, GAIN, LEAD, WIN, FAULT = 0.004, 0.02, 20.0, 1.0, (6.0, 0.5)
PRICES, CLOSE, CONTACT = (0.25, 1.5), 0.9, 0.03
DEFAULT_STYLE = 0.5  # share of the cars that race by the default style
FAST, FASTEST = 0.9, 1.6  # half of the drawn paces are between; the others below `FASTEST`
STARTS = 48  # start states of a group
PAIRS = 64  # drawn pairs of cars of a group
PAIRS_KEY = np.uint64(0xD6E8FEB86659FD93)  # makes the draw of the cars another sequence
LENGTHS = ((60.0, 120.0), (60.0, 120.0), (120.0, 200.0), (180.0, 320.0))  # m, of random circuits
WIDTHS = (2.2, 2.0, 3.0)  # m

# Rules of the groups, alternately: the contest; side by side from rest; far apart.
RULES = (
    CONTEST,
    CONTEST,
    Rules(**vars(CONTEST) | {"start": "side-by-side", "start_spacing": 0.62}),
    CONTEST,
    Rules(**vars(CONTEST) | {"start_gap": 5.0}),
)

LEARNER = Planner(name="learner", parameters=(), memory_size=MEMORY)
NUMBERS = STYLE + LATTICE_SIZE + WEIGHTS
FROZEN = Planner(
    name="frozen",
    parameters=tuple(
        Parameter(f"number{k}", -1e3, 1e3, 0.0, "style, parameter of the lattice, or weight")
        for k in range(NUMBERS)
    ),
    plan=plan_by_theta,
    memory_size=MEMORY,
    scratch_size=TOTAL,
    sight=SIGHT,
)


class Options(NamedTuple):
    """Numbers of the reward, for the compiled loop."""

    progress: float = PROGRESS
    gain: float = GAIN
    lead: float = LEAD
    win: float = WIN
    fault: float = FAULT[0]
    bold: float = FAULT[1]
    shy: float = PRICES[0]
    eager: float = PRICES[1]
    close: float = CLOSE
    contact: float = CONTACT


@inner_kernel(forceinline=True)
def count_race(state, race, row):
    """Add an ended race to a row: races, score, own faults, faults of the other car."""
    lead = state.progress[race, 0] - state.progress[race, 1]
    own, other = state.fault[race, 0] > 0, state.fault[race, 1] > 0
    score = 0.5
    if own != other:
        score = 0.0 if own else 1.0
    elif not own and abs(lead) > 0.01:
        score = 1.0 if lead > 0.0 else 0.0
    row[0] += 1.0
    row[1] += score
    row[2] += 1.0 if own else 0.0
    row[3] += 1.0 if other else 0.0


@inner_kernel(forceinline=True)
def _reward(state, race, end_tick, before, options, styles, out):
    """Write the rewards of the last 0.1 s, priced by the styles; return whether the race ended."""
    ended = state.tick[race] >= end_tick
    crashed = state.crash[race, 0] != 0 or state.crash[race, 1] != 0
    lead = state.progress[race, 0] - state.progress[race, 1]
    old = before[0] - before[1]
    gained = min(max(lead, -options.lead), options.lead) - min(
        max(old, -options.lead), options.lead
    )
    won = 0.0
    if crashed:
        at_fault = (1 if state.fault[race, 0] > 0 else 0) - (1 if state.fault[race, 1] > 0 else 0)
        won = -1.0 * at_fault
    elif ended and abs(lead) > 0.01:
        won = 1.0 if lead > 0.0 else -1.0
    x = state.cars[race, 0, 0] - state.cars[race, 1, 0]
    y = state.cars[race, 0, 1] - state.cars[race, 1, 1]
    near = max(1.0 - np.sqrt(x * x + y * y) / options.close, 0.0)
    for car in range(len(out)):
        sign = 1.0 if car == 0 else -1.0
        assertive = styles[car, ASSERTIVENESS]
        price = options.shy + (options.eager - options.shy) * assertive
        driven = state.progress[race, car] - before[car]
        out[car] = options.progress * driven - options.contact * (1.0 - assertive) * near
        out[car] += sign * price * (options.gain * gained + options.win * won)
        if crashed and state.fault[race, car] > 0:
            out[car] -= options.fault * (options.bold / options.fault) ** styles[car, RISK]
            if won == 0.0:
                out[car] -= price * options.win
    return crashed or ended


_BOX = np.array([(one.low, one.high) for one in PARAMETERS])
_BOX[PACE, 1] = FASTEST
_DEFAULT = np.array([one.default for one in PARAMETERS])


@inner_kernel(forceinline=True)
def _share(bits):
    """Return a number in [0, 1) from random bits."""
    return np.float64(bits >> np.uint64(11)) * 2.0**-53


@inner_kernel
def _draw_style(bits, out):
    """Draw the default style, or a style of the box with many high paces."""
    bits = scramble_one(bits)
    plain = _share(bits) < DEFAULT_STYLE
    bits = scramble_one(bits)
    fast = _share(bits) < 0.5
    for k in range(STYLE):
        bits = scramble_one(bits)
        low = FAST if k == PACE and fast else _BOX[k, 0]
        out[k] = _DEFAULT[k] if plain else low + _share(bits) * (_BOX[k, 1] - low)


@compiled
def begin_race(race, state, pool, thetas, span, theta, who, draws, key, drawn, vehicles):
    """Start a race again: draw a start, a noise, cars and an opponent by the race's own counter.

    ``drawn`` (N, 2, .) holds pairs of cars to draw from. The random bits of the draw are returned.
    """
    draws[race] += np.uint64(1)
    bits = scramble_one(key + draws[race] * GOLDEN)
    at = np.int64(bits % np.uint64(len(pool.tick)))
    state.tick[race] = 0
    state.seed[race] = scramble_one(bits)
    state.cars[race] = pool.cars[at]
    state.frenet[race] = pool.frenet[at]
    state.progress[race] = pool.progress[at]
    state.command[race] = pool.command[at]
    state.disturbance[race] = 0.0
    state.path[race] = 0.0
    state.memory[race] = 0.0
    state.sums[race] = 0.0
    state.crash[race] = 0
    state.fault[race] = 0
    state.leader[race] = pool.leader[at]
    state.overtakes[race] = 0
    state.laps[race] = pool.laps[at]
    state.ahead[race] = pool.ahead[at]
    state.contact[race] = 0
    one = span[0] + np.int64((bits >> np.uint64(32)) % np.uint64(span[1] - span[0]))
    who[race] = one
    if theta.shape[2] == thetas.shape[1]:
        theta[race, 1] = thetas[one]
    pair = scramble_one(bits ^ PAIRS_KEY) % np.uint64(len(drawn))
    vehicles[race] = drawn[np.int64(pair)]
    return bits


@compiled
def _begin(
    race, state, pool, thetas, span, frozen, theta, styles, who, draws, key, drawn, vehicles
):  # fmt: skip
    """Start a race again, with drawn styles."""
    bits = begin_race(race, state, pool, thetas, span, theta, who, draws, key, drawn, vehicles)
    for car in range(styles.shape[1]):
        _draw_style(bits + np.uint64(car + 1), styles[race, car])
    if frozen:
        _draw_style(bits + np.uint64(2), theta[race, 1, :STYLE])


@compiled
def play(
    track, state, pool, thetas, span, frozen, theta, styles, who, draws, key, drawn, vehicles,
    crew, settings, lattice, options, family, laid, choices, seen, rewards, ended, tally,
):  # fmt: skip
    """Take the choices, drive for 0.1 s, reward, start ended races again, and describe.

    With ``choices`` below 0 the races are only described. ``laid`` (races, learners, LAID) holds
    the candidates until they are chosen.
    """
    races, learners = laid.shape[:2]
    scratch, work, view = np.empty(TOTAL), np.zeros(WORK_SIZE), np.empty(VIEW_SIZE)
    before = np.empty((races, 2))
    if choices[0, 0] >= 0:
        for race in range(races):
            for car in range(learners):
                fill_view(track, state, race, car, vehicles[race], settings, view)
                put_back(laid[race, car], scratch)
                take(
                    track,
                    lattice,
                    styles[race, car],
                    view,
                    state.memory[race, car],
                    scratch,
                    choices[race, car],
                    state.path[race, car],
                )
        before[:] = state.progress
        batch = Races(state, theta, vehicles)
        advance_races(track, batch, settings, crew, STEP, 0, races, Scratch(scratch, work))
        for race in range(races):
            over = _reward(
                state, race, settings.end_tick, before[race], options, styles[race], rewards[race]
            )
            ended[race] = over
            if over:
                count_race(state, race, tally[who[race]] if not frozen else tally[0])
                _begin(
                    race, state, pool, thetas, span, frozen, theta, styles, who, draws, key, drawn,
                    vehicles,
                )  # fmt: skip
    for race in range(races):
        for car in range(learners):
            fill_view(track, state, race, car, vehicles[race], settings, view)
            describe(track, lattice, styles[race, car], view, state.memory[race, car], scratch)
            put_away(scratch, laid[race, car])
            out = seen[race, car]
            for k in range(FEATURES):
                out[k] = scratch[FIRST + k]
            lead = state.progress[race, car] - state.progress[race, 1 - car]
            out[FEATURES:] = 0.0
            out[FEATURES] = 1.0 - state.tick[race] / settings.end_tick
            out[FEATURES + 1] = min(max(lead / 3.0, -1.0), 1.0)
            out[FEATURES + 2] = min(max(lead / 20.0, -1.0), 1.0)
            out[FEATURES + 3 + family] = 1.0


@dataclass(frozen=True)
class Circuit:
    """Track of a group, with its training starts."""

    track: Track
    lines: NDArray[np.float64]  #: Arc lengths of the start lines, m.


def circuit(name: str | int) -> Circuit:
    """Return a shipped circuit by its name, or a random circuit by its number.

    A random circuit gets the speed range of its hazard, as shipped circuits have.
    """
    if isinstance(name, str):
        track = load_track(name)
    else:
        shortest, longest = LENGTHS[name % len(LENGTHS)]
        width = WIDTHS[name // len(LENGTHS) % len(WIDTHS)]
        drawn = RandomCircuits(width=width, shortest=shortest, longest=longest)
        made = random_circuit(drawn, name)
        scales = np.arange(0.7, 1.46, 0.05)
        hazard = hazard_scan(made, CONTEST, scales, cars=40, seconds=20.0, enough=0.5, threads=1)
        high = min(float(scales[len(hazard) - 1]), 1.43)
        own = made.calibration["contest"]
        track = replace(made, calibration={"contest": replace(own, speed_range=(high - 0.4, high))})
    return Circuit(track, start_lines(track, CONTEST, 0, split="train"))


def lattices() -> list[Policy]:
    """Return the lattices to race against: often the default, and others."""
    slower = [{"pace": pace, "pace_behind": 0.1} for pace in (0.9, 0.6, 0.3, 0.0)]
    other = [{"side_margin": 0.15}, {"side_margin": 0.4}, {"blocking": 0.9}, {"pace": 1.45}]
    rng = np.random.default_rng(0)
    policies = [LATTICE.policy()] * 18
    early = ("lattice:early", "lattice:early,pace=0.7,pace_behind=0.2")
    policies += [racer(text) for text in early] * 2
    policies += [LATTICE.policy(values, "lattice-variant") for values in slower + other]
    archive = load_archive("contest")
    policies += [archive.policy(k) for k in range(len(archive))]
    return policies + [LATTICE.policy(LATTICE.sample(rng), "lattice-random") for _ in range(5)]


def opponents(family: str) -> list[Policy]:
    """Return the policies of a family of the zoo, the default first."""
    if family == "lattice":
        return lattices()
    default = racer(family)
    planner, names = default.planner, default.planner.parameter_names
    policies = [default] * 2
    for name, shares in (
        ("pace", (0.0, 0.5, 0.8)),
        ("speed_share", (0.5, 0.8)),
        ("top_speed", (0.3,)),
    ):
        if name in names:
            k = names.index(name)
            low, high = planner.bounds[k]
            policies += [
                planner.policy({name: low + share * (high - low)}, f"{family}-slower")
                for share in shares
            ]
    return policies


class Group:
    """Races on one circuit against one family of opponents."""

    def __init__(
        self, circuit: Circuit, family: str, rules: Rules, cars: int, seed: int,
        league: "League", ranges: Randomization,
    ) -> None:  # fmt: skip
        self.family, self.number = family, list(FAMILIES).index(family)
        self.league, track = league, circuit.track
        self.name = track.name
        if family == "self":
            other, self.policies = LEARNER, []
            self.thetas = np.zeros((1, 1))
        elif family == "frozen":
            other, self.policies, self.thetas = FROZEN, [], league.numbers
        else:
            self.policies = opponents(family)
            other = self.policies[0].planner
            size = max(1, len(other.parameters))
            self.thetas = np.zeros((len(self.policies), size))
            for row, policy in zip(self.thetas, self.policies, strict=True):
                row[: len(policy.parameters)] = policy.parameters
        self.learners = 2 if family == "self" else 1
        self.races = max(1, cars // self.learners)
        setup = RaceSetup(track, rules, (LEARNER, other), max_delays=ranges.max_delays)
        self.track, self.settings = track.arrays, setup.settings._replace(ittc_horizon=0.0)
        drivers = pointers_of(AS_THE_SETUP.shares(setup.planners, self.races), self.races)
        self.vehicles = vehicle_rows(setup.vehicles, self.races)
        self.drawn = drawn_pairs(ranges, seed)
        self.crew = Crew(drivers, parts_for(self.settings, self.drawn, False))
        rng = np.random.default_rng(seed)
        self.key = np.uint64(rng.integers(2**63))
        self.pool = start_states(setup, circuit.lines, rng)
        self.state = take_races(self.pool, rng.integers(len(self.pool.tick), size=self.races))
        self.theta = np.zeros((self.races, 2, self.thetas.shape[1]))
        self.styles = np.zeros((self.races, self.learners, STYLE))
        self.who = np.zeros(self.races, np.int64)
        self.draws = np.arange(self.races, dtype=np.uint64) << np.uint64(32)
        self.ended = np.zeros(self.races, np.bool_)
        self.tally = np.zeros((max(1, len(self.policies)), 4))
        self.laid = np.zeros((self.races, self.learners, LAID))
        for race in range(self.races):
            _begin(race, self.state, self.pool, self.thetas, self.span, self.family == "frozen",
                   self.theta, self.styles, self.who, self.draws, self.key, self.drawn,
                   self.vehicles)  # fmt: skip
        # Races end at different times, so that a batch holds all parts of a race.
        self.state.tick[:] = STEP * rng.integers(self.settings.end_tick // STEP, size=self.races)

    @property
    def cars(self) -> int:
        """Number of learning cars."""
        return self.races * self.learners

    @property
    def span(self) -> tuple[int, int]:
        """First opponent to draw, and the last one + 1."""
        return self.league.span if self.family == "frozen" else (0, len(self.thetas))

    def saved(self) -> list[NDArray[Any]]:
        """Return all that changes while races go on, for a checkpoint."""
        return [*self.state, self.who, self.draws, self.theta, self.styles, self.vehicles]

    def restore(self, saved: Sequence[NDArray[Any]]) -> None:
        """Go on from a checkpoint."""
        for array, value in zip(self.saved(), saved, strict=True):
            array[:] = value

    def play(
        self, choices: Any, seen: Any, rewards: Any, ended: Any, options: Options, lattice: Any
    ) -> None:
        """Drive for 0.1 s; see `play`."""
        two = (self.races, self.learners)
        play(
            self.track, self.state, self.pool, self.thetas, self.span, self.family == "frozen",
            self.theta, self.styles, self.who, self.draws, self.key, self.drawn, self.vehicles,
            self.crew, self.settings, lattice, options, self.number, self.laid,
            choices.reshape(two), seen.reshape(*two, WIDE), rewards.reshape(two), self.ended,
            self.tally,
        )  # fmt: skip
        ended.reshape(two)[:] = self.ended[:, None]


def drawn_pairs(ranges: Randomization, seed: int, count: int = PAIRS) -> NDArray[np.float64]:
    """Return drawn pairs of cars, shape (count, 2, .); without ranges one pair."""
    rng, cars = np.random.default_rng([seed, 1]), (F1TENTH, F1TENTH)
    numbers = range(count if ranges.names else 1)
    drawn = [vehicle_rows(draw_vehicles(ranges, cars, rng), 1) for _ in numbers]
    return np.concatenate(drawn)


def start_states(
    setup: RaceSetup, lines: NDArray[np.float64], rng: np.random.Generator
) -> RaceState:
    """Return start states of a group; in each of them no car overlaps a wall."""
    starts = Starts(rng.choice(lines, STARTS), np.arange(STARTS) % 2)
    state = place_on_grid(
        setup.track,
        setup.rules,
        setup.start_spacing,
        setup.speed_range[0],
        setup.vehicles,
        starts,
        setup.memory_size,
    )
    return take_races(state, np.flatnonzero(~state.crashed))


class League:
    """Frozen selves: default style, lattice and weights, the last `LAST` of them in use."""

    LAST, MOST = 8, 512

    def __init__(self, numbers: NDArray[np.float64]) -> None:
        self.numbers = np.zeros((self.MOST, NUMBERS))
        self.count = 0
        self.add(numbers)

    def add(self, numbers: NDArray[np.float64]) -> None:
        """Add a frozen self, while there is room."""
        if self.count < self.MOST:
            self.numbers[self.count] = numbers
            self.count += 1

    @property
    def span(self) -> tuple[int, int]:
        """First frozen self in use, and the last one + 1."""
        return max(0, self.count - self.LAST), self.count


class Batch:
    """Groups that are driven together; one of several batches drives while another chooses.

    Each group gets the ``given`` arguments in each call.
    """

    def __init__(
        self, groups: Sequence[Any], pool: ThreadPoolExecutor, threads: int, wide: int, **given: Any
    ) -> None:
        self.groups, self.pool, self.threads, self.given = list(groups), pool, threads, given
        edges = np.cumsum([0, *(group.cars for group in groups)])
        self.slices = [slice(a, b) for a, b in pairwise(edges.tolist())]
        self.cars = int(edges[-1])
        self.seen = np.zeros((self.cars, wide), np.float32)
        self.rewards = np.zeros(self.cars)
        self.ended = np.zeros(self.cars, np.bool_)
        self.work: list[Future[None]] = []

    def play(self, *arrays: NDArray[Any], **options: Any) -> None:
        """Begin to drive for 0.1 s; the results are there after `wait`.

        Each group gets its rows of the ``arrays``, which lead its arguments.
        """
        # Threads take the next group from one iterator.
        rest = iter(list(zip(self.groups, self.slices, strict=True)))
        rows = (*arrays, self.seen, self.rewards, self.ended)

        def some() -> None:
            for group, part in rest:
                group.play(*(array[part] for array in rows), **self.given, **options)

        self.work = [self.pool.submit(some) for _ in range(self.threads)]

    def wait(self) -> None:
        """Wait for all groups."""
        for one in self.work:
            one.result()
        self.work = []


def in_turn(families: Mapping[str, int], seed: int) -> Iterator[str]:
    """Return families in a random order, each as often as its number says, again and again."""
    names = [name for name, count in families.items() for _ in range(count)]
    return cycle(names[k] for k in np.random.default_rng(seed).permutation(len(names)))


def make_groups(
    circuits: Sequence[Circuit], cars: int, seed: int, league: League, ranges: Randomization
) -> list[Group]:
    """Return a group for each circuit, with ``cars`` learning cars, families alternately."""
    families = in_turn(FAMILIES, seed)
    return [
        Group(one, family, RULES[k % len(RULES)], cars, 1000 * seed + k, league, ranges)
        for k, (one, family) in enumerate(zip(circuits, families, strict=False))
    ]


def compile_for(family: str) -> None:
    """Compile, for all later processes, the code of the races against a family."""
    league = League(np.zeros(NUMBERS))
    group = Group(circuit("Pipkin"), family, CONTEST, 2, 0, league, Randomization())
    cars, lattice = group.cars, LATTICE.policy().parameters.copy()
    seen = np.zeros((cars, WIDE), np.float32)
    for choices in (np.full(cars, -1), np.zeros(cars, np.int64)):
        ended = np.zeros(cars, np.bool_)
        group.play(choices, seen, np.zeros(cars), ended, options=Options(), lattice=lattice)


def prepare(
    names: Sequence[str | int], workers: int, compile_one: Callable[..., None], *given: Any
) -> list[Circuit]:
    """Return circuits by name or number; processes make them, and compile all other code.

    Code is compiled by a call for each tuple of arguments in ``given``.
    """
    if workers <= 1:
        return [circuit(name) for name in names]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        compiling = [pool.submit(compile_one, *one) for one in given]
        circuits = list(pool.map(circuit, names))
        for one in compiling:
            one.result()
    return circuits
