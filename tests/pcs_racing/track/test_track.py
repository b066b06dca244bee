"""Tracks built from values."""

import dataclasses

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.errors import MapError
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
