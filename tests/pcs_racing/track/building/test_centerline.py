"""Centre lines from grids: where the track is known, on rings with faults, and on real circuits."""

import numpy as np
import pytest
from refusal import refused
from scipy.spatial import cKDTree

from pcs_racing.base.errors import MapError
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.curves import first_crossing, resample, signed_area
from pcs_racing.track.mapping.circuits import generate_circuit, walls_to_grid


def distances(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    return cKDTree(resample(line[:, :2], 0.01)).query(points[:, :2])[0]


def cell(point, resolution, origin):
    col, row = np.floor((np.asarray(point) - origin) / resolution).astype(int)
    return row, col


def test_the_line_of_a_ring_is_found_with_its_widths_and_of_two_rings_at_the_seed_point(box):
    line, grid, resolution, origin = box
    found = centerline_from_grid(grid, resolution, origin)
    assert distances(found, line).max() < 0.06
    assert distances(resample(line, 0.1), found).max() < 0.06
    np.testing.assert_allclose(found[:, 2:], 1.1, atol=0.1)
    steps = np.hypot(*(np.roll(found, -1, axis=0) - found)[:, :2].T)
    assert 0.2 < steps.min() <= steps.max() < 0.4
    assert first_crossing(found[:, :2]) == (-1, -1)
    one, _ = walls_to_grid(line, 2.2, resolution)
    grid = np.hstack([one, one])
    refused("2 regions", centerline_from_grid, grid, resolution, (0.0, 0.0), error=MapError)
    right = centerline_from_grid(
        grid, resolution, (0.0, 0.0), seed_point=(0.75 * grid.shape[1] * resolution, 1.8)
    )
    assert right[:, 0].min() > 0.5 * grid.shape[1] * resolution


@pytest.mark.parametrize("style", ["hull", "voronoi", "hairpin"])
def test_the_line_of_a_generated_circuit_is_found_again(style):
    circuit = generate_circuit(5, style)
    found = centerline_from_grid(circuit.occupied, circuit.resolution, circuit.origin)
    away = distances(found, circuit.centerline)
    assert away.mean() < 0.02
    assert away.max() < 0.1


def test_directions_and_starts_on_a_straight_or_at_the_seed(box):
    _, grid, resolution, origin = box
    seed = (3.0, 6.6)
    plain = centerline_from_grid(grid, resolution, origin, seed_point=seed)
    back = centerline_from_grid(grid, resolution, origin, seed_point=seed, direction="clockwise")
    assert signed_area(plain[:, :2]) > 0.0 > signed_area(back[:, :2])
    # Reversed about its first point, with right and left exchanged.
    np.testing.assert_allclose(back[0, :2], plain[0, :2])
    np.testing.assert_allclose(back[1], plain[-1][[0, 1, 3, 2]])
    assert np.hypot(*(plain[0, :2] - seed)) < 0.6
    # At the top of the ring counterclockwise is westwards.
    for heading, expected in ((np.pi, plain), (0.3, back)):
        towards = centerline_from_grid(grid, resolution, origin, seed_point=seed, direction=heading)
        np.testing.assert_array_equal(towards, expected)
    x, y = centerline_from_grid(grid, resolution, origin)[0, :2]
    assert abs(abs(y) - 7.0) < 0.2
    assert abs(x) < 6.0


def test_dirt_on_the_track_does_no_harm_and_a_gap_in_a_wall_leaves_no_loop(box):
    line, grid, resolution, origin = box
    dirty = grid.copy()
    rng = np.random.default_rng(3)
    for x, y in line[rng.integers(len(line), size=30)] + rng.uniform(-0.9, 0.9, size=(30, 2)):
        i, j = cell((x, y), resolution, origin)
        dirty[i : i + 2, j : j + 2] = True
    found = centerline_from_grid(dirty, resolution, origin)
    assert np.median(distances(found, line)) < 0.05
    assert distances(found, line).max() < 0.8
    leaking = grid.copy()
    i, j = cell((0.0, 8.1), resolution, origin)
    leaking[i - 5 : i + 6, j - 2 : j + 3] = False
    for seed in (None, (3.0, 6.6)):
        gap = (
            r"no closed loop found: the wall has a gap .* near \(-?0\.\d\d, [78]\.\d\d\) m, pixel"
            r" \(\d+, \d+\); close"
        )
        refused(
            gap, centerline_from_grid, leaking, resolution, origin, seed_point=seed, error=MapError
        )


def test_lines_that_cross_are_named_with_their_crossing():
    t = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    line = np.column_stack([9.0 * np.sin(t), 4.5 * np.sin(2.0 * t)])
    x, y = np.meshgrid(np.arange(-11.0, 11.0, 0.05) + 0.025, np.arange(-7.0, 7.0, 0.05) + 0.025)
    free = (cKDTree(line).query(np.column_stack([x.ravel(), y.ravel()]))[0] < 1.0).reshape(x.shape)
    crossing = (
        r"2 islands, .* branches near \(-?0\.[01]\d, -?0\.[01]\d\) m, pixel \(2[12]\d, 1[34]\d\)"
    )
    refused(crossing, centerline_from_grid, ~free, 0.05, (-11.0, -7.0), error=MapError)


def test_impossible_wishes_and_maps_without_a_loop_are_refused(box):
    for arguments, words in [
        ({"seed_point": (0.0, 0.0)}, "has no closed loop"),
        ({"seed_point": (0.0, 8.12)}, r"seed point \(0, 8.12\)"),
        ({"seed_point": (0.0, 80.0)}, r"seed point \(0, 80\)"),
        ({"seed_point": (0.0, np.nan)}, "is not a point"),
        ({"direction": "widdershins"}, "direction is 'widdershins'"),
        ({"direction": np.nan}, "direction is nan"),
        ({"seed_point": (0.0, 7.0), "direction": 1.57}, "lies across the track"),
    ]:
        _, grid, resolution, origin = box
        refused(words, centerline_from_grid, grid, resolution, origin, error=MapError, **arguments)
    for value in [False, True]:
        refused(
            "no closed loop",
            centerline_from_grid,
            np.full((60, 60), value),
            0.05,
            (0.0, 0.0),
            error=MapError,
        )
