"""Lead plans: what they drive, and their value on payoffs that are known."""

import numpy as np
import pytest

from pcs_racing import load_race_config, parse_policy
from pcs_racing_agents.policies.policy_pool import PolicyPool, pool_payoffs
from studies.headroom.lead_plans import lead_plan_payoffs, lead_plan_value, make_lead_plans

POLICIES = tuple(parse_policy(f"lattice:early,pace={pace}") for pace in (0.1, 0.5, 1.0))


QUIET = load_race_config("contest", duration=6.0, steering_noise=0.0)
POOL = PolicyPool(POLICIES, tracks=("Tarnfjord",), config=QUIET, races=8, folds=4, seed=3)


def known(values: np.ndarray, races: int, seed: int = 0) -> np.ndarray:
    """Payoffs as races show them, from true ones of shape (L, N), in 16 folds."""
    rng = np.random.default_rng(seed)
    return rng.binomial(races, 0.5 + values, size=(16, *values.shape)) / races - 0.5


def test_plans_are_all_fixed_policies_and_the_pairs_of_the_members():
    assert make_lead_plans(3, [0, 2]) == [(0, 0), (1, 1), (2, 2), (0, 2), (2, 0)]


@pytest.fixture(scope="module")
def payoffs():
    return lead_plan_payoffs(POOL, make_lead_plans(3, [0, 2]), step_seconds=2.0)


def test_a_plan_of_one_policy_is_this_policy(payoffs):
    """Without noise a policy drives the same race in steps as in one piece."""
    assert payoffs.shape == (1, 4, 5, 3)
    np.testing.assert_array_equal(payoffs[:, :, :3], pool_payoffs(POOL))


def test_who_is_slow_ahead_and_fast_behind_gets_the_lead_back(payoffs):
    """Against the slow policy; the plan that is slow behind never passes."""
    mean = payoffs.mean(axis=(0, 1))
    assert mean[3, 0] > mean[4, 0]


def test_the_value_of_a_plan_that_is_better_by_a_tenth():
    """Twenty useless plans beside it would look better by chance, were the best not judged on other
    races.
    """
    plans = make_lead_plans(4, [0, 1, 2])
    values = np.zeros((len(plans), 6))
    found = [lead_plan_value(known(values, 40, seed), plans).value for seed in range(20)]
    assert abs(np.mean(found)) < 0.005
    values[7] = 0.1
    result = lead_plan_value(known(values, 40), plans)
    assert result.value == pytest.approx(0.1, abs=0.02)
    assert result.best == plans[7]
    assert result.headroom < 0.01
