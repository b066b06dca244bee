"""Own sine, arctangent and so on: how near they are to the truth, computed in long double."""

import numpy as np
import pytest

from pcs_racing.base import elementary

exact = np.longdouble
needs_more_digits = pytest.mark.skipif(
    np.finfo(exact).eps > 1e-18, reason="long double has no more digits than double here"
)


def ulps(found: float, true: np.longdouble) -> float:
    """Error in units of the last place of the true value."""
    return float(abs(exact(found) - true) / exact(np.spacing(abs(float(true)))))


def spread(low: float, high: float, count: int = 2000) -> np.ndarray:
    """Numbers of an interval, both its ends and the neighbourhood of 0 among them."""
    rng = np.random.default_rng(1)
    inside = rng.uniform(low, high, count)
    return np.concatenate([[low, high], inside, inside[:200] * 1e-3, inside[:200] * 1e-9])


@needs_more_digits
@pytest.mark.parametrize(
    ("own", "true", "values", "most"),
    [
        (lambda x: elementary.sine_cosine(x)[0], np.sin, spread(-0.785, 0.785), 1.0),
        (lambda x: elementary.sine_cosine(x)[1], np.cos, spread(-0.785, 0.785), 1.0),
        (elementary.tangent, np.tan, spread(-1.5, 1.5), 3.0),
        (elementary.arctangent, np.arctan, spread(-6.0, 6.0), 1.0),
        (elementary.arctangent, np.arctan, spread(-1e6, 1e6), 1.0),
        (elementary.arcsine, np.arcsin, spread(-1.0, 1.0), 3.0),
        (elementary.exponential, np.exp, spread(-5.0, 5.0), 2.0),
        (elementary.exponential, np.exp, spread(-700.0, 700.0), 2.0),
        (elementary.hyperbolic_tangent, np.tanh, spread(-0.7, 0.7), 2.0),
        (elementary.hyperbolic_tangent, np.tanh, spread(-30.0, 30.0), 2.0),
    ],
)
def test_the_error_is_that_of_the_docstring(own, true, values, most):
    assert max(ulps(own(x), true(exact(x))) for x in values) <= most


@needs_more_digits
def test_sine_and_cosine_of_many_turns_and_directions_in_all_quadrants():
    angles = spread(-1000.0, 1000.0)
    sines, cosines = elementary.sines_cosines(angles)
    assert np.abs(sines - np.sin(angles.astype(exact))).max() < 1.5e-16
    assert np.abs(cosines - np.cos(angles.astype(exact))).max() < 1.5e-16
    vectors = np.random.default_rng(2).normal(size=(2000, 2)) * [[1.0, 0.1]]
    for (x, y), found in zip(vectors, elementary.headings(vectors), strict=True):
        assert ulps(found, np.arctan2(exact(y), exact(x))) <= 2.0


@pytest.mark.parametrize("y", [-1.0, 0.0, 2.0])
@pytest.mark.parametrize("x", [-3.0, 0.0, 1.0])
def test_directions_along_the_axes(x, y):
    assert elementary.arctangent2(y, x) == pytest.approx(np.arctan2(y, x), abs=0.0, rel=1e-15)


def test_values_at_the_ends_of_the_range_and_lengths_of_vectors():
    assert elementary.exponential(0.0) == 1.0
    assert elementary.exponential(-746.0) == elementary.exponential(-np.inf) == 0.0
    assert elementary.exponential(710.0) == elementary.exponential(np.inf) == np.inf
    assert elementary.exponential(-745.0) == 5e-324
    assert elementary.exponential(709.7) == pytest.approx(1.6549840276802644e308, rel=1e-15)
    assert np.isnan(elementary.exponential(np.nan))
    for found in (
        *elementary.sine_cosine(np.nan),
        elementary.arctangent(np.nan),
        elementary.hyperbolic_tangent(np.nan),
    ):
        assert np.isnan(found)
    for x in spread(0.0, 3.0, 200):
        assert elementary.sine_cosine(-x) == (
            -elementary.sine_cosine(x)[0],
            elementary.sine_cosine(x)[1],
        )
        assert elementary.arctangent(-x) == -elementary.arctangent(x)
        assert elementary.hyperbolic_tangent(-x) == -elementary.hyperbolic_tangent(x)
    assert elementary.hyperbolic_tangent(400.0) == elementary.hyperbolic_tangent(np.inf) == 1.0
    assert elementary.hyperbolic_tangent(-400.0) == -1.0
    assert elementary.lengths(np.array([3.0, 4.0])) == 5.0
    assert elementary.lengths(np.array([[[3.0, 4.0], [0.0, -2.0]]])).tolist() == [[5.0, 2.0]]
