"""The speed profile keeps every limit, is as fast as they allow, and closes on itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pcs_racing.track.building.speed import lap_time, speed_profile

CURVATURES = arrays(np.float64, st.integers(1, 60), elements=st.floats(-3.0, 3.0))


@given(kappa=CURVATURES, ds=st.floats(0.05, 3.0))
def test_every_sample_is_held_back_by_some_limit_and_none_is_exceeded(kappa, ds):
    """5 m/s^2 across, 3.5 forwards, 4.5 backwards, 8 m/s: the least of what these allow is the speed."""
    w = speed_profile(kappa, ds) ** 2
    cap = np.minimum(5.0 / np.maximum(np.abs(kappa), 1e-12), 8.0**2)
    forwards = np.roll(w, 1) + 2.0 * 3.5 * ds
    backwards = np.roll(w, -1) + 2.0 * 4.5 * ds
    np.testing.assert_allclose(w, np.minimum(cap, np.minimum(forwards, backwards)), rtol=1e-9)


@given(kappa=CURVATURES, shift=st.integers(-60, 60))
def test_the_start_line_may_lie_anywhere(kappa, shift):
    np.testing.assert_allclose(
        speed_profile(np.roll(kappa, shift), 0.3), np.roll(speed_profile(kappa, 0.3), shift), rtol=1e-12
    )


def test_lap_time_of_a_steady_lap_and_of_a_ramp():
    assert lap_time(np.full(50, 4.0), 0.2) == pytest.approx(2.5)
    # From 2 to 4 m/s and back at constant acceleration: the mean speed is 3 m/s.
    assert lap_time(np.array([2.0, 4.0]), 3.0) == pytest.approx(2.0)
