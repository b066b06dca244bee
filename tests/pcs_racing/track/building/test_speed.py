"""The speed profile keeps every limit, is as fast as they allow, and closes on itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pcs_racing.base.errors import InputError
from pcs_racing.track.building.speed import lap_time, speed_profile

CURVATURES = arrays(np.float64, st.integers(1, 60), elements=st.floats(-3.0, 3.0))
LIMITS = st.fixed_dictionaries(
    {name: st.floats(0.5, 12.0) for name in ("lateral", "braking", "acceleration", "top_speed")}
)


@given(kappa=CURVATURES, ds=st.floats(0.05, 3.0), limits=LIMITS)
def test_no_limit_is_ever_exceeded(kappa, ds, limits):
    v = speed_profile(kappa, ds, **limits)
    change = (np.roll(v, -1) ** 2 - v**2) / (2.0 * ds)
    assert np.all(v > 0.0)
    assert np.all(v <= limits["top_speed"] * (1 + 1e-12))
    assert np.all(v**2 * np.abs(kappa) <= limits["lateral"] * (1 + 1e-9))
    assert np.all(change <= limits["acceleration"] + 1e-9)
    assert np.all(change >= -limits["braking"] - 1e-9)


@given(kappa=CURVATURES, ds=st.floats(0.05, 3.0), limits=LIMITS)
def test_every_sample_is_held_back_by_some_limit(kappa, ds, limits):
    w = speed_profile(kappa, ds, **limits) ** 2
    cap = np.minimum(limits["lateral"] / np.maximum(np.abs(kappa), 1e-12), limits["top_speed"] ** 2)
    forwards = np.roll(w, 1) + 2.0 * limits["acceleration"] * ds
    backwards = np.roll(w, -1) + 2.0 * limits["braking"] * ds
    np.testing.assert_allclose(w, np.minimum(cap, np.minimum(forwards, backwards)), rtol=1e-9)


@given(kappa=CURVATURES, shift=st.integers(-60, 60))
def test_the_start_line_may_lie_anywhere(kappa, shift):
    np.testing.assert_allclose(
        speed_profile(np.roll(kappa, shift), 0.3), np.roll(speed_profile(kappa, 0.3), shift), rtol=1e-12
    )


def test_a_wide_circle_is_driven_flat_out():
    np.testing.assert_array_equal(speed_profile(np.full(100, 1.0 / 20.0), 0.2), 8.0)


def test_a_tight_circle_is_driven_at_its_cornering_speed():
    np.testing.assert_allclose(speed_profile(np.full(100, -0.5), 0.2), np.sqrt(5.0 / 0.5))


def test_steps_may_differ_from_sample_to_sample():
    kappa = np.array([0.0, 5.0, 0.0])
    v = speed_profile(kappa, np.array([1.0, 2.0, 30.0]))
    np.testing.assert_allclose(v, np.sqrt([1.0 + 2 * 4.5, 1.0, 1.0 + 2 * 3.5 * 2]))


def test_lap_time_of_a_steady_lap_and_of_a_ramp():
    assert lap_time(np.full(50, 4.0), 0.2) == pytest.approx(2.5)
    # From 2 to 4 m/s and back at constant acceleration: the mean speed is 3 m/s.
    assert lap_time(np.array([2.0, 4.0]), 3.0) == pytest.approx(2.0)


@pytest.mark.parametrize("v", [[], [1.0, 0.0], [1.0, np.inf], 3.0])
def test_a_lap_takes_positive_speeds(v):
    with pytest.raises(InputError, match=r"^v must"):
        lap_time(v, 0.2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"kappa": [0.1, np.nan], "ds": 0.2}, r"kappa\[1\] is not finite"),
        ({"kappa": [], "ds": 0.2}, "kappa has shape"),
        ({"kappa": [0.1], "ds": 0.0}, "ds holds"),
        ({"kappa": [0.1, 0.2], "ds": [0.1, 0.1, 0.1]}, r"ds has shape \(3,\)"),
        ({"kappa": [0.1], "ds": 0.2, "braking": -1.0}, "braking is -1.0"),
    ],
)
def test_impossible_values_are_named(arguments, words):
    with pytest.raises(InputError, match=words):
        speed_profile(**arguments)
