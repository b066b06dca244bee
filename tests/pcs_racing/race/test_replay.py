import dataclasses

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from refusal import refused

from pcs_racing.race.replay import ReplayEvent


def test_a_replay_is_an_immutable_copy_with_sorted_events():
    cars = race_on_a_circle().cars.copy()
    replay = race_on_a_circle(cars=cars)
    cars[:] = 0.0
    assert replay.cars[0, 0, 0] > 9.0
    with pytest.raises(ValueError, match="read-only"):
        replay.cars[0, 0, 0] = 1.0
    assert replay.duration == pytest.approx(4.0)
    assert replay.lead[-1] == pytest.approx(10.0 * (5.0 / 9.7 - 4.6 / 10.3) * 4.0)
    events = (ReplayEvent(3.0, 0, "move"), ReplayEvent(1.0, 1, "move"))
    replay = race_on_a_circle(events=events, candidates=3)
    assert [event.time for event in replay.events] == [1.0, 3.0]


def _changed(array, index, value):
    array = np.array(array, float)
    array[index] = value
    return array


GOOD = race_on_a_circle(candidates=3)

WRONG = {
    "title": (3, "x" * 501, "\ud800"),
    "car_names": ((), "ab"),
    "outcome": (None,),
    "frame_dt": (0.0, float("nan")),
    "plan_dt": ("0.1",),
    "cars": (np.zeros((0, 2, 7)), np.zeros((5, 3, 7)), _changed(GOOD.cars, (3, 1, 0), np.nan), "fast"),
    "progress": (GOOD.progress[:-1],),
    "walls": (np.zeros((4, 3)),),
    "line": (np.zeros((2, 2)),),
    "line_speed": (np.ones(3),),
    "ittc": (_changed(GOOD.ittc, (0, 0), np.nan),),
    "paths": tuple(_changed(GOOD.paths, (0, 0, 0, 1), value) for value in (np.nan, np.inf)),
    "candidates": (GOOD.candidates[:-1],),
    "costs": (None, *(_changed(GOOD.costs, (0, 0, 0), value) for value in (-np.inf, np.nan))),
    "half_sizes": (np.zeros((2, 2)), [0.29, 0.155]),
    "events": ("crash", *(ReplayEvent(*event) for event in ((-1.0, 0, "crash"), (1.0, 2, "crash"), (1.0, 0, 5)))),
}


def test_impossible_values_are_named():
    for field, value in [(field, value) for field, values in WRONG.items() for value in values]:
        refused(field.removesuffix("s"), dataclasses.replace, GOOD, **{field: (value,) if field == "events" else value})
