"""Driving in the learner's races is driving as the planner that comes of it."""

from dataclasses import replace

import numpy as np
import pytest
from random_layers import random_layers

from pcs_racing import advance, load_race_config, load_track, parse_policy
from pcs_racing.planners.network import INPUTS, network_planner
from pcs_racing.planners.trained import trained_planner
from pcs_racing.race.state import take
from pcs_racing_agents.learning.ppo.drives import LearnerEnv
from pcs_racing_agents.learning.ppo.evaluation import mean_score
from pcs_racing_agents.learning.ppo.learner import actor_layers, group_seeds, make_model, own_randomness, split_envs
from pcs_racing_agents.learning.ppo.train import make_task


@pytest.fixture(scope="module")
def track():
    return load_track("Pipkin")


def drives(track, races=6, hold=2, **changes):
    return LearnerEnv(
        races, track=track, race=load_race_config("contest", duration=2.0),
        opponent=[parse_policy("lattice:pace=0"), parse_policy("lattice")], time_step=0.01 * hold,
        autoreset_mode="SameStep", **changes,
    )  # fmt: skip


@pytest.mark.parametrize("hold", [2, 4, 10])
def test_the_policy_of_stable_baselines_drives_as_the_compiled_planner(track, drive_settings, hold):
    """The same races, once driven by SB3's predict step by step, once by the planner in the compiled loop."""
    settings = replace(drive_settings, hold=hold, noise=0.1)
    with own_randomness():
        model = make_model(settings, [drives(track, hold=hold)], 5, "tanh")
    envs = model.env.groups[0]
    seen, _ = envs.reset(seed=5)
    batch = envs.batch
    seeds, rivals = batch.state.seed.copy(), batch.theta[:, 1].copy()
    grid = batch.circuit(0).grid
    places = [int(np.flatnonzero((grid.cars == car).all(axis=(1, 2)))[0]) for car in batch.state.cars]
    weights = actor_layers(model)
    for planner, theta in (
        (network_planner("learner", (8,), hold=hold), weights.flat()),
        (trained_planner("driver", weights, hold), np.zeros(0)),
    ):
        setup = replace(batch.setup, planners=(planner, batch.setup.planners[1]))
        state = take(grid, places)._replace(seed=seeds.copy(), memory=np.zeros((6, 2, setup.memory_size)))
        both = np.zeros((6, 2, setup.theta_size))
        both[:, 0, : len(theta)] = theta
        both[:, 1, : rivals.shape[1]] = rivals
        seen, _ = envs.reset(seed=5)
        for _ in range(100 // hold):
            seen, _, terminated, truncated, _ = envs.step(model.predict(seen, deterministic=True)[0])
            advance(setup, state, both, hold)
            running = ~(terminated | truncated | state.crashed)
            np.testing.assert_allclose(batch.state.cars[running], state.cars[running], atol=2e-4)
            np.testing.assert_array_equal(terminated, state.crashed)
            if not running.all():
                break
        assert running.sum() >= 4
        assert state.tick.max() >= 20


def test_rewards_are_progress_less_a_share_of_the_opponents(track):
    envs = drives(track, hold=10, rivalry=0.5, leading=3.0, crash_penalty=7.0)
    envs.reset(seed=4)
    actions = np.tile(np.array([0.0, 0.5], np.float32), (6, 1))
    crashes = 0
    for _ in range(25):
        before, tick = envs.batch.state.progress.copy(), envs.batch.state.tick.copy()
        _, rewards, terminated, truncated, _ = envs.step(actions)
        running = ~(terminated | truncated)
        driven = envs.batch.state.progress - before
        expected = driven @ [1.0, -0.5] + 0.3 * (envs.batch.state.lead > 0.0)
        np.testing.assert_allclose(rewards[running], expected[running], atol=1e-12)
        crashes += int(terminated.sum())
        assert (rewards[terminated] < -4.0).all()  # straight on into a wall: by own fault
        assert (envs.batch.state.tick[~running] == 0).all()
        assert (envs.batch.state.tick[running] == tick[running] + 10).all()
    assert crashes > 0


def test_slow_opponents_are_only_met_in_learning_and_judging_is_racing_under_the_rules(drive_settings):
    level = make_task(replace(drive_settings, races=("contest",)))
    (track,), (rules,) = level.tracks, level.rules
    learning = level.learning_rules(track, rules)
    assert learning.duration == 1.0
    assert learning.speed_range == (0.3, track.calibration["contest"].speed_range[1])
    assert make_task(replace(drive_settings, slowest=0.0)).learning_rules(track, rules).speed_range is None
    level = make_task(drive_settings)
    layers = random_layers(len(INPUTS), 8, 2)
    scores = level.evaluate(layers)
    assert scores == level.evaluate(layers)
    assert {cell.opponent for cell in scores} == set(drive_settings.opponents)
    assert {cell.race for cell in scores} == {"short"}
    mean = mean_score(scores, drive_settings.opponents)
    assert mean.races == 4
    assert mean.worth == pytest.approx(mean.won - max(mean.lost, mean.fault), abs=0.51)


def test_environments_are_shared_out():
    assert split_envs(10, [3, 1]) == [8, 2]
    assert split_envs(1, [1, 1, 5]) == [1, 1, 1]
    assert sum(split_envs(64, [11, 4])) == 64
    seeds = group_seeds(1, 5, 0) + group_seeds(1, 5, 1) + group_seeds(2, 5, 0)
    assert len(set(seeds)) == 15
