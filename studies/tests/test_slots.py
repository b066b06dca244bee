"""Headroom within a slot of the grid, on pools whose true payoffs are known."""

import numpy as np
import pytest

from studies.headroom.slots import slot_headroom

RACES = 400


def wheel(policies: int, size: float = 0.3) -> np.ndarray:
    """Payoffs of policies on a circle: each beats those up to half a turn behind it."""
    angle = 2.0 * np.pi * np.arange(policies) / policies
    return size * np.sin(angle[:, None] - angle[None, :])


def true_headroom(payoffs: np.ndarray) -> float:
    return float(payoffs.max(axis=0).mean() - payoffs.mean(axis=1).max())


def in_slots(front: np.ndarray, seed: int, races: int = RACES, folds: int = 16) -> np.ndarray:
    """Payoffs of both slots as races show them, from the true ones of the policy in front, shape
    (N, N).
    """
    rng = np.random.default_rng(seed)
    won = rng.binomial(races, 0.5 + front, size=(folds, *front.shape)) / races - 0.5
    return np.stack([won, -won.transpose(0, 2, 1)], axis=1)


def test_within_a_slot_no_headroom_is_left_of_policies_that_are_only_good_in_a_slot():
    """Even ones win 0.2 more in front, odd ones 0.2 more behind: it pays to know the slot, not the
    opponent.
    """
    ahead, behind = np.where(np.arange(8) % 2, 0.0, 0.2), np.where(np.arange(8) % 2, 0.2, 0.0)
    front = ahead[:, None] - behind[None, :]
    estimates = [slot_headroom(in_slots(front, seed)) for seed in range(10)]
    assert abs(np.mean([estimate.value for estimate in estimates])) < 0.005
    assert np.mean([estimate.slot_alone for estimate in estimates]) == pytest.approx(0.1, abs=0.01)


def test_headroom_within_slots_is_what_the_true_payoffs_say():
    """A wheel for those in front, on top of what the place is worth; behind, each reply is another
    one.
    """
    front = wheel(9, 0.2) + 0.25
    truth = np.mean([true_headroom(front), true_headroom(-front.T)])
    estimates = [slot_headroom(in_slots(front, seed)) for seed in range(10)]
    error = np.mean([estimate.opponents_error for estimate in estimates])
    assert np.mean([estimate.value for estimate in estimates]) == pytest.approx(
        truth, abs=max(error, 0.01)
    )
    assert all(estimate.low <= estimate.value + 1e-12 for estimate in estimates)
    assert np.mean([np.mean(e.slots) for e in estimates]) == pytest.approx(
        np.mean([e.value for e in estimates])
    )
