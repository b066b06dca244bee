"""Closed curves: spacing, area, smoothing, crossings, and the splines through them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing.track.building import curves


def circle(radius: float, points: int = 200) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    return radius * np.column_stack([np.cos(t), np.sin(t)])


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
    assert len(curves.clean_closed(closed)) == 20
    t = np.linspace(0.0, 2.0 * np.pi, 101)[:-1]
    eight = np.column_stack([np.sin(t), np.sin(2.0 * t)])
    assert curves.first_crossing(circle(3.0)) == (-1, -1)
    i, j = curves.first_crossing(eight)
    assert 0 <= i < j < 100
    np.testing.assert_allclose(eight[[i, j]], 0.0, atol=0.2)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 12, 30, 97, 360, 1801, 3072])
def test_the_transform_is_numpys(count):
    rng = np.random.default_rng(count)
    x = rng.normal(size=count) + 1j * rng.normal(size=count)
    real, imaginary = curves.transform(x.real.copy(), x.imag.copy())
    np.testing.assert_allclose(
        real + 1j * imaginary, np.fft.fft(x), rtol=0, atol=1e-15 * count * np.abs(x).max()
    )


@given(n=st.integers(3, 30), seed=st.integers(0, 2**32 - 1))
def test_cyclic_systems_are_solved(n, seed):
    rng = np.random.default_rng(seed)
    lower, upper = rng.uniform(-1.0, 1.0, (2, n))
    diagonal = np.abs(lower) + np.abs(upper) + rng.uniform(0.1, 2.0, n)
    right = rng.normal(size=(n, 2))
    matrix = np.diag(diagonal)
    for i in range(n):
        matrix[i, i - 1] += lower[i]
        matrix[i, (i + 1) % n] += upper[i]
    solved = curves.solve_cyclic(lower, diagonal, upper, right)
    np.testing.assert_allclose(solved, np.linalg.solve(matrix, right), atol=1e-9)


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


def test_curvature_is_the_change_of_the_heading_per_metre_also_between_distant_points():
    t, r = [0.0, 0.3, 1.2, 2.0, 2.4, 3.5, 4.4, 5.5], [5.0, 6.0, 4.0, 6.0, 5.0, 7.0, 5.0, 6.0]
    samples = curves.sample_closed(np.column_stack([r * np.cos(t), r * np.sin(t)]), 0.02)
    ds = samples.length / len(samples.xy)
    turned = (samples.psi[2:] - samples.psi[:-2]) / (2.0 * ds)
    np.testing.assert_allclose(samples.kappa[1:-1], turned, atol=0.01)
