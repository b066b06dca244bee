"""Tracks built from values."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusal import refused

from pcs_racing import load_track
from pcs_racing.base.errors import MapError
from pcs_racing.track import frenet
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.frenet import COS, KAPPA, LEFT, PSI, RIGHT, SIN, SPEED


def test_the_oval_has_the_measures_of_a_stadium(oval):
    assert abs(oval.length - (24.0 + 8.0 * np.pi)) < 0.01
    assert abs(oval.arrays.ds - 0.1) < 0.001
    np.testing.assert_allclose(oval.line[:, [RIGHT, LEFT]], 1.1, atol=0.06)
    np.testing.assert_allclose(oval.wall_distance(oval.line[:, :2]), 1.1, atol=0.06)
    bends = np.abs(oval.line[:, 0]) > 7.0
    np.testing.assert_allclose(oval.line[bends, KAPPA], 0.25, atol=0.01)
    np.testing.assert_allclose(np.hypot(oval.line[:, COS], oval.line[:, SIN]), 1.0)
    np.testing.assert_allclose(oval.line[:, SIN], np.sin(oval.line[:, PSI]), atol=1e-12)
    np.testing.assert_allclose(np.median(oval.line[bends, SPEED]), np.sqrt(5.0 * 4.0), rtol=0.01)


def test_driven_the_other_way_round_sides_change_and_every_change_is_another_hash(oval, values):
    for name in ("raceline_xy", "centerline"):
        values[name] = values[name][::-1].copy()
    back = build_track("back", **values)
    np.testing.assert_allclose(back.length, oval.length, rtol=1e-4)
    assert back.line[:, KAPPA].min() < -0.2
    assert "right-hand" in back.summary()
    assert "left-hand" in oval.summary()
    _, d = back.to_frenet([0.0, -3.5])
    assert d == pytest.approx(-0.5, abs=0.01)
    one, two = build_track("a", **values), build_track("b", **values)
    assert one.content_hash == two.content_hash
    for first, second in zip(one.arrays, two.arrays, strict=True):
        np.testing.assert_array_equal(first, second)
    values["occupied"][5, 5] ^= True
    values["centerline"][3, 2] += 0.01
    assert build_track("a", **values).content_hash != one.content_hash


def test_a_track_can_not_be_changed_and_says_what_it_is(oval):
    for array in (oval.line, oval.centerline):
        refused("read-only", array.fill, 1.0, error=ValueError)
    with pytest.raises(dataclasses.FrozenInstanceError):
        oval.name = "other"
    assert "49.1 m" in oval.summary()
    assert len(repr(oval)) < 300
    refused(r"shape \(\.\.\., 2\)", oval.to_frenet, [1.0, 2.0, 3.0], error=ValueError)
    for point in ([np.nan, 0.0], [np.inf, 0.0], [1e15, -1e15]):
        assert oval.to_frenet(point).shape == (2,)
        assert oval.wall_distance(point) == 0.0


def gap_to_the_border(values):
    occupied = np.pad(values["occupied"], 10, constant_values=False)
    occupied[:30, 200] = False
    return {
        "occupied": occupied,
        "origin": tuple(corner - 10 * values["resolution"] for corner in values["origin"]),
    }


def gap_to_the_infield(values):
    rows, cols = values["occupied"].shape
    far = np.hypot(
        np.maximum(np.abs(np.arange(cols) - cols / 2) - 80, 0.0),
        np.arange(rows)[:, None] - rows / 2,
    )
    occupied = values["occupied"] & ~(far < 45)
    occupied[rows // 2 :, cols // 2] &= np.arange(rows // 2, rows) > rows / 2 + 80
    return {"occupied": occupied}


def race_line(change):
    return lambda values: {"raceline_xy": change(values["raceline_xy"])}


def centre_line(change):
    return lambda values: {"centerline": change(values["centerline"])}


def with_value(array, index, value):
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (gap_to_the_border, r"border of the picture: the wall has a gap"),
        (
            gap_to_the_infield,
            r"times the area of the track: the wall has a gap .* \(0\.\d\d, [0-4]\.\d\d\) m",
        ),
        (
            race_line(lambda xy: np.column_stack([xy[:, 0], xy[:, 1] * np.sign(xy[:, 0]) * 0.2])),
            "crosses itself",
        ),
        (race_line(lambda xy: xy[: len(xy) // 2]), "race line is open"),
        (race_line(lambda xy: xy * 0.65), "through a wall"),
        (race_line(lambda xy: xy + 100.0), "race line leaves"),
        (race_line(lambda xy: with_value(xy, (7, 1), np.nan)), "impossible point"),
        (race_line(lambda xy: xy[:9]), "9 different points"),
        (race_line(lambda xy: np.insert(xy, 30, xy[30] + [0.0, 0.3], axis=0)), "a kink"),
        (centre_line(lambda rows: rows[: len(rows) // 2]), "centre line is open"),
        (centre_line(lambda rows: rows * [0.6, 0.6, 1.0, 1.0]), "centre line leaves"),
        (centre_line(lambda rows: with_value(rows, (4, 2), 0.0)), "0.0 m wide to the right"),
        (
            centre_line(lambda rows: np.maximum(rows, [-99.0, -99.0, 5.0, 5.0])),
            "states 5.00 m .* in the picture a wall",
        ),
        (
            centre_line(lambda rows: rows * [1.0, 0.88, 1.0, 1.0]),
            "in the picture a wall is 0.[2-7]",
        ),
        (lambda values: {"resolution": np.nan}, "resolution is nan"),
        (lambda values: {"occupied": values["occupied"].astype(np.uint8)}, "grid is uint8"),
        (lambda values: {"origin": (0.0, np.inf)}, "origin holds inf"),
    ],
)
def test_impossible_tracks_are_refused(values, change, message):
    refused(message, build_track, "broken", error=MapError, **values | change(values))


def test_two_parts_of_a_track_with_a_thin_wall_between_are_told_apart():
    """Two legs: where the line of one hugs the wall between, points of the other next to it belong
    to their own.
    """
    cell = 0.05
    rows, cols = 90, 420
    occupied = np.ones((rows, cols), dtype=bool)
    occupied[3:44, 5:415] = False  # the lower leg
    occupied[46:87, 5:415] = False  # the upper leg; two cells of wall lie between
    occupied[3:87, 5:45] = occupied[3:87, 375:415] = False
    # The line of the upper leg lies 0.3 m above the wall, the line of the lower leg 0.9 m below it.
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 15)
    bend = 0.6 * np.column_stack([np.cos(turn), np.sin(turn)])
    along = np.linspace(2.0, 19.0, 60)[1:-1]
    lower, upper = (np.column_stack([along, np.full(58, y)]) for y in (1.3, 2.5))
    line = np.vstack(
        [lower, np.array([19.0, 1.9]) + bend, upper[::-1], np.array([2.0, 1.9]) - bend]
    )
    track = build_track(
        "u", occupied, cell, (0.0, 0.0), np.column_stack([line, np.full((len(line), 2), 0.3)]), line
    )
    points = np.column_stack([np.linspace(4.0, 17.0, 400), np.full(400, 2.15)])
    s, d = track.to_frenet(points).T
    assert np.abs(track.to_cartesian(np.column_stack([s, np.zeros(400)]))[:, 1] - 1.3).max() < 0.02
    np.testing.assert_allclose(
        track.to_cartesian(np.column_stack([s, d]))[:, :2], points, atol=1e-9
    )
    points[:, 1] = 4.2
    np.testing.assert_allclose(track.to_frenet(points)[:, 1], -1.7, atol=0.02)


fractions = st.floats(0.0, 1.0, exclude_max=True)


def _difference(track, a, b):
    """Signed way along the line from b to a."""
    return (a - b + 0.5 * track.length) % track.length - 0.5 * track.length


def test_the_oval_is_what_geometry_says_on_and_off_the_map_and_so_is_its_slope(oval):
    x, y, psi = oval.to_cartesian([[0.0, 0.0], [6.0, 0.5], [12.0 + 2.0 * np.pi, 1.0]]).T
    np.testing.assert_allclose(
        np.column_stack([x, y]), [[-6.0, -4.0], [0.0, -3.5], [9.0, 0.0]], atol=0.01
    )
    np.testing.assert_allclose(psi, [0.0, 0.0, 0.5 * np.pi], atol=0.02)
    s, d = oval.to_frenet([0.0, -50.0])
    np.testing.assert_allclose([s, d], [6.0, -46.0], atol=0.01)
    s, d = oval.to_frenet([60.0, 0.0])
    np.testing.assert_allclose([s, d], [12.0 + 2.0 * np.pi, -50.0], atol=0.05)
    assert oval.to_frenet(np.zeros((3, 4, 2))).shape == (3, 4, 2)
    assert oval.to_cartesian(np.zeros((3, 4, 2))).shape == (3, 4, 3)
    assert oval.wall_distance(np.zeros((3, 4, 2))).shape == (3, 4)
    # Heading against finite differences of the points, all along the line and off it.
    s = np.arange(0.013, oval.length - 0.1, 0.037)
    for d in (0.0, 0.7, -0.9):
        at = np.full_like(s, d)
        here = oval.to_cartesian(np.column_stack([s, at]))
        ahead, behind = (
            oval.to_cartesian(np.column_stack([s + h, at]))[:, :2] for h in (1e-5, -1e-5)
        )
        way = np.arctan2(*(ahead - behind).T[::-1])
        np.testing.assert_allclose(np.cos(way - here[:, 2]), 1.0, atol=1e-7)


@given(along=fractions, across=st.floats(-0.9, 0.9), direction=st.floats(-np.pi, np.pi))
def test_s_and_d_are_continuous_in_every_direction(oval, along, across, direction):
    """Steps of 1 mm change s by at most 1 mm / (1 - kappa d), and d by at most 1 mm."""
    x, y, _ = frenet.to_cartesian(oval.arrays, along * oval.length, across)
    r = np.arange(200) * 1e-3
    found = np.array(
        [
            frenet.project(
                oval.arrays,
                x + a * np.cos(direction),
                y + a * np.sin(direction),
                along * oval.length,
            )
            for a in r
        ]
    )
    stretch = 1.0 / (1.0 - np.abs(oval.line[:, KAPPA]).max() * (abs(across) + 0.2))
    assert np.abs(_difference(oval, found[1:, 0], found[:-1, 0])).max() <= 1.001e-3 * stretch
    assert np.abs(np.diff(found[:, 1])).max() <= 1.0001e-3


@given(hint=st.floats(-1e6, 1e6), along=fractions)
def test_any_real_hint_is_wrapped(oval, hint, along):
    x, y, _ = frenet.to_cartesian(oval.arrays, along * oval.length, 0.0)
    s, _ = frenet.project(
        oval.arrays, x, y, along * oval.length + np.round(hint / 100.0) * oval.length
    )
    assert abs(_difference(oval, s, along * oval.length)) < 1e-6
    assert 0.0 <= frenet.wrap_s(oval.arrays, hint) < oval.length


def test_wall_distance_is_interpolated_between_the_centres_of_the_four_cells_around_a_point(oval):
    arrays = oval.arrays
    field, (rows, cols) = arrays.distance.astype(float), arrays.distance.shape
    rng = np.random.default_rng(4)
    points = rng.uniform([0.0, 0.0], [cols, rows], (3000, 2))  # in cells from the corner
    expected = []
    for u, v in points - 0.5:
        j, i = int(np.floor(u)), int(np.floor(v))
        if i < 0 or j < 0 or i + 1 >= rows or j + 1 >= cols:
            expected.append(0.0)  # beyond the outermost centres
            continue
        right, up = u - j, v - i
        weights = np.outer([1.0 - up, up], [1.0 - right, right])
        expected.append((weights * field[i : i + 2, j : j + 2]).sum())
    found = oval.wall_distance(points * arrays.cell + [arrays.origin_x, arrays.origin_y])
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.max(found) > 1.0


@given(along=fractions, share=st.floats(-0.9, 0.9), off=st.floats(-1.0, 1.0))
def test_projecting_a_point_that_was_built_from_s_and_d_gives_them_back(along, share, off):
    """On a circuit whose curvature changes everywhere, from a hint some way off."""
    track = load_track("Vellindra")
    s = along * track.length
    row = track.line[int(s / track.arrays.ds) % len(track.line)]
    d = share * min(row[LEFT], row[RIGHT], 0.5 / max(abs(row[KAPPA]), 1e-9))
    x, y, _ = frenet.to_cartesian(track.arrays, s, d)
    s_found, d_found = frenet.project(track.arrays, x, y, s + off)
    assert abs(_difference(track, s_found, s)) < 1e-9
    assert abs(d_found - d) < 1e-9
    assert 0.0 <= s_found < track.length


@pytest.mark.parametrize("name", ["Spielberg", "Catalunya", "Oschersleben"])
def test_real_circuits_can_be_raced_on(real_maps, name):
    track = load_track(real_maps / name)
    assert track.wall_distance(track.line[:, :2]).min() >= 0.28
    assert np.abs(track.line[:, KAPPA]).max() < 1.3
    assert (track.line[:, [RIGHT, LEFT]] > 0.28).all()
    assert track.wall_distance(track.centerline[:, :2]).min() > 0.4
    jumps = np.abs(np.diff(track.to_frenet(track.centerline[:, :2])[:, 0]))
    assert np.minimum(jumps, track.length - jumps).max() < 1.5
