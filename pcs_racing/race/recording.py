"""Recording of races: the loop of :func:`pcs_racing.run_races`, stopped every control period.

A recorded race ends in exactly the state that ``run_races``, or a game, gives for the race.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.elementary import lengths
from pcs_racing.base.errors import InputError, check_whole
from pcs_racing.base.typing import Floats
from pcs_racing.car.vehicle import F1TENTH, V, Y, load_vehicles
from pcs_racing.planners.pursuit import COMMAND_SLOTS
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.view import PATH_SPEED, PATH_Y, VIEW_SIZE
from pcs_racing.race.config import (
    CONTROL_EVERY,
    DT,
    PAPER,
    PLAN_EVERY,
    Rules,
)
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceResult, RaceSetup, race_keys, rules_on, start_races, starts_of
from pcs_racing.race.replay import Replay, ReplayEvent
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import (
    ITTC,
    ITTC_SAMPLES,
    LAP_COLUMNS,
    LAPS,
    WALL_CRASH,
    RaceState,
)
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.moving import moving_outlines
from pcs_racing.track.track import Track

LAST_INDEX = 2**32 - 1
"""Maximum number of a race: it is one 32-bit word of the key of the race's noise."""

PASS_SECONDS = 3.0  # s before an overtake that count for the distance of the cars

FRAME_EVERY = 4  # steps: 25 frames a second; the loop can be stopped after every second step


def record_race(
    track: Track,
    ego: Any,
    opponent: Any,
    rules: Rules | str = PAPER,
    *,
    seed: int = 0,
    index: int = 0,
    vehicle: Any = F1TENTH,
    candidates: bool = True,
) -> Replay:
    """Drive one race and record it for viewing.

    Parameters
    ----------
    ego, opponent : Policy, str or model
        Racers of car 0 and car 1 (:func:`pcs_racing.racer`), which are no agents; a list of up to
        seven opponents gives a race of more cars.
    seed, index : int
        Seed and number of the race: race ``index`` (0 to :data:`LAST_INDEX`) of
        ``run_field(..., seed=seed)``, with the same start, the same noise and a bit-identical end.
        No earlier race is drawn.
    vehicle
        Parameters of the cars, as in :func:`run_races`.
    candidates : bool
        Whether to record the paths that each planner chose from (if it can report them).

    Returns
    -------
    Replay
        Recording with 25 frames a second; it ends with the race, possibly in a crash.
    """
    check_whole("index", index, 0, LAST_INDEX)
    rules = rules_on(track, rules)
    others = opponent if isinstance(opponent, list | tuple) else [opponent]
    drivers = list(map(policy_racer, [ego, *others]))
    vehicles = load_vehicles(vehicle, len(drivers))
    setup = RaceSetup(track, rules, tuple(driver.planner for driver in drivers), vehicles)
    start = starts_of(track, rules, [int(index)], seed, cars=len(drivers))
    theta = pad_parameters(drivers, setup.theta_size)[None]
    noise = race_keys(rules, seed, [index])[0]
    names = tuple(driver.name for driver in drivers)
    return record_drive(setup, start, noise, theta, names=names, candidates=candidates)


def record_drive(
    setup: RaceSetup,
    start: Starts,
    noise: np.uint64,
    theta: Floats,
    *,
    names: tuple[str, ...],
    ends: Sequence[int] = (),
    candidates: bool = True,
) -> Replay:
    """Drive one race, with policies that may change on the way, and record it for viewing.

    ``noise`` is the key of the race's noise, as in ``RaceState.seed``. ``theta``, shape (S, N, P),
    holds the parameters of the cars in each of S steps, padded to the setup's ``theta_size``. The
    last step lasts until the end of the race. Each earlier step ends at one of the ``ends``, in
    ticks of 0.01 s, multiples of 10 (the planning period). ``names`` are the names of the cars;
    equal names get the number of the car (:func:`tell_apart`).
    """
    if len(start) != 1:
        raise InputError(f"there are {len(start)} starts; a recording is of one race")
    if (
        len(ends) != len(theta) - 1
        or any(tick % PLAN_EVERY for tick in ends)
        or list(ends) != sorted(ends)
    ):
        raise InputError(
            f"ends are {list(ends)}; {len(theta)} steps have {len(theta) - 1} of them, rising"
            f" multiples of {PLAN_EVERY}"
        )
    names = tell_apart(names)
    state = start_races(setup, start, np.array([noise], np.uint64))
    log = _drive(setup, state, theta, ends, candidates)
    track = setup.track
    line, cars, progress = track.line, np.array(log.cars), np.array(log.progress)
    return Replay(
        title=" against ".join((names[0], ", ".join(names[1:]))) if len(names) > 1 else names[0],
        track_name=track.name,
        car_names=names,
        walls=track.arrays.walls,
        line=line[:, [_frenet.X, _frenet.Y]],
        line_speed=_driven_speed(track, start.s[0] + progress, cars[..., V]),
        frame_dt=FRAME_EVERY * DT,
        plan_dt=PLAN_EVERY * DT,
        sight=setup.rules.sight,
        half_sizes=np.array([[0.5 * car.length, 0.5 * car.width] for car in setup.vehicles]),
        outcome=_outcome(RaceResult(setup.rules, state, start), names),
        cars=cars,
        progress=progress,
        ittc=np.array(log.ittc),
        events=tuple(log.events),
        moving=_same_size(log.moving),
        **_plans(log),
    )


def _driven_speed(track: Track, places: Floats, speeds: Floats) -> Floats | None:
    """Return the max speed of the cars at each point of the race line, m/s; NaN where none drove.

    ``places``, ``speeds``: shape (T, N), cumulative arc lengths and speeds; None if the cars passed
    no point.
    """
    length = track.length
    laps = length * np.arange(places.min() // length, places.max() // length + 1.0)
    points = laps[:, None] + track.arrays.ds * np.arange(len(track.line))
    driven = [
        # A car that is pushed back does not drive.
        np.interp(points, np.maximum.accumulate(place), speed, left=np.nan, right=np.nan)
        for place, speed in zip(places.T, speeds.T, strict=True)
    ]
    fastest: Floats = np.fmax.reduce(np.concatenate(driven))
    return None if np.isnan(fastest).all() else fastest


def tell_apart(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return distinct names: equal names get the number of the car, as in ``"lattice (car 0)"``."""
    return tuple(
        name if names.count(name) == 1 else f"{name} (car {car})" for car, name in enumerate(names)
    )


@dataclass(frozen=True)
class _Log:
    """Data collected while a race is driven."""

    cars: list[Floats] = field(default_factory=list)
    progress: list[Floats] = field(default_factory=list)
    ittc: list[Floats] = field(default_factory=list)
    moving: list[list[Floats]] = field(default_factory=list)
    paths: list[Floats] = field(default_factory=list)
    choices: list[list[tuple[Floats, Floats] | None]] = field(default_factory=list)
    events: list[ReplayEvent] = field(default_factory=list)


def _drive(
    setup: RaceSetup, state: RaceState, steps: Floats, ends: Sequence[int], candidates: bool
) -> _Log:
    """Drive a race to its end, in place, and log frames, plans and events."""
    log = _Log()
    ittc = None
    while True:
        tick = int(state.tick[0])
        over = tick >= setup.rules.ticks or bool(state.over[0])
        if over or tick % FRAME_EVERY == 0:
            log.cars.append(state.cars[0].copy())
            log.progress.append(state.progress[0].copy())
            log.moving.append(moving_outlines(setup.track.arrays, tick * DT))
            log.ittc.append(np.zeros(state.number) if ittc is None else ittc)
        if over:
            return log
        step = bisect_right(ends, tick)
        theta = np.ascontiguousarray(steps[step : step + 1])
        plans = tick % PLAN_EVERY == 0
        if plans and candidates:
            # Called before the step: after it the planner's memory already holds this plan.
            log.choices.append([_choices(setup, state, theta, car) for car in range(state.number)])
        # Sums and counts are cumulative: the contribution of this period is their difference.
        sums, ahead, faults, laps = (
            state.sums[0].copy(),
            state.ahead[0].copy(),
            state.fault[0].copy(),
            state.lap_count[0],
        )
        advance(setup, state, theta, CONTROL_EVERY, threads=1)
        if plans:
            log.paths.append(_followed(state.path[0]))
        added = state.sums[0] - sums
        if added[0, ITTC_SAMPLES] > 0.0:
            first = ittc is None
            ittc = added[:, ITTC] / added[:, ITTC_SAMPLES]
            if first:  # frames before the first sample also show it
                log.ittc[:] = [ittc] * len(log.ittc)
        log.events.extend(_overtakes(state, ahead, log))
        log.events.extend(_faults(state, faults))
        if setup.rules.laps is not None:
            log.events.extend(_ended_laps(state, laps))


def _choices(
    setup: RaceSetup, state: RaceState, theta: Floats, car: int
) -> tuple[Floats, Floats] | None:
    """Return the paths that a planner is about to choose from, and their costs."""
    planner = setup.planners[car]
    if planner.candidates is None:
        return None
    view = np.zeros(VIEW_SIZE)
    vehicles = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    fill_view(setup.track.arrays, state, 0, car, vehicles, setup.settings, view)
    begin = COMMAND_SLOTS if planner.drive is not None else 0
    memory = state.memory[0, car, begin : begin + planner.memory_size].copy()
    points, costs = planner.candidates(
        setup.track.arrays, theta[0, car, : len(planner.parameters)].copy(), view, memory
    )
    # Several speeds on one path look alike: only the cheapest is recorded.
    _, first, place = np.unique(
        points.reshape(len(points), -1), axis=0, return_index=True, return_inverse=True
    )
    cheapest = np.full(len(first), np.inf)
    np.minimum.at(cheapest, place.ravel(), costs)
    return points[first], cheapest


def _same_size(frames: list[list[Floats]]) -> Floats | None:
    """Return outlines as an array, shape (T, M, H, 2); the last corner fills up short ones."""
    if not frames[0]:
        return None
    corners = np.arange(max(map(len, frames[0])))
    return np.array([[one[np.minimum(corners, len(one) - 1)] for one in frame] for frame in frames])


def _plans(log: _Log) -> dict[str, Any]:
    """Return plans and candidates as arrays, without parts that no planner reports."""
    paths = np.array(log.paths)
    if np.isnan(paths).all():
        return {}
    known = [choice for pair in log.choices for choice in pair if choice is not None]
    if not known:
        return {"paths": paths}
    shape = (len(log.choices), paths.shape[1], max(len(costs) for _, costs in known))
    places = np.full((*shape, max(points.shape[1] for points, _ in known), 2), np.nan)
    prices = np.full(shape, np.inf)
    for row, pair in enumerate(log.choices):
        for car, choice in enumerate(pair):
            if choice is not None:
                points, costs = choice
                places[row, car, : len(costs), : points.shape[1]] = points
                prices[row, car, : len(costs)] = costs
    return {"paths": paths, "candidates": places, "costs": prices}


def _followed(path: Floats) -> Floats:
    """Return the plans of the cars as points x, y, speed, time; NaN for a planner without plans."""
    out = np.array(path)
    step = lengths(np.diff(path[..., : PATH_Y + 1], axis=1))
    speed = np.maximum(0.5 * (path[:, 1:, PATH_SPEED] + path[:, :-1, PATH_SPEED]), 0.1)
    out[:, 0, 3] = 0.0
    out[:, 1:, 3] = np.cumsum(step / speed, axis=1)
    out[~path.any(axis=(1, 2))] = np.nan
    return out


def _overtakes(state: RaceState, ahead_before: NDArray[np.uint8], log: _Log) -> list[ReplayEvent]:
    """Return the overtakes of the last control period: who, where, how close the centres."""
    events, cars = [], np.array(log.cars[-int(PASS_SECONDS / (FRAME_EVERY * DT)) :])
    for car, other in permutations(range(state.number), 2):
        was_behind = ahead_before[other] >> car & 1
        if not was_behind or state.ahead[0, other] >> car & 1:
            continue
        apart = lengths(cars[:, car, : Y + 1] - cars[:, other, : Y + 1]).min()
        whom = "" if state.number == 2 else f" car {other}"
        text = f"overtakes{whom} at {state.frenet[0, car, 0]:.0f} m, {apart:.2f} m apart"
        events.append(ReplayEvent(float(state.tick[0]) * DT, car, "overtake", text))
    return events


def _faults(state: RaceState, faults_before: NDArray[np.int8]) -> list[ReplayEvent]:
    """Return the crashes of the last control period."""
    time, events = float(state.tick[0]) * DT, []
    other = "the other car" if state.number == 2 else "another car"
    for car in range(state.number):
        if state.fault[0, car] > faults_before[car]:
            into = (
                "the wall" if WALL_CRASH in (state.crash[0, car], state.contact[0, car]) else other
            )
            events.append(ReplayEvent(time, car, "crash", f"crashes into {into}"))
    return events


def _ended_laps(state: RaceState, laps_before: NDArray[np.int64]) -> list[ReplayEvent]:
    """Return the laps that ended in the last control period, with their times."""
    laps = state.laps[0]
    ended = [car for car, before in enumerate(laps_before.tolist()) if laps[car, LAPS] > before]
    return [
        ReplayEvent(time, car, "lap", f"ends lap {number:g} in {lap:.2f} s")
        for car, (number, time, lap, _) in zip(
            ended, laps[ended, :LAP_COLUMNS].tolist(), strict=True
        )
    ]


def _outcome(result: RaceResult, names: tuple[str, ...]) -> str:
    """Return the outcome of a race in words."""
    winner, time = int(result.winner[0]), float(result.time[0])
    order, progress = result.order[0], result.state.progress[0]
    lead = progress[order[0]] - progress[order[min(1, len(order) - 1)]]
    prize = f"{names[winner]} wins" if winner >= 0 else "nobody wins"
    if result.crashed[0]:
        guilty = " and ".join(names[car] for car in range(len(names)) if result.own_crash[0, car])
        what = "crash" if result.rules.contact == "end" else "out"
        return f"{what} after {time:.1f} s, fault of {guilty or 'nobody'}: {prize}"
    finish = result.state.finish_time[0].min()
    end = f"{time:.0f} s" if finish == np.inf else f"{result.rules.laps} laps, {finish:.2f} s"
    if len(names) == 1:
        return f"{progress[0]:.1f} m in {end}"
    return f"{prize} by {abs(lead):.1f} m after {end}" if winner >= 0 else f"a tie after {end}"
