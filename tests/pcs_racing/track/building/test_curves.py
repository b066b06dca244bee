"""Closed curves: spacing, area, smoothing, crossings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing.base.errors import MapError
from pcs_racing.track.building import curves


def circle(radius: float, points: int = 200) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    return radius * np.column_stack([np.cos(t), np.sin(t)])


@given(radius=st.floats(0.5, 50.0), step=st.floats(0.05, 0.4))
def test_resampled_points_are_evenly_spaced_and_stay_on_the_curve(radius, step):
    points = curves.resample(circle(radius), step)
    chords = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    np.testing.assert_allclose(chords, chords[0], rtol=1e-6)
    np.testing.assert_allclose(np.hypot(*points.T), radius, rtol=1e-6)
    np.testing.assert_allclose(points[0], (radius, 0.0), atol=1e-12)


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


def test_area_tells_the_direction_and_a_figure_of_eight_crosses_itself():
    assert curves.signed_area(circle(2.0, 1000)) == pytest.approx(4.0 * np.pi, rel=1e-4)
    assert curves.signed_area(circle(2.0, 1000)[::-1]) == pytest.approx(-4.0 * np.pi, rel=1e-4)
    closed = np.vstack([circle(1.0, 20), circle(1.0, 20)[:1]])
    assert len(curves.checked_curve(closed, "line")) == 20
    t = np.linspace(0.0, 2.0 * np.pi, 101)[:-1]
    eight = np.column_stack([np.sin(t), np.sin(2.0 * t)])
    assert curves.first_crossing(circle(3.0)) == (-1, -1)
    i, j = curves.first_crossing(eight)
    assert 0 <= i < j < 100
    np.testing.assert_allclose(eight[[i, j]], 0.0, atol=0.2)


def test_impossible_curves_are_refused():
    for points, words in [
        (np.zeros(5), "shape"),
        (np.zeros((9, 2)), "0 different points"),
        ([[0.0, 0.0], [1.0, np.inf], [1.0, 1.0], [0.0, 1.0]], "row 1"),
        (circle(3.0)[:120], "open"),
    ]:
        refused(words, curves.checked_curve, points, "line", error=MapError)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 12, 30, 97, 360, 1801, 3072])
def test_the_transform_is_numpys(count):
    rng = np.random.default_rng(count)
    x = rng.normal(size=count) + 1j * rng.normal(size=count)
    real, imaginary = curves.transform(x.real.copy(), x.imag.copy())
    np.testing.assert_allclose(real + 1j * imaginary, np.fft.fft(x), rtol=0, atol=1e-15 * count * np.abs(x).max())
