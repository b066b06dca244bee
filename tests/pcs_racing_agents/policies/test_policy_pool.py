"""Payoffs of a pool: every pair races on the same lines, from both sides, wherever the races are
driven.
"""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_archive, load_race_config, parse_policy
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.policies.policy_pool import (
    PolicyPool,
    pool_payoffs,
    slot_payoffs,
    spanning_policies,
)

SLOW, EQUAL, FAST = (parse_policy(f"lattice:pace={pace}") for pace in (0.2, 0.5, 1.0))


def pool(**changes) -> PolicyPool:
    given = {
        "policies": (SLOW, EQUAL, FAST),
        "tracks": ("Tarnfjord",),
        "config": load_race_config("paper", duration=6.0),
        "races": 8,
        "folds": 4,
        "seed": 3,
    }
    return PolicyPool(**given | changes)


@pytest.fixture(scope="module")
def payoffs():
    return slot_payoffs(pool())


def test_the_faster_policy_wins_and_of_two_equal_cars_the_one_in_front(payoffs):
    assert payoffs.shape == (1, 4, 2, 3, 3)
    # What the row wins in one slot the column loses in the other.
    np.testing.assert_array_equal(payoffs[:, :, 0], -payoffs[:, :, 1].transpose(0, 1, 3, 2))
    assert payoffs.mean(axis=(0, 1, 2))[2, 0] > 0.2
    # Staggered, without noise; also against itself, where either car may be the policy.
    rules = load_race_config("contest", duration=6.0, steering_noise=0.0)
    front, behind = slot_payoffs(pool(config=rules)).mean(axis=(0, 1))
    assert np.diag(front).mean() > 0.2
    np.testing.assert_array_equal(np.diag(front), -np.diag(behind))


def test_processes_and_blocks_of_pairs_make_no_difference(payoffs, processes, monkeypatch):
    monkeypatch.setattr("pcs_racing_agents.policies.policy_pool._RACES_AT_ONCE", 1)
    np.testing.assert_array_equal(slot_payoffs(pool(), executor=processes), payoffs)


def test_a_job_is_taken_up_where_it_was_left(payoffs, tmp_path, monkeypatch):
    for _ in range(2):
        with open_job(tmp_path, "headroom", {}) as job:
            np.testing.assert_array_equal(pool_payoffs(pool(), job=job), payoffs.mean(axis=2))
        # nothing is raced again
        monkeypatch.setattr("pcs_racing_agents.policies.policy_pool.advance", None)


def test_a_pool_spans_an_archive_and_races_that_cannot_be_divided_are_refused():
    archive = load_archive("contest")
    names, policies = spanning_policies(archive, 3)
    first = archive.coordinates[:, 0]
    assert [names[0], names[2]] == [
        f"contest {first.argmin()}",
        f"contest {first.argmax()}",
    ]
    assert len(policies) == 3
    for size in (2, len(archive) + 1):
        refused(f"size is {size}", spanning_policies, archive, size)
    for message, wrong in [
        ("holds 2 policies", {"policies": (SLOW, FAST)}),
        ("no tracks", {"tracks": ()}),
        ("races is 10", {"races": 10}),
        ("folds is 1", {"folds": 1}),
        ("races is 4", {"races": 4}),
    ]:
        refused(message, pool, **wrong)
