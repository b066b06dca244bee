"""Self-play between unequal cars: in each race one car is slower, and in half of them it does not
see the other.
"""

import numpy as np
import pytest
from refusal import refused

pytest.importorskip("stable_baselines3")

from pcs_racing.envs.sb3 import make_sb3_vec_env
from pcs_racing_agents.learning.ppo.unequal_cars import UnequalCars


def races(count, **arguments):
    return make_sb3_vec_env(
        "drive-self-play", 2 * count, track="Pipkin", time_step=0.1, **arguments
    )


def test_one_car_of_each_race_is_slower_by_a_possible_share_and_half_of_those_are_blind():
    envs = UnequalCars(races(200), slowest=0.5, seed=1)
    seen = envs.reset()
    speed, blind = envs.speed.reshape(-1, 2), envs.blind.reshape(-1, 2)
    assert (speed.max(axis=1) == 1.0).all()
    assert ((speed.min(axis=1) >= 0.5) & (speed.min(axis=1) < 1.0)).all()
    assert (blind <= (speed < 1.0)).all()
    assert 70 < blind.sum() < 130
    np.testing.assert_array_equal((seen[:, envs.about_opponent] == 0.0).all(axis=1), envs.blind)
    for slowest in [0.0, 1.5, "half"]:
        refused("slowest", UnequalCars, races(1), slowest=slowest)


def test_the_slower_car_gets_its_share_of_the_speed_and_may_be_another_in_the_next_race():
    envs = UnequalCars(races(2), seed=1)
    envs.reset()
    envs.step_async(np.tile([0.2, 3.0], (4, 1)))
    np.testing.assert_allclose(envs.venv._actions[:, 0], 0.2)
    np.testing.assert_allclose((1.0 + envs.venv._actions[:, 1]) / 2.0, envs.speed)
    envs.step_async(np.tile([0.0, -1.0], (4, 1)))
    np.testing.assert_allclose(envs.venv._actions[:, 1], -1.0)
    envs = UnequalCars(races(8, duration=0.2), seed=1)
    envs.reset()
    first = envs.speed.copy()
    for _ in range(2):
        _, _, done, infos = envs.step(np.zeros((16, 2)))
    assert done.all()
    assert (envs.speed.reshape(-1, 2) != first.reshape(-1, 2)).any(axis=1).all()
    assert np.isfinite([info["terminal_observation"] for info in infos]).all()
