"""Races between cars, one or thousands at once: start, advance, and results."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_seed
from pcs_racing.base.seeds import race_seed, random_bits
from pcs_racing.car.vehicle import (
    COMMAND_PERIOD,
    F1TENTH,
    OPPONENT_DELAY,
    SPEED_DELAY,
    STEER_DELAY,
    VehicleParams,
    load_vehicles,
)
from pcs_racing.planners.pursuit import COMMAND_SLOTS
from pcs_racing.race.calibration import calibration_of, known_rules, start_layout, starts_for
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import DT, PAPER, Rules, load_rules
from pcs_racing.race.driving import advance, kernel_settings, largest_theta, pad_parameters
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.sensing import history_size
from pcs_racing.race.start_grid import (
    Starts,
    place_on_grid,
    places_of,
    places_of_grid,
    split_places,
)
from pcs_racing.race.state import MAX_CARS, NO_CRASH, RaceState, concatenate, empty_state, take
from pcs_racing.track.track import Track

if TYPE_CHECKING:
    from pcs_racing.planners.planner import Planner, Policy

TIE_WITHIN = 0.01  # m of lead

HANDICAP_DRAW = 1000  # attempt of `random_bits`; draws of games have lower ones

Drivers = Any
"""Racer of a car in all races (:func:`pcs_racing.racer`), or a list of a racer for each race."""


@dataclass(frozen=True, eq=False)
class RaceSetup:
    """Constants of a batch of races: track, rules, and the planners and vehicles of 1 to 8 cars."""

    track: Track
    rules: Rules
    planners: "tuple[Planner, ...]"  #: Planner of each car that is not steered, in order.
    vehicles: tuple[VehicleParams, ...] = ()  #: Vehicle of each car; F1TENTH's if empty.
    #: Car with the max of each delay of the cars in races with their own cars
    #: (:class:`RaceConditions`).
    max_delays: VehicleParams = F1TENTH
    #: Number of cars that are steered from outside, the first ones: their memory begins with the
    #: command, a steering angle (rad) and a speed (m/s).
    steered: int = 0
    #: Planners of races with their own planners (:class:`RaceConditions`): the state of a race has
    #: room for their memory and parameters.
    substitutes: "tuple[Planner, ...]" = ()

    def __post_init__(self) -> None:
        cars = self.steered + len(self.planners)
        if not 1 <= cars <= MAX_CARS or len(self.vehicles) not in (0, cars):
            raise InputError(
                f"there are {cars} planners and {len(self.vehicles)} cars; a race has"
                f" 1 to {MAX_CARS} planners, and a car for each of them"
            )
        object.__setattr__(self, "vehicles", self.vehicles or (F1TENTH,) * cars)

    @property
    def car_planners(self) -> "tuple[Planner | None, ...]":
        """Planner of each car; None for a car that is steered from outside."""
        return (None,) * self.steered + self.planners

    @cached_property
    def memory_size(self) -> int:
        """Size of each car's memory in the state: planner memory, history of cars that are seen
        late, and queues of delayed commands.
        """
        command = COMMAND_SLOTS if self.steered else 0
        planners = self.planners + self.substitutes
        sizes = [command, *(planner.memory_total for planner in planners)]
        late = (*self.vehicles, self.max_delays)
        return max(sizes) + history_size(late, len(self.vehicles)) + queue_size(late)

    @cached_property
    def theta_size(self) -> int:
        """Maximum length of the planners' parameter vectors."""
        return largest_theta(self.planners + self.substitutes)

    @cached_property
    def speed_range(self) -> tuple[float, float]:
        """Speed scales of pace 0 and pace 1: the rules', else the track's calibration."""
        return self.rules.speed_range or calibration_of(self.track, self.rules).speed_range

    @cached_property
    def start_spacing(self) -> float:
        """Distance between the cars across the track at the start, m.

        It is the feasible distance nearest to the rules'.
        """
        if start_layout(self.rules) != start_layout(known_rules(self.rules)):
            return self.rules.start_spacing
        return calibration_of(self.track, self.rules).start_spacing

    @cached_property
    def settings(self) -> KernelSettings:
        """Numbers that the compiled loop needs."""
        return kernel_settings(self.rules, self.speed_range)


def queue_size(vehicles: Sequence[VehicleParams]) -> int:
    """Return the size of the queues of delayed commands in the memory of any of the cars."""
    steering = max(vehicle.steer_delay for vehicle in vehicles)
    return round((steering + max(vehicle.speed_delay for vehicle in vehicles)) / COMMAND_PERIOD)


def start_lines(
    track: Track, rules: Rules, seed: int | np.random.SeedSequence, *, split: str = "test"
) -> NDArray[np.float64]:
    """Return the arc lengths (m) of ``rules.start_lines`` valid start lines, in random order.

    Training games start from other places than test races
    (:func:`pcs_racing.race.start_grid.split_places`). Lines repeat if the track has fewer places.
    """
    rng = np.random.default_rng(seed)
    known = starts_for(track, rules)
    sides = [split_places(places_of(stretches), split) for stretches in known.start_places.values()]
    if len(sides) == 2 and min(map(len, sides)) > 0:
        # Rounded up or down at random, so that no number of lines favours a side.
        left = min(int(known.left_share * rules.start_lines + rng.uniform()), rules.start_lines)
        wanted = [left, rules.start_lines - left]
    else:  # a side with a single place has no place in one split
        wanted = [rules.start_lines if len(side) > 0 else 0 for side in sides]
    chosen = np.concatenate(
        [_spread(side, number, rng) for side, number in zip(sides, wanted, strict=True)]
    )
    return chosen[rng.permutation(rules.start_lines)]


def _spread(
    places: NDArray[np.float64], number: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return a random place from each of ``number`` equal parts: no repetition if there is room."""
    edges = np.linspace(0.0, len(places), number + 1)
    at = rng.uniform(edges[:-1], edges[1:]).astype(np.intp)
    return places[np.minimum(at, len(places) - 1)] if number else places[:0]


def draw_starts(
    track: Track, rules: Rules, races: int, seed: int, *, split: str = "test", cars: int = 2
) -> Starts:
    """Draw the starts of a batch: random start lines, and both sides alternately on each line.

    Race ``i`` starts on line ``(i // 2) % rules.start_lines`` with side ``i % 2``, for any size of
    the batch. With more than two ``cars`` there are ``cars`` places instead of two sides.
    """
    return starts_of(track, rules, np.arange(races), seed, split=split, cars=cars)


def starts_of(
    track: Track,
    rules: Rules,
    index: ArrayLike,
    seed: int,
    *,
    split: str = "test",
    cars: int = 2,
) -> Starts:
    """Return the starts of some races of the batch of :func:`draw_starts`, by their indices."""
    lines = start_lines(
        track, rules, np.random.SeedSequence(check_seed(seed), spawn_key=(0,)), split=split
    )
    index, places = np.asarray(index, np.int64), places_of_grid(cars)
    return Starts(lines[(index // places) % len(lines)], index % places)


def start_races(
    setup: RaceSetup,
    starts: Starts,
    seeds: NDArray[np.uint64],
    conditions: RaceConditions = AS_THE_SETUP,
) -> RaceState:
    """Put the cars of all races on the grid (:func:`pcs_racing.race.start_grid.place_on_grid`)."""
    if len(starts) != len(seeds):
        raise InputError(
            f"there are {len(starts)} starts but {len(seeds)} seeds; give one seed for each race"
        )
    track, rules, spacing = setup.track, setup.rules, setup.start_spacing
    slowest = setup.speed_range[0]
    state = place_on_grid(
        track, rules, spacing, slowest, setup.vehicles, starts, setup.memory_size, conditions
    )
    _check_delays(setup, conditions)
    state.seed[:] = seeds
    if rules.gives_handicaps and state.number > 1:
        place = starts.side[:, None] + np.arange(state.number)
        front = place % places_of_grid(state.number) == 0
        state.handicap[:] = draw_handicaps(rules, front, state.seed)
    if state.crashed.any():
        i = int(np.flatnonzero(state.crashed)[0])
        raise InputError(
            f"race {i}: at start line {starts.s[i]:.2f} m of track {track.name!r} a car overlaps a"
            " wall or another car; choose another line or a smaller start_spacing than"
            f" {spacing:g} m"
        )
    return state


def race_keys(rules: Rules, seed: int, index: ArrayLike) -> NDArray[np.uint64]:
    """Return the keys of some races of a batch by their indices; two legs share one."""
    numbers = np.asarray(index) // rules.legs
    return np.array([race_seed(seed, int(number)) for number in numbers], np.uint64)


def draw_handicaps(
    rules: Rules, front: NDArray[np.bool_], seeds: NDArray[np.uint64]
) -> NDArray[np.float64]:
    """Return the handicaps of the cars, shape (B, N), drawn from the keys of the races.

    ``front``, shape (B, N): True for the car in front at the start.
    """
    low, high = rules.front_pace
    drawn = (random_bits(seeds, HANDICAP_DRAW)[:, :1] >> np.uint64(11)).astype(np.float64)
    return np.where(front, 1.0 - low - (high - low) * (drawn * 2.0**-53), 0.0)


def _check_delays(setup: RaceSetup, conditions: RaceConditions) -> None:
    """Refuse cars whose delayed commands have no room in the memory of the setup's races."""
    if conditions.vehicles is None:
        return
    late = conditions.vehicles[..., STEER_DELAY] + conditions.vehicles[..., SPEED_DELAY]
    room = queue_size((*setup.vehicles, setup.max_delays))
    seen_late = conditions.vehicles[..., OPPONENT_DELAY].max() * COMMAND_PERIOD
    max_delay = max(car.opponent_delay for car in (*setup.vehicles, setup.max_delays))
    if seen_late > max_delay + 1e-9:
        raise InputError(
            f"a car sees others {seen_late:g} s late; the setup has room for {max_delay:g} s: give"
            " it a car with this delay as max_delays"
        )
    if (late > room).any():
        race, car = np.argwhere(late > room)[0]
        raise InputError(
            f"race {race}: {late[race, car]:g} commands of car {car} are delayed; the setup has"
            f" room for {room}: give it a car with these delays as max_delays"
        )


@dataclass(frozen=True, eq=False)
class RaceResult:
    """Results of a batch of races."""

    rules: Rules
    state: RaceState  #: State at the end of every race.
    starts: Starts

    @property
    def lead(self) -> NDArray[np.float64]:
        """Lead of car 0 over the best other car at the end, m, shape (B,)."""
        return self.state.lead

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """True if the race ended in a crash, shape (B,)."""
        return self.state.crashed

    @property
    def winner(self) -> NDArray[np.int8]:
        """Car that won, shape (B,): see :func:`winners`."""
        return winners(self.rules, self.state)

    @property
    def order(self) -> NDArray[np.intp]:
        """Cars in finishing order, shape (B, N): see :func:`finishing_order`."""
        return finishing_order(self.state)

    @property
    def own_crash(self) -> NDArray[np.bool_]:
        """True if the car is at fault for the end of its race, shape (B, N)."""
        return _merit(self.state) == 2

    @property
    def lap_times(self) -> NDArray[np.float64]:
        """Times of the laps: see :attr:`pcs_racing.race.state.RaceState.lap_times`."""
        return self.state.lap_times

    @property
    def time(self) -> NDArray[np.float64]:
        """Duration of each race, s, shape (B,)."""
        return self.state.tick.astype(np.float64) * DT


def _merit(state: RaceState) -> NDArray[np.int64]:
    """Return for each car 0 without a crash, 1 in a crash of others, 2 at fault, shape (B, N)."""
    return np.where(state.crash != NO_CRASH, np.where(state.fault > 0, 2, 1), 0)


def finishing_order(state: RaceState) -> NDArray[np.intp]:
    """Return the cars in finishing order, shape (B, N).

    Cars are ordered by progress, in a race with laps first by the time of their last lap. Crashed
    cars come behind all other cars, and the cars at fault come last.
    """
    return np.lexsort((-state.progress, state.finish_time, _merit(state)), axis=-1)


def pair_scores(rules: Rules, state: RaceState) -> NDArray[np.float64]:
    """Return each car's score against each other car, (B, N, N): win 1, tie 0.5, loss 0.

    Ratings take one race of N cars as the results of all its pairs. The rule is the same as in
    :func:`winners`; the diagonal is 0.5.
    """
    merit = _merit(state)
    ahead = state.progress[:, :, None] - state.progress[:, None]
    better = np.where(np.abs(ahead) > TIE_WITHIN, np.sign(ahead), 0.0)
    if rules.laps is not None:
        end, other = state.finish_time[:, :, None], state.finish_time[:, None]
        sooner = (end < other) * 1.0 - (end > other)
        better = np.where(np.isfinite(np.minimum(end, other)), sooner, better)
    # Two cars that are both at fault for the end of a race share the loss.
    better[(merit[:, :, None] == 2) & (merit[:, None] == 2)] = 0.0
    apart = merit[:, None] - merit[:, :, None]
    better = np.where(apart != 0, np.sign(apart), better)
    if rules.crash_rule == "nobody":
        better[state.crashed] = 0.0
    return 0.5 + 0.5 * better


def winners(rules: Rules, state: RaceState) -> NDArray[np.int8]:
    """Return the winner of each race, -1 for a tie, a no-contest and a car alone, shape (B,).

    The winner is the car that beats all other cars: the car ahead at the end, the first car to end
    the last lap or, after a crash under the rule "fault-loses", the first car that is not at fault.
    """
    scores = pair_scores(rules, state)
    won = (scores == 1.0).sum(axis=2) == max(1, state.number - 1)
    return np.where(won.any(axis=1), won.argmax(axis=1), -1).astype(np.int8)


def run_races(
    track: Track,
    egos: Drivers,
    opponents: Drivers,
    rules: Rules | str = PAPER,
    *,
    seed: int = 0,
    starts: Starts | None = None,
    vehicle: Any = F1TENTH,
    threads: int | None = None,
) -> RaceResult:
    """Run races between pairs of policies, from the start to the end.

    Parameters
    ----------
    egos, opponents : Policy, str, model, or list of these
        Racers of car 0 and car 1 (:func:`pcs_racing.racer`), which are no agents; a single one
        drives in all races. Planners may differ between races.
    rules : Rules or str
        Rules, also by name or from a file.
    seed : int
        Root of the start lines and of the noise of every race.
    starts : Starts, optional
        Starts of the races; drawn from the seed by default (:func:`draw_starts`).
    vehicle : VehicleParams, mapping, str, or sequence of these
        Parameters of all cars, or of each car, car 0 first: a shipped car's name, the values that
        differ from F1TENTH's, or a YAML file (:func:`pcs_racing.car.vehicle.load_vehicle`).
    threads : int, optional
        Number of threads that share the races; all cores by default. It does not change the result.
    """
    both = [_policies(one) for one in (egos, opponents)]
    counts = [len(one) for one in both if isinstance(one, list)]
    if len(set(counts)) > 1:
        raise InputError(
            f"there are {counts[0]} egos but {counts[1]} opponents; give one opponent for each ego"
        )
    return run_field(
        track,
        both,
        rules,
        seed=seed,
        starts=starts,
        vehicle=vehicle,
        threads=threads,
    )


def run_field(
    track: Track,
    drivers: Sequence[Drivers],
    rules: Rules | str = PAPER,
    *,
    seed: int = 0,
    starts: Starts | None = None,
    vehicle: Any = F1TENTH,
    threads: int | None = None,
) -> RaceResult:
    """Run races between 1 to 8 policies, from the start to the end.

    ``drivers`` holds for each car its policy, or its policies in all races. The other arguments are
    as in :func:`run_races`.
    """
    rules = rules_on(track, rules)
    vehicles = load_vehicles(vehicle, len(drivers))
    policies = [_policies(one) for one in drivers]
    given = [len(one) for one in policies if isinstance(one, list)]
    races = given[0] if given else 1 if starts is None else len(starts)
    if any(number != races for number in given):
        raise InputError(
            f"cars have {given} drivers; give each car one driver, or one for each race"
        )
    cars = [one if isinstance(one, list) else [one] * races for one in policies]
    if starts is None:
        starts = draw_starts(track, rules, races, seed, cars=len(cars))
    if len(starts) != races:
        raise InputError(
            f"there are {races} races but {len(starts)} starts; give one start for each race"
        )
    seeds = race_keys(rules, seed, np.arange(races))
    # All races of one call of the loop have the same planners, so races are grouped by planners.
    groups: dict[tuple[int, ...], list[int]] = {}
    for i in range(races):
        groups.setdefault(tuple(id(car[i].planner) for car in cars), []).append(i)
    parts: list[tuple[list[int], RaceState]] = []
    for members in groups.values():
        setup = RaceSetup(track, rules, tuple(car[members[0]].planner for car in cars), vehicles)
        state = start_races(setup, starts.take(members), seeds[members])
        theta = np.stack(
            [pad_parameters([car[i] for i in members], setup.theta_size) for car in cars], axis=1
        )
        advance(setup, state, theta, rules.ticks, threads=threads)
        parts.append((members, state))
    # Joined states need memories of equal size: planners with less memory leave the rest 0.
    widest = max((state.memory.shape[2] for _, state in parts), default=0)
    joined = [_widen_memory(state, widest) for _, state in parts] or [
        empty_state(0, 0, len(cars), rules.laps)
    ]
    order = (
        np.argsort(np.concatenate([members for members, _ in parts]))
        if parts
        else np.array([], np.intp)
    )
    return RaceResult(rules, take(concatenate(joined), order), starts)


def _policies(given: Drivers) -> "Policy | list[Policy]":
    """Return the policy of all races, or a list of one policy per race."""
    from pcs_racing.planners.racers import policy_racer

    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
        return policy_racer(given)
    # One policy for one object: races of the same planner run together.
    known = {id(one): policy_racer(one) for one in {id(one): one for one in given}.values()}
    return [known[id(one)] for one in given]


def rules_on(track: Track, rules: Rules | str) -> Rules:
    """Return the rules of races, also by name; refuse a track that is not loaded."""
    if not isinstance(track, Track):
        raise InputError(f"track is {track!r:.80}; it must be a Track, from load_track(name)")
    return load_rules(rules)


def _widen_memory(state: RaceState, size: int) -> RaceState:
    extra = size - state.memory.shape[2]
    return (
        state._replace(memory=np.pad(state.memory, ((0, 0), (0, 0), (0, extra))))
        if extra
        else state
    )
