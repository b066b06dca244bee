"""Rewards of a step of driving, against numbers by hand."""

import pytest

from pcs_racing.envs.drive_kernel import step_reward


def test_a_step_pays_progress_less_the_opponents_share():
    plain = getattr(step_reward, "py_func", step_reward)
    weights = (2.0, 0.5, 7.0)
    assert plain(1.0, 0.4, 0, weights) == pytest.approx(2.0 * (1.0 - 0.2))
    assert plain(1.0, 0.4, 1, weights) == pytest.approx(2.0 * (1.0 - 0.2) - 7.0)
