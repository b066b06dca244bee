"""Commands on their way to the car: delays, and noise of the speed."""

import numpy as np
import pytest

from pcs_racing.base.seeds import normal_noise
from pcs_racing.car.vehicle import V, VehicleParams
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.models import model_policy
from pcs_racing.race.steering import disturbed_speed

TOP = 8.0  # m/s, of the actions


def in_force(env, asked, seed=0):
    """Steering angles and speeds that a car follows after each of some commands, and its speeds."""
    env.reset(seed=seed)
    commands, speeds = [], []
    for steer, speed in asked:
        speeds.append(env.batch.state.cars[0, 0, V])
        env.step([steer / 0.4189, 2.0 * speed / TOP - 1.0])
        commands.append(env.batch.state.command[0, 0].copy())
    return np.array(commands), np.array(speeds)


@pytest.mark.parametrize("delays", [(0.0, 0.04), (0.06, 0.04), (0.02, 0.1)])
def test_speed_and_steering_are_late_by_their_own_delays(oval, delays):
    """Until the first command arrives, the car steers straight and keeps its speed."""
    asked = np.random.default_rng(1).uniform([-0.3, 1.0], [0.3, 6.0], (20, 2))
    late = {"steer_delay": delays[0], "speed_delay": delays[1]}
    env = DriveEnv(track=oval, opponent=None, vehicle=late, time_step=0.02, top_speed=TOP)
    commands, speeds = in_force(env, asked)
    steer, speed = (round(delay / 0.02) for delay in delays)
    np.testing.assert_allclose(commands[steer:, 0], asked[: 20 - steer, 0], atol=1e-6)
    assert not commands[:steer, 0].any()
    np.testing.assert_allclose(commands[speed:, 1], asked[: 20 - speed, 1], atol=1e-6)
    np.testing.assert_allclose(commands[:speed, 1], speeds[:speed])
    np.testing.assert_allclose(speeds[: speed + 1], speeds[0])


def test_a_late_command_waits_for_its_period_when_actions_come_more_often(oval):
    asked = np.random.default_rng(2).uniform([-0.3, 1.0], [0.3, 6.0], (20, 2))
    late = {"speed_delay": 0.04}
    env = DriveEnv(track=oval, opponent=None, vehicle=late, time_step=0.01, top_speed=TOP)
    commands, _ = in_force(env, asked)
    np.testing.assert_allclose(commands[4::2, 1], asked[0:-4:2, 1], atol=1e-6)
    np.testing.assert_array_equal(commands[5::2, 1], commands[4:-1:2, 1])
    np.testing.assert_allclose(commands[:, 0], asked[:, 0], atol=1e-6)  # prompt


def test_the_noise_of_the_speed_is_drawn_for_each_command_and_car(oval):
    asked = np.tile([0.0, 1.0], (300, 1))
    env = DriveEnv(
        track=oval,
        opponent=None,
        vehicle={"speed_noise": 0.3},
        time_step=0.01,
        top_speed=TOP,
        rules="contest",
    )
    commands, _ = in_force(env, asked)
    noise = commands[:, 1] - 1.0
    np.testing.assert_allclose(noise[0::2], noise[1::2], atol=1e-12)
    assert noise.std() == pytest.approx(0.3, rel=0.15)
    assert abs(np.corrcoef(noise[0:-2:2], noise[2::2])[0, 1]) < 0.2
    assert abs(np.corrcoef(noise[0::2], commands[0::2, 0])[0, 1]) < 0.2  # of the steering
    again, _ = in_force(env, asked)
    np.testing.assert_array_equal(again, commands)
    row, seed = VehicleParams(speed_noise=0.3).as_row(), np.uint64(9)
    drawn = [disturbed_speed(4.0, row, seed, car, tick) for car in (0, 1) for tick in range(4)]
    assert drawn[0::2] == drawn[1::2]
    assert len(set(drawn)) == 4
    assert drawn[0] != 4.0 + 0.3 * normal_noise(seed, 0, 0)
    assert disturbed_speed(4.0, VehicleParams().as_row(), seed, 0, 0) == 4.0


def test_a_model_that_decides_between_two_commands_keeps_the_noise_of_the_last_one(oval):
    steady = model_policy(lambda seen: 0.0 * seen[:, :2] - 0.8, name="steady", time_step=0.05)
    env = DriveEnv(track=oval, opponent=steady, vehicle=[{}, {"speed_noise": 0.3}], time_step=0.01)
    env.reset(seed=4)
    state, row = env.batch.state, env.batch.randomization.vehicles[0, 1]
    for tick in range(12):
        env.step([0.0, -0.8])
        speed = disturbed_speed(state.memory[0, 1, 1], row, state.seed[0], 1, tick)
        assert state.command[0, 1, 1] == speed
        assert state.command[0, 1, 1] != state.memory[0, 1, 1]
