"""Frenet coordinates: there and back, without jumps, and without a hint."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pcs_racing import load_track
from pcs_racing.track import frenet
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT

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


@settings(max_examples=20)
@given(angle=st.floats(-100.0, 100.0), other=st.floats(-100.0, 100.0))
def test_angle_between_is_the_short_way_round(angle, other):
    found = frenet.angle_between(angle, other)
    assert -np.pi <= found <= np.pi
    assert abs(np.sin(0.5 * (angle - other - found))) < 1e-9


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
