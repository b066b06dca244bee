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
    walls_to_grid,
)
from pcs_racing.track.mapping.shapes import STYLES, rounded


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


def test_braking_zones_straights_and_rounded_corners_by_hand():
    # Down by 3 across the end of the list, down by 2, and a ripple of 0.5 that doesn't count.
    assert braking_zones(np.array([5.0, 4.0, 6.0, 5.5, 6.0, 4.0, 7.0])) == 2
    assert braking_zones(np.full(10, 8.0)) == 0
    t = np.linspace(-np.pi / 2, np.pi / 2, 60)
    arc = 3.0 * np.column_stack([np.cos(t), np.sin(t)])
    shift = np.array([10.0, 0.0])
    side = np.column_stack([np.linspace(-10.0, 10.0, 100)[1:-1], np.full(98, -3.0)])
    stadium = np.vstack([side, arc + shift, -side, -arc - shift])
    np.testing.assert_allclose(straights(stadium), 20.0, atol=0.8)
    square = 10.0 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    line = rounded(square, np.full(4, 2.0), 0.05)
    assert signed_area(line) == pytest.approx(100.0 - (4.0 - np.pi) * 4.0, rel=1e-3)
    # A radius that doesn't fit shrinks until it does.
    assert signed_area(rounded(square, np.full(4, 50.0), 0.05)) == pytest.approx(
        np.pi * 25.0, rel=0.02
    )


def test_walls_are_thin_and_as_far_apart_as_the_track_is_wide():
    t = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    grid, origin = walls_to_grid(6.0 * np.column_stack([np.cos(t), np.sin(t)]), 2.0, 0.05)
    row, col = grid.shape[0] // 2, grid.shape[1] // 2
    assert not grid[row, col]
    # From the middle eastwards: two walls of about 0.1 m, 2 m apart, around a radius of 6 m.
    x = origin[0] + 0.05 * (np.flatnonzero(grid[row, col:]) + col + 0.5)
    inner, outer = x[x < 6.0], x[x > 6.0]
    assert inner.max() == pytest.approx(5.0, abs=0.05)
    assert outer.min() == pytest.approx(7.0, abs=0.05)
    assert 2 <= len(inner) <= 3
    assert 2 <= len(outer) <= 3
    circuit = generate_circuit(1, "hull", width=3.0, length_range=(90.0, 100.0), resolution=0.1)
    assert 90.0 <= circuit.length <= 100.0
    np.testing.assert_array_equal(circuit.centerline[:, 2:], 1.5)
    free = wall_clearance(
        circuit.centerline[:, :2].copy(), circuit.occupied, 0.1, circuit.origin, 3.0
    )
    np.testing.assert_allclose(free, 1.5, atol=0.15)
