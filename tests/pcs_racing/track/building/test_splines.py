"""Closed splines: circles stay circles, samples are evenly spaced, the cyclic solver solves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing.track.building.curves import clean_closed, sample_closed, solve_cyclic


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
    np.testing.assert_allclose(solve_cyclic(lower, diagonal, upper, right), np.linalg.solve(matrix, right), atol=1e-9)


@given(radius=st.floats(0.5, 50.0), count=st.integers(30, 300), clockwise=st.booleans(), start=st.floats(0.0, 6.0))
def test_a_circle_stays_a_circle(radius, count, clockwise, start):
    angle = start + np.linspace(0.0, 2.0 * np.pi, count, endpoint=False) * (-1.0 if clockwise else 1.0)
    samples = sample_closed(radius * np.column_stack([np.cos(angle), np.sin(angle)]), radius / 20.0)
    sign = -1.0 if clockwise else 1.0
    np.testing.assert_allclose(samples.length, 2.0 * np.pi * radius, rtol=1e-4)
    np.testing.assert_allclose(np.hypot(*samples.xy.T), radius, rtol=1e-4)
    np.testing.assert_allclose(samples.kappa, sign / radius, rtol=0.01)
    np.testing.assert_allclose(
        samples.psi[-1] - samples.psi[0], sign * 2.0 * np.pi * (1 - 1 / len(samples.xy)), rtol=1e-4
    )
    np.testing.assert_allclose(np.hypot(*samples.tangent.T), 1.0)


def test_samples_are_evenly_spaced_whatever_the_points_and_repeated_ones_do_no_harm():
    """An ellipse with unevenly spaced points: the arc between samples, finely measured, is the same everywhere."""
    t = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    t = t + 0.3 * np.sin(3.0 * t)
    points = np.column_stack([10.0 * np.cos(t), 4.0 * np.sin(t)])
    samples = sample_closed(points, 0.1)
    chord = np.linalg.norm(np.roll(samples.xy, -1, axis=0) - samples.xy, axis=1)
    ds = samples.length / len(samples.xy)
    np.testing.assert_allclose(chord * (1.0 + samples.kappa**2 * ds**2 / 24.0), ds, rtol=1e-5)
    np.testing.assert_allclose(samples.xy[0], points[0], atol=1e-12)
    np.testing.assert_allclose((samples.xy[:, 0] / 10.0) ** 2 + (samples.xy[:, 1] / 4.0) ** 2, 1.0, atol=1e-4)
    square = [[0, 0], [1, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert clean_closed(square).tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    with pytest.raises(ValueError, match="points, got 3"):
        sample_closed([[0, 0], [1, 0], [1, 0], [1, 1], [0, 0]], 0.1)
