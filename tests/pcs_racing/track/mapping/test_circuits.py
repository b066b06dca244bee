"""Generated circuits are simple, wide enough, raceable, and the same for the same seed."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pcs_racing.base.errors import InputError, MapError, UnknownNameError
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import first_crossing, resample, sample_closed, signed_area
from pcs_racing.track.building.raceline import raceline_rows
from pcs_racing.track.mapping.circuits import (
    braking_zones,
    generate_circuit,
    straights,
)
from pcs_racing.track.mapping.shapes import STYLES


@settings(max_examples=6)
@given(seed=st.integers(0, 10_000), style=st.sampled_from(sorted(STYLES)), clockwise=st.booleans())
def test_circuits_are_what_they_promise(seed, style, clockwise):
    direction = "clockwise" if clockwise else "counterclockwise"
    circuit = generate_circuit(seed, style, direction=direction)
    line = circuit.centerline[:, :2]
    assert 60.0 <= circuit.length <= 180.0
    assert first_crossing(line) == (-1, -1)
    assert (signed_area(line) < 0.0) == clockwise
    assert np.abs(sample_closed(line, 0.07).kappa).max() <= 1.01 / (1.2 * 1.1)
    np.testing.assert_allclose(line[0], 0.0, atol=1e-12)
    # The track is as wide as it says: its walls neither fold nor come from another stretch of
    # track.
    free = wall_clearance(resample(line, 0.05), circuit.occupied, 0.05, circuit.origin, 2.0)
    assert free.min() > 1.1 - 0.08
    assert free.max() < 1.1 + 0.08
    # And the race line keeps clear of them.
    race = resample(circuit.raceline, 0.02)
    assert wall_clearance(race, circuit.occupied, 0.05, circuit.origin, 1.0).min() >= 0.305 - 1e-6
    assert first_crossing(circuit.raceline) == (-1, -1)
    assert braking_zones(raceline_rows(circuit.raceline)[:-1, 5]) >= 3
    long = straights(line)
    assert long[0] >= 8.0
    if style == "hairpin":
        assert long[1] >= 15.0


def test_impossible_wishes_are_refused():
    for arguments, error, words in [
        ({"style": "spiral"}, UnknownNameError, "style is 'spiral'"),
        ({"seed": -1}, InputError, "seed is -1"),
        ({"seed": 1.5}, InputError, "seed is 1.5"),
        ({"width": 0.4}, InputError, "width is 0.4"),
        ({"width": np.nan}, InputError, "width is nan"),
        ({"length_range": (200.0, 100.0)}, InputError, "length_range is"),
        ({"length_range": (5.0, 100.0)}, InputError, "length_range is"),
        ({"direction": "left"}, InputError, "direction is 'left'"),
        ({"resolution": 1.0}, InputError, "resolution is 1.0"),
        ({"length_range": (22.0, 23.0), "attempts": 5}, MapError, "in 5 drafts: "),
    ]:
        with pytest.raises(error, match=words):
            generate_circuit(**({"seed": 0} | arguments))


def test_walls_are_as_far_apart_as_the_track_is_wide():
    circuit = generate_circuit(1, "hull", width=3.0, length_range=(90.0, 100.0), resolution=0.1)
    assert 90.0 <= circuit.length <= 100.0
    np.testing.assert_array_equal(circuit.centerline[:, 2:], 1.5)
    free = wall_clearance(
        circuit.centerline[:, :2].copy(), circuit.occupied, 0.1, circuit.origin, 3.0
    )
    np.testing.assert_allclose(free, 1.5, atol=0.15)
