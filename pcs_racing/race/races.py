"""Racing two cars against each other, one race or thousands: start, advance, and what came of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_seed
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.car.vehicle import COMMAND_PERIOD, F1TENTH, VehicleParams
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.calibration import calibration_of, preset_of, start_layout, starts_for
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import DT, PAPER, RaceConfig
from pcs_racing.race.driving import drive, kernel_settings, pad_parameters
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.start_grid import Starts, place_on_grid
from pcs_racing.race.start_places import places_of, split_places
from pcs_racing.race.state import RaceState, concatenate, empty_state, take
from pcs_racing.track.track import Track

TIE_WITHIN = 0.01  # m of lead


@dataclass(frozen=True, eq=False)
class RaceSetup:
    """What stays the same during a batch of races: track, rules, the two planners and the two cars."""

    track: Track
    config: RaceConfig
    planners: tuple[Planner, Planner]  #: Family of car 0's and car 1's policies.
    vehicles: tuple[VehicleParams, VehicleParams] = (F1TENTH, F1TENTH)  #: Car 0 and car 1.
    #: Longest ``steer_delay`` of a car in a race that has cars of its own (:class:`RaceConditions`), s.
    most_delay: float = 0.0

    @cached_property
    def memory_size(self) -> int:
        """Numbers of memory for each car in the state: its planner's, and the commands on their way to the steering."""
        delay = max(self.most_delay, *(vehicle.steer_delay for vehicle in self.vehicles))
        return max(planner.memory_total for planner in self.planners) + round(delay / COMMAND_PERIOD)

    @cached_property
    def theta_size(self) -> int:
        """Length of the longer of the two planners' parameter vectors."""
        return max(1, *(len(planner.parameters) for planner in self.planners))

    @cached_property
    def speed_range(self) -> tuple[float, float]:
        """Speed scales for pace 0 and pace 1: the configuration's, else what the circuit is calibrated to."""
        return self.config.speed_range or calibration_of(self.track, self.config).speed_range

    @cached_property
    def start_spacing(self) -> float:
        """Distance between the cars across the track at the start, m: the nearest to the configuration's that works."""
        if start_layout(self.config) != start_layout(preset_of(self.config)):
            return self.config.start_spacing
        return calibration_of(self.track, self.config).start_spacing

    @cached_property
    def settings(self) -> KernelSettings:
        """The numbers that the compiled loop needs."""
        return kernel_settings(self.config, self.speed_range)


def start_lines(
    track: Track, config: RaceConfig, seed: int | np.random.SeedSequence, *, split: str = "test"
) -> NDArray[np.float64]:
    """Arc lengths (m) of ``config.start_lines`` start lines at places of the circuit fit for it, in random order.

    Games of training start from other places than races of tables (:func:`pcs_racing.race.start_places.split_places`).
    Lines repeat where the circuit has fewer places.
    """
    rng = np.random.default_rng(seed)
    known = starts_for(track, config)
    sides = [split_places(places_of(stretches), split) for stretches in known.start_places.values()]
    if len(sides) == 2 and min(map(len, sides)) > 0:
        # Rounded up or down at random, so that no number of lines favours a side.
        left = min(int(known.left_share * config.start_lines + rng.uniform()), config.start_lines)
        wanted = [left, config.start_lines - left]
    else:  # a side of a single place has none in one of the two splits
        wanted = [config.start_lines if len(side) > 0 else 0 for side in sides]
    chosen = np.concatenate([_spread(side, number, rng) for side, number in zip(sides, wanted, strict=True)])
    return chosen[rng.permutation(config.start_lines)]


def _spread(places: NDArray[np.float64], number: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """One random place from each of as many equal parts: random, yet never two in one spot where there is room."""
    edges = np.linspace(0.0, len(places), number + 1)
    at = rng.uniform(edges[:-1], edges[1:]).astype(np.intp)
    return places[np.minimum(at, len(places) - 1)] if number else places[:0]


def draw_starts(track: Track, config: RaceConfig, races: int, seed: int, *, split: str = "test") -> Starts:
    """Draw the starts of a batch: several random start lines, and on each of them both sides in turn.

    Race ``i`` starts on line ``(i // 2) % config.start_lines`` with side ``i % 2``, whatever the size of the batch.
    """
    return starts_of(track, config, np.arange(races), seed, split=split)


def starts_of(track: Track, config: RaceConfig, index: ArrayLike, seed: int, *, split: str = "test") -> Starts:
    """Starts of some races of the batch that :func:`draw_starts` draws, by their indices."""
    lines = start_lines(track, config, np.random.SeedSequence(check_seed(seed), spawn_key=(0,)), split=split)
    index = np.asarray(index, np.int64)
    return Starts(lines[(index // 2) % len(lines)], index % 2)


def start_races(
    setup: RaceSetup, starts: Starts, seeds: NDArray[np.uint64], conditions: RaceConditions = AS_THE_SETUP
) -> RaceState:
    """Put both cars of every race on the grid.

    Side by side, the two cars are centred between the walls; staggered and rolling, the rear car stands ``start_gap``
    behind and both are ``start_spacing`` apart across the track. Progress is counted from the front car's line.

    Raises
    ------
    InputError
        If a start lies off the track, or the cars would stand in a wall or in each other; the race's index is named.
    """
    if len(starts) != len(seeds):
        raise InputError(f"there are {len(starts)} starts but {len(seeds)} seeds; give one seed for each race")
    track, config, spacing = setup.track, setup.config, setup.start_spacing
    slowest = setup.speed_range[0]
    state = place_on_grid(track, config, spacing, slowest, setup.vehicles, starts, setup.memory_size, conditions)
    state.seed[:] = seeds
    if state.crashed.any():
        i = int(np.flatnonzero(state.crashed)[0])
        raise InputError(
            f"race {i}: at start line {starts.s[i]:.2f} m of track {track.name!r} a car would stand in a wall or in "
            f"the other car; choose another line or a smaller start_spacing than {spacing:g} m"
        )
    return state


def advance(
    setup: RaceSetup,
    state: RaceState,
    theta: NDArray[np.float64],
    ticks: int,
    *,
    threads: int | None = None,
    ittc: bool = True,
    conditions: RaceConditions = AS_THE_SETUP,
) -> None:
    """Advance every race of a batch by ``ticks`` steps of 0.01 s, in place; finished races stand still.

    The result does not depend on the number of threads, nor on how a race is cut into calls.

    Parameters
    ----------
    state : RaceState
        Overwritten.
    theta : ndarray, shape (B, 2, P)
        Parameter vectors of the two policies in each race, padded to the longer planner's.
    ticks : int
        Steps to drive, an even number: drivers are asked every second step.
    threads : int, optional
        Threads to share the races; all cores by default, one where a driver is plain Python.
    ittc : bool
        Whether to sample the minimum time to collision. Without it everything but the sums ``ITTC`` and
        ``ITTC_SAMPLES`` is the same, in less time.
    conditions : RaceConditions
        Cars and tracks of single races.

    Raises
    ------
    InputError
        If ``ticks`` is odd or negative, or ``theta`` or the conditions do not fit the batch.
    """
    settings = setup.settings if ittc else setup.settings._replace(ittc_horizon=0.0)
    drive(
        setup.track,
        settings,
        setup.planners,
        setup.vehicles,
        state,
        theta,
        ticks,
        threads=threads,
        conditions=conditions,
    )


@dataclass(frozen=True, eq=False)
class RaceResult:
    """What came of a batch of races."""

    config: RaceConfig
    state: RaceState  #: Where every race ended.
    starts: Starts

    @property
    def lead(self) -> NDArray[np.float64]:
        """Progress of car 0 minus that of car 1 at the end, m, shape (B,)."""
        return self.state.lead

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Whether the race ended in a crash, shape (B,)."""
        return self.state.crashed

    @property
    def winner(self) -> NDArray[np.int8]:
        """The car that won, shape (B,): see :func:`winners`."""
        return winners(self.config, self.state)

    @property
    def own_crash(self) -> NDArray[np.bool_]:
        """Whether each car is to blame for the end of its race, shape (B, 2)."""
        return self.state.fault == 1

    @property
    def time(self) -> NDArray[np.float64]:
        """How long each race lasted, s, shape (B,)."""
        return self.state.tick.astype(np.float64) * DT

    @property
    def laps(self) -> NDArray[np.int64]:
        """Complete laps of each car, shape (B, 2): from one forward crossing of s = 0 to the next."""
        return self.state.lap_count

    @property
    def lap_time(self) -> NDArray[np.float64]:
        """Time of each car's last complete lap, s, shape (B, 2); -1 if there is none."""
        return self.state.lap_time

    @property
    def best_lap(self) -> NDArray[np.float64]:
        """Time of each car's shortest complete lap, s, shape (B, 2); -1 if there is none."""
        return self.state.best_lap


def winners(config: RaceConfig, state: RaceState) -> NDArray[np.int8]:
    """The car that won each race, 0 or 1, or -1 for a tie and for a crash that pays nobody, shape (B,)."""
    ahead = np.where(state.lead > TIE_WITHIN, 0, np.where(state.lead < -TIE_WITHIN, 1, -1))
    if config.crash_rule == "nobody":
        after_crash = np.full(len(ahead), -1)
    else:
        fault = state.fault
        after_crash = np.where(fault[:, 0] == fault[:, 1], -1, np.where(fault[:, 0] == 1, 1, 0))
    return np.where(state.crashed, after_crash, ahead).astype(np.int8)


def run_races(
    track: Track,
    egos: Policy | Sequence[Policy],
    opponents: Policy | Sequence[Policy],
    config: RaceConfig = PAPER,
    *,
    seed: int = 0,
    starts: Starts | None = None,
    vehicles: tuple[VehicleParams, VehicleParams] = (F1TENTH, F1TENTH),
    threads: int | None = None,
) -> RaceResult:
    """Run races between pairs of policies, from the start to the end.

    Parameters
    ----------
    egos, opponents : Policy or sequence of Policy
        Drivers of car 0 and car 1 in each race; a single policy drives in all of them. Planners may differ from race to
        race.
    config : RaceConfig
        The rules.
    seed : int
        Root of the start lines and of every race's noise.
    starts : Starts, optional
        Where to start; drawn from the seed by default (:func:`draw_starts`).
    vehicles : tuple of two VehicleParams
        The cars.
    threads : int, optional
        Threads to share the races; all cores by default. It does not change the result.

    Raises
    ------
    InputError
        If the numbers of egos, opponents and starts do not fit, or a start is impossible.
    """
    if isinstance(egos, Policy):
        egos = [egos] * (1 if isinstance(opponents, Policy) and starts is None else len(starts or opponents))  # type: ignore[arg-type]
    if isinstance(opponents, Policy):
        opponents = [opponents] * len(egos)
    races = len(egos)
    if len(opponents) != races:
        raise InputError(f"there are {races} egos but {len(opponents)} opponents; give one opponent for each ego")
    if starts is None:
        starts = draw_starts(track, config, races, seed)
    if len(starts) != races:
        raise InputError(f"there are {races} races but {len(starts)} starts; give one start for each race")
    seeds = race_seeds(seed, races)
    # The loop is given the same two planners for all races of a call, so races are grouped by them.
    groups: dict[tuple[int, int], list[int]] = {}
    for i, (ego, opponent) in enumerate(zip(egos, opponents, strict=True)):
        groups.setdefault((id(ego.planner), id(opponent.planner)), []).append(i)
    parts: list[tuple[list[int], RaceState]] = []
    for members in groups.values():
        setup = RaceSetup(track, config, (egos[members[0]].planner, opponents[members[0]].planner), vehicles)
        state = start_races(setup, starts.take(members), seeds[members])
        theta = np.stack(
            [
                pad_parameters([egos[i] for i in members], setup.theta_size),
                pad_parameters([opponents[i] for i in members], setup.theta_size),
            ],
            axis=1,
        )
        advance(setup, state, theta, config.ticks, threads=threads)
        parts.append((members, state))
    # States are joined only in one width: planners that remember less leave the rest 0.
    widest = max((state.memory.shape[2] for _, state in parts), default=0)
    joined = concatenate([_widen_memory(state, widest) for _, state in parts]) if parts else empty_state(0, 0)
    order = np.argsort(np.concatenate([members for members, _ in parts])) if parts else np.array([], np.intp)
    return RaceResult(config, take(joined, order), starts)


def _widen_memory(state: RaceState, size: int) -> RaceState:
    extra = size - state.memory.shape[2]
    return state._replace(memory=np.pad(state.memory, ((0, 0), (0, 0), (0, extra)))) if extra else state
