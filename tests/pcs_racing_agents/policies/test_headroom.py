"""Headroom on pools whose true payoffs are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing_agents.policies.headroom import (
    cyclic_part,
    cyclic_planes,
    headroom,
    ratings,
    transitive_share,
)

FOLDS, RACES = 4, 400


def ladder(policies: int, step: float = 0.02) -> np.ndarray:
    """Payoffs of policies that only differ in strength."""
    strength = step * np.arange(policies)
    return strength[:, None] - strength[None, :]


def wheel(policies: int, size: float = 0.3) -> np.ndarray:
    """Payoffs of policies on a circle: each beats those up to half a turn behind it."""
    angle = 2.0 * np.pi * np.arange(policies) / policies
    return size * np.sin(angle[:, None] - angle[None, :])


def played(payoffs: np.ndarray, seed: int, races: int = RACES, folds: int = FOLDS) -> np.ndarray:
    """Payoffs as races show them: each fold is a mean of races that are won or lost."""
    rng = np.random.default_rng(seed)
    won = np.triu(rng.binomial(races, 0.5 + payoffs, size=(folds, *payoffs.shape)) / races - 0.5, 1)
    return won - won.transpose(0, 2, 1)


def test_a_pool_whose_fastest_beats_all_has_no_headroom_nor_has_luck_in_one_fold():
    estimates = [headroom(played(ladder(10), seed)) for seed in range(10)]
    assert abs(np.mean([estimate.value for estimate in estimates])) < 0.01
    assert {estimate.best_fixed for estimate in estimates} == {9}
    # In the first fold policy 0 beats everybody by luck; nothing of that is left in the others.
    folds = np.zeros((2, 3, 3))
    folds[0, 0, 1:], folds[0, 1:, 0] = 0.5, -0.5
    folds[1, 2, :2], folds[1, :2, 2] = 0.5, -0.5
    # Chosen on fold 1, policy 2 is fixed and the reply to all; on fold 0, policy 0 is.
    assert headroom(folds).value == 0.0


@pytest.mark.parametrize("strength", [0.0, 0.02])
def test_headroom_of_a_wheel_is_what_its_true_payoffs_say(strength):
    truth = wheel(9, 0.15) + ladder(9, strength)
    estimates = [headroom(played(truth, seed)) for seed in range(10)]
    error = np.mean([estimate.opponents_error for estimate in estimates])
    expected = truth.max(axis=0).mean() - truth.mean(axis=1).max()
    assert abs(np.mean([estimate.value for estimate in estimates]) - expected) < error
    assert all(estimate.low <= estimate.value + 1e-12 for estimate in estimates)


def test_gains_add_up_to_the_headroom_and_parts_to_the_payoffs():
    result = headroom(played(wheel(6), 3))
    assert result.gains.shape == (6,)
    assert result.gains.mean() == pytest.approx(result.value)
    assert result.opponents_error == pytest.approx(result.gains.std(ddof=1) / np.sqrt(6))
    folds = played(wheel(7) + ladder(7), 1)
    rating = ratings(folds)
    np.testing.assert_allclose(
        rating[:, None] - rating[None, :] + cyclic_part(folds), folds.mean(axis=0), atol=1e-12
    )
    np.testing.assert_allclose(cyclic_part(folds).sum(axis=1), 0.0, atol=1e-12)


def test_the_error_over_the_pool_is_near_what_fresh_pools_of_the_same_kind_vary_by():
    """Pools of 12 drawn from a family: points at random angles of a wheel."""
    rng = np.random.default_rng(5)
    values, errors = [], []
    for seed in range(60):
        angle = rng.uniform(0.0, 2.0 * np.pi, 12)
        result = headroom(played(0.2 * np.sin(angle[:, None] - angle[None, :]), seed, 2000))
        values.append(result.value)
        errors.append(result.pool_error)
    assert 0.5 < np.mean(errors) / np.std(values) < 2.0


def test_the_transitive_share_is_free_of_noise_and_1_of_a_ladder():
    """With few races noise is most of the raw variance, and none of it belongs to the ratings."""
    step = 0.02
    truth = wheel(9, 0.1) + ladder(9, step)
    transitive = ladder(9, step)
    share = np.square(transitive).sum() / np.square(truth).sum()
    estimates = [transitive_share(played(truth, seed, 30)) for seed in range(60)]
    assert np.mean(estimates) == pytest.approx(share, abs=0.05)
    assert transitive_share(np.stack([ladder(3, 0.01)] * 2)) == pytest.approx(1.0)
    assert np.isnan(transitive_share(np.zeros((2, 3, 3))))


@given(seed=st.integers(0, 1000))
def test_planes_add_up_to_the_cyclic_part(seed):
    folds = played(wheel(6) + ladder(6), seed, 20)
    points = [plane.points.T for plane in cyclic_planes(folds)]
    parts = [np.outer(x, y) - np.outer(y, x) for x, y in points]
    np.testing.assert_allclose(sum(parts), cyclic_part(folds), atol=1e-10)


def test_planes_lie_around_the_origin_and_noise_alone_passes_its_edge_in_one_of_twenty():
    plane, *others = cyclic_planes(played(wheel(3, 0.3), 2))
    assert plane.strength > plane.noise
    assert not any(other.strength > other.noise for other in others)
    angles = np.unwrap(np.arctan2(plane.points[:, 1], plane.points[:, 0]))
    np.testing.assert_allclose(np.abs(np.diff(angles)), 2.0 * np.pi / 3.0, atol=0.1)
    # One of sixteen with 16 folds: 6 % and two standard errors of 100 draws are 11.
    passed = [cyclic_planes(played(ladder(8), seed, 100, folds=16))[0] for seed in range(100)]
    assert 1 <= sum(plane.strength > plane.noise for plane in passed) <= 11


def test_other_payoffs_are_refused():
    for message, payoffs in [
        ("1 folds", np.zeros((1, 4, 4))),
        ("and 2 policies", np.zeros((4, 2, 2))),
        (r"shape \(4, 4\)", np.zeros((4, 4))),
        ("not antisymmetric", np.full((2, 3, 3), 0.1)),
        ("not a number from -0.5", np.full((2, 3, 3), np.nan)),
    ]:
        refused(message, headroom, payoffs)
