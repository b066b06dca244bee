"""Where the cars of a race are along the race line, how far they have driven, and their laps."""

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.race import state as _state
from pcs_racing.race.rates import CONTROL_EVERY, DT
from pcs_racing.track.frenet import foot


@inner_kernel
def _cross_line(laps, race, car, time):  # type: ignore[no-untyped-def]
    """Count a forward crossing of s = 0; a lap ends, unless the car has only come back after rolling backwards."""
    laps[race, car, _state.CROSSINGS] += 1.0
    if laps[race, car, _state.CROSSINGS] <= laps[race, car, _state.MOST_CROSSINGS]:
        return
    laps[race, car, _state.MOST_CROSSINGS] = laps[race, car, _state.CROSSINGS]
    if laps[race, car, _state.MOST_CROSSINGS] > 1.0:
        lap = time - laps[race, car, _state.CROSSED_AT]
        best = laps[race, car, _state.BEST_LAP]
        laps[race, car, _state.LAP_TIME] = lap
        laps[race, car, _state.BEST_LAP] = lap if best == 0.0 else min(best, lap)
    laps[race, car, _state.CROSSED_AT] = time


@kernel
def count_crossing(length, before, driven, tick, laps, race, car):  # type: ignore[no-untyped-def]
    """Account for a control period in which a car crossed s = 0, forward or backward."""
    if driven > 0.0:
        share = (length - before) / driven
        _cross_line(laps, race, car, (tick - CONTROL_EVERY * (1.0 - share)) * DT)
    else:
        laps[race, car, _state.CROSSINGS] -= 1.0


@kernel(forceinline=True)
def update_progress(line, ds, length, cars, frenet, progress, laps, tick, race):  # type: ignore[no-untyped-def]
    """Project both cars onto the race line and add what they drove; crossing s = 0 only counts for the laps.

    Takes single arrays: handing whole named tuples to small functions costs more than their work, in reference counts.
    """
    # Nobody drives half a lap in a control period: a larger change of s is a crossing of the start line.
    half = 0.5 * length
    for car in range(2):
        before = frenet[race, car, 0]
        s, d = foot(line, ds, length, cars[race, car, _vehicle.X], cars[race, car, _vehicle.Y], before)
        driven = s - before
        if driven > half:
            driven -= length
            count_crossing(length, before, driven, tick, laps, race, car)
        elif driven < -half:
            driven += length
            count_crossing(length, before, driven, tick, laps, race, car)
        progress[race, car] += driven
        frenet[race, car, 0] = s
        frenet[race, car, 1] = d
