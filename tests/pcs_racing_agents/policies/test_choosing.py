"""Pools chosen for headroom, from payoffs that are known exactly and from a few races."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing_agents.policies.choosing import choose_pool, denoised, pool_headroom

POLICIES, FOLDS = 24, 8


def speeds_and_strengths(seed: int) -> np.ndarray:
    """True payoffs, shape (24, 24): a wheel on which half of the policies lie, all of different
    strength.
    """
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(POLICIES) / POLICIES
    radius = np.tile([0.5, 0.0], POLICIES // 2)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    strength = rng.uniform(-0.1, 0.1, POLICIES)
    return np.outer(x, y) - np.outer(y, x) + strength[:, None] - strength[None, :]


def played(truth: np.ndarray, seed: int, races: int) -> np.ndarray:
    """Payoffs as races show them, shape (8, 24, 24)."""
    rng = np.random.default_rng(seed)
    won = np.triu(rng.binomial(races, 0.5 + truth, size=(FOLDS, *truth.shape)) / races - 0.5, 1)
    return won - won.transpose(0, 2, 1)


GROUPS = np.array_split(np.arange(POLICIES), 4)


def test_without_noise_most_errors_are_gone_and_ratings_are_left():
    truth = speeds_and_strengths(0)
    raw = played(truth, 1, 2)
    assert (
        np.square(denoised(raw) - truth).mean() < 0.4 * np.square(raw.mean(axis=0) - truth).mean()
    )
    strength = np.linspace(-0.2, 0.2, POLICIES)
    matrices = [denoised(played(strength[:, None] - strength[None], seed, 2)) for seed in range(10)]
    cyclic = [
        matrix - matrix.mean(axis=1)[:, None] + matrix.mean(axis=1)[None] for matrix in matrices
    ]
    assert sum(np.abs(part).max() < 1e-9 for part in cyclic) >= 7


def test_the_pool_that_is_chosen_in_noise_really_has_headroom():
    """Eight races of each pair on two circuits; what counts is the true headroom of what was
    chosen.
    """
    truths = [speeds_and_strengths(0), speeds_and_strengths(1)]
    expected = np.array([denoised(played(truth, seed, 1)) for seed, truth in enumerate(truths)])
    raw = np.array([played(truth, seed, 1).mean(axis=0) for seed, truth in enumerate(truths)])
    everybody = pool_headroom(np.array(truths), np.arange(POLICIES)[None]).mean()
    pools = (choose_pool(payoffs, GROUPS, 8) for payoffs in (expected, raw))
    chosen, from_noise = (pool_headroom(np.array(truths), pool[None]).mean() for pool in pools)
    assert chosen > everybody + 0.03
    assert chosen > from_noise


def test_no_exchange_improves_the_pool_whose_headroom_is_what_its_payoffs_say():
    truth = speeds_and_strengths(3)[None]
    pool = choose_pool(truth, GROUPS, 8)
    best = pool_headroom(truth, pool[None])[0, 0]
    for k, policy in enumerate(pool):
        for other in np.setdiff1d(GROUPS[policy // 6], pool):
            exchanged = pool.copy()
            exchanged[k] = other
            assert pool_headroom(truth, exchanged[None])[0, 0] <= best + 1e-12
    truth = speeds_and_strengths(0)
    part = truth[np.ix_([0, 8, 16], [0, 8, 16])]
    expected = part.max(axis=0).mean() - part.mean(axis=1).max()
    np.testing.assert_allclose(pool_headroom(truth[None], np.array([[0, 8, 16]])), [[expected]])
    refused(
        "group 1 holds 1 policies",
        choose_pool,
        np.zeros((1, 6, 6)),
        [np.arange(5), np.array([5])],
        4,
    )


@pytest.mark.parametrize(
    ("count", "taken"), [(8, [2, 2, 2, 2]), (6, [2, 1, 2, 1]), (12, [3, 3, 3, 3])]
)
def test_every_group_gives_its_share(count, taken):
    pool = choose_pool(speeds_and_strengths(0)[None], GROUPS, count, starts=1)
    assert [np.isin(group, pool).sum() for group in GROUPS] == taken
    assert len(set(pool.tolist())) == count
