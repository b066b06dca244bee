"""Race lines keep clear of the walls, are smooth, simple and faster than the centre line; speeds
keep every limit.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused

from pcs_racing.base.errors import InputError, MapError
from pcs_racing.track.building import curves, raceline
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import first_crossing, resample, signed_area
from pcs_racing.track.building.raceline import (
    lap_time,
    minimum_curvature_raceline,
    raceline_rows,
    speed_profile,
)
from pcs_racing.track.mapping.circuits import walls_to_grid

CURVATURES = arrays(np.float64, st.integers(1, 60), elements=st.floats(-3.0, 3.0))


def lap(xy: np.ndarray) -> float:
    rows = raceline_rows(xy)
    return lap_time(rows[:-1, 5], rows[1, 0])


def assert_sound(line, grid, resolution, origin, clearance=0.305):
    free = wall_clearance(resample(line, 0.02), grid, resolution, np.asarray(origin), 1.0)
    assert free.min() >= clearance - 1e-6
    assert first_crossing(line) == (-1, -1)
    kappa = raceline_rows(line)[:-1, 4]
    # Curvature runs smoothly: it changes its slope by little from sample to sample.
    assert np.abs(np.diff(kappa, 2, append=kappa[:2])).max() < 0.1 * np.abs(kappa).max()


@pytest.mark.parametrize("clearance", [0.305, 0.6])
def test_a_ring(box, clearance):
    line, grid, resolution, origin = box
    race = minimum_curvature_raceline(line, grid, resolution, origin, clearance=clearance)
    assert_sound(race, grid, resolution, origin, clearance)
    assert lap(race) < lap(line) - 0.5
    # A corner is cut: from outside to inside to outside.
    sharpest = [np.abs(raceline_rows(xy)[:-1, 4]).max() for xy in (race, line)]
    assert sharpest[0] < (0.7 if clearance < 0.5 else 1.0) * sharpest[1]
    assert signed_area(race) > 0.0
    assert np.hypot(*(race[0] - line[0])) < 2.2


def test_the_line_of_a_circular_track_is_a_circle_and_a_narrow_place_is_named(monkeypatch):
    t = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    line = 8.0 * np.column_stack([np.cos(t), np.sin(t)])
    grid, origin = walls_to_grid(line, 2.2, 0.05)
    for weight, radius in ((0.0, 9.1 - 0.305), (0.2, 6.9 + 0.305)):
        # By curvature alone the widest circle is the best one, with the length the narrowest.
        monkeypatch.setattr(raceline, "LENGTH_WEIGHT", weight)
        race = minimum_curvature_raceline(line, grid, 0.05, origin)
        np.testing.assert_allclose(np.hypot(*race.T), radius, atol=0.06)
    i, j = np.floor((np.array([8.0, 0.0]) - origin) / 0.05).astype(int)[::-1]
    grid[i : i + 3, j - 10 : j + 11] = True
    narrow = r"narrow .*\((7|8)\.\d\d, -?0\.\d\d\)"
    refused(narrow, minimum_curvature_raceline, line, grid, 0.05, origin, error=MapError)


@pytest.mark.parametrize(("width", "size"), [(3.0, 8.0), (6.0, 10.0), (12.0, 16.0)])
def test_a_second_search_from_the_result_finds_no_faster_line(width, size):
    t = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    line = size * np.column_stack([1.5 * np.cos(t), np.sin(t)])
    grid, origin = walls_to_grid(line, width, 0.1)
    race = minimum_curvature_raceline(line, grid, 0.1, origin)
    again = minimum_curvature_raceline(race, grid, 0.1, origin)
    assert lap(again) == pytest.approx(lap(race), rel=0.002)


def test_an_obstacle_on_the_centre_line_is_passed_on_its_wider_side(box):
    line, grid, resolution, origin = box
    grid = grid.copy()
    i, j = np.floor((np.array([0.0, -7.1]) - origin) / resolution).astype(int)[::-1]
    grid[i - 4 : i + 5, j - 6 : j + 7] = True  # to its outside there is less room
    race = minimum_curvature_raceline(line, grid, resolution, origin)
    assert_sound(race, grid, resolution, origin)
    x, y = race[race[:, 1] < 0.0].T
    assert y[np.argmin(np.abs(x))] > -7.1


def test_impossible_values_are_refused(box):
    for change, error, words in [
        ({"clearance": -0.1}, InputError, "clearance is -0.1"),
        (
            {"centerline": [[-500.0, 0.0], [0.0, 500.0], [500.0, 0.0], [0.0, -500.0]]},
            MapError,
            "leaves the map at",
        ),
        ({"resolution": -0.05}, MapError, "resolution is -0.05"),
    ]:
        line, grid, resolution, origin = box
        arguments = {
            "centerline": line,
            "occupied": grid,
            "resolution": resolution,
            "origin": origin,
        } | change
        with pytest.raises(error, match=words):
            minimum_curvature_raceline(**arguments)


def test_rows_follow_the_file_format_and_give_the_lap_time(box):
    line = box[0]
    rows = raceline_rows(line)
    s, x, y, psi, kappa, v, ax = rows.T
    np.testing.assert_allclose(np.diff(s), s[1])
    np.testing.assert_array_equal(rows[-1, 1:], rows[0, 1:])
    ahead = np.diff(np.column_stack([x, y]), axis=0)
    assert (
        np.abs(np.angle(np.exp(1j * (np.arctan2(ahead[:, 1], ahead[:, 0]) - psi[:-1])))).max() < 0.1
    )
    # Heading turns by the integral of the curvature: one full turn.
    assert np.sum(kappa[:-1]) * s[1] == pytest.approx(2.0 * np.pi, rel=1e-3)
    np.testing.assert_allclose(v[:-1] ** 2 + 2.0 * ax[:-1] * s[1], v[1:] ** 2)
    assert lap_time(np.full(50, 4.0), 0.2) == pytest.approx(2.5)
    # From 2 to 4 m/s and back at constant acceleration: the mean speed is 3 m/s.
    assert lap_time(np.array([2.0, 4.0]), 3.0) == pytest.approx(2.0)


@given(kappa=CURVATURES, ds=st.floats(0.05, 3.0))
def test_every_sample_is_held_back_by_some_limit_and_none_is_exceeded(kappa, ds):
    """5 m/s^2 across, 3.5 forwards, 4.5 backwards, 8 m/s: the min of these limits is the
    speed.
    """
    w = speed_profile(kappa, ds) ** 2
    cap = np.minimum(5.0 / np.maximum(np.abs(kappa), 1e-12), 8.0**2)
    forwards = np.roll(w, 1) + 2.0 * 3.5 * ds
    backwards = np.roll(w, -1) + 2.0 * 4.5 * ds
    np.testing.assert_allclose(w, np.minimum(cap, np.minimum(forwards, backwards)), rtol=1e-9)


@given(radius=st.floats(0.5, 20.0), waves=st.integers(4, 12))
def test_smoothing_damps_a_wave_as_it_says(radius, waves):
    t = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ripple = 1e-3 * radius * np.exp(1j * waves * t)
    z = radius * np.exp(1j * t) + ripple
    length = curves.curve_length(np.column_stack([z.real, z.imag]))
    wavelength = length / waves
    smoothed = curves.smooth(np.column_stack([z.real, z.imag]), wavelength) @ (1.0, 1j)
    mode = np.fft.fft(smoothed)[waves] / 400
    assert abs(mode) == pytest.approx(0.5e-3 * radius, rel=1e-6)


@given(
    radius=st.floats(0.5, 50.0),
    count=st.integers(30, 300),
    clockwise=st.booleans(),
    start=st.floats(0.0, 6.0),
)
def test_a_circle_stays_a_circle(radius, count, clockwise, start):
    sign = -1.0 if clockwise else 1.0
    angle = start + np.linspace(0.0, 2.0 * np.pi, count, endpoint=False) * sign
    samples = curves.sample_closed(
        radius * np.column_stack([np.cos(angle), np.sin(angle)]), radius / 20.0
    )
    np.testing.assert_allclose(samples.length, 2.0 * np.pi * radius, rtol=1e-4)
    np.testing.assert_allclose(np.hypot(*samples.xy.T), radius, rtol=1e-4)
    np.testing.assert_allclose(samples.kappa, sign / radius, rtol=0.01)
    turned = sign * 2.0 * np.pi * (1 - 1 / len(samples.xy))
    np.testing.assert_allclose(samples.psi[-1] - samples.psi[0], turned, rtol=1e-4)
    np.testing.assert_allclose(np.hypot(*samples.tangent.T), 1.0)


def test_samples_are_evenly_spaced_whatever_the_points_and_repeated_ones_do_no_harm():
    """An ellipse with unevenly spaced points: the arc between samples, finely measured, is the same
    everywhere.
    """
    t = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    t = t + 0.3 * np.sin(3.0 * t)
    points = np.column_stack([10.0 * np.cos(t), 4.0 * np.sin(t)])
    samples = curves.sample_closed(points, 0.1)
    chord = np.linalg.norm(np.roll(samples.xy, -1, axis=0) - samples.xy, axis=1)
    ds = samples.length / len(samples.xy)
    np.testing.assert_allclose(chord * (1.0 + samples.kappa**2 * ds**2 / 24.0), ds, rtol=1e-5)
    np.testing.assert_allclose(samples.xy[0], points[0], atol=1e-12)
    np.testing.assert_allclose(
        (samples.xy[:, 0] / 10.0) ** 2 + (samples.xy[:, 1] / 4.0) ** 2, 1.0, atol=1e-4
    )
    square = [[0, 0], [1, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert curves.clean_closed(square).tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    refused(
        "points, got 3",
        curves.sample_closed,
        [[0, 0], [1, 0], [1, 0], [1, 1], [0, 0]],
        0.1,
        error=ValueError,
    )
