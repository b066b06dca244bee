"""Evaluations and training environments: the learner races as the planner that it becomes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from random_layers import random_layers

from pcs_racing import load_race_config, load_track, parse_policy, run_races
from pcs_racing.envs.duel import DuelEnv
from pcs_racing.planners.network import INPUTS, network_planner
from pcs_racing.planners.trained import trained_planner
from pcs_racing.race.races import advance
from pcs_racing.race.state import take
from pcs_racing_agents.learning.ppo.drives import LearnerEnv
from pcs_racing_agents.learning.ppo.duels import planner_groups
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
    evaluation_curves,
    mean_score,
    score_races,
    score_table,
)
from pcs_racing_agents.learning.ppo.learner import (
    actor_layers,
    group_seeds,
    make_model,
    own_randomness,
)
from pcs_racing_agents.learning.ppo.train import make_task


@pytest.fixture(scope="module")
def track():
    return load_track("Pipkin")


def drives(track, races=6, hold=2, **changes):
    return LearnerEnv(
        races,
        track=track,
        race=load_race_config("contest", duration=2.0),
        opponent=[parse_policy("lattice:pace=0"), parse_policy("lattice")],
        time_step=0.01 * hold,
        autoreset_mode="SameStep",
        **changes,
    )


@pytest.mark.parametrize("hold", [2, 4, 10])
def test_the_policy_of_stable_baselines_drives_as_the_compiled_planner(track, drive_settings, hold):
    """The same races, once driven by SB3's predict step by step, once by the planner in the
    compiled loop.
    """
    settings = replace(drive_settings, hold=hold, noise=0.1)
    with own_randomness():
        model = make_model(settings, [drives(track, hold=hold)], 5, "tanh")
    envs = model.env.groups[0]
    seen, _ = envs.reset(seed=5)
    batch = envs.batch
    seeds, rivals = batch.state.seed.copy(), batch.theta[:, 1].copy()
    grid = batch.circuit(0).grid
    places = [
        int(np.flatnonzero((grid.cars == car).all(axis=(1, 2)))[0]) for car in batch.state.cars
    ]
    weights = actor_layers(model)
    for planner, theta in (
        (network_planner("learner", (8,), hold=hold), weights.flat()),
        (trained_planner("driver", weights, hold), np.zeros(0)),
    ):
        setup = replace(batch.setup, planners=(planner, *batch.setup.planners), steered=0)
        state = take(grid, places)._replace(
            seed=seeds.copy(), memory=np.zeros((6, 2, setup.memory_size))
        )
        both = np.zeros((6, 2, setup.theta_size))
        both[:, 0, : len(theta)] = theta
        both[:, 1, : rivals.shape[1]] = rivals
        seen, _ = envs.reset(seed=5)
        for _ in range(100 // hold):
            seen, _, terminated, truncated, _ = envs.step(
                model.predict(seen, deterministic=True)[0]
            )
            advance(setup, state, both, hold)
            running = ~(terminated | truncated | state.crashed)
            np.testing.assert_allclose(batch.state.cars[running], state.cars[running], atol=2e-4)
            np.testing.assert_array_equal(terminated, state.crashed)
            if not running.all():
                break
        assert running.sum() >= 4
        assert state.tick.max() >= 20


def test_slow_opponents_are_only_met_in_learning_and_judging_is_racing_under_the_rules(
    drive_settings,
):
    level = make_task(replace(drive_settings, races=("contest",)))
    (track,), (rules,) = level.tracks, level.rules
    learning = level.learning_rules(track, rules)
    assert learning.duration == 1.0
    assert learning.speed_range == (0.3, track.calibration["contest"].speed_range[1])
    assert (
        make_task(replace(drive_settings, slowest=0.0)).learning_rules(track, rules).speed_range
        is None
    )
    level = make_task(replace(drive_settings, evaluation_races=11))
    layers = random_layers(len(INPUTS), 8, 2)
    scores, (rules,) = level.evaluate(layers), level.rules
    policy = network_planner("learner", (8,), hold=4).policy(layers.flat(), name="learner")
    rivals = [parse_policy(name) for name in drive_settings.opponents for _ in range(4)]
    raced = run_races(track, policy, rivals, rules, seed=1_000_003)
    for k, name in enumerate(drive_settings.opponents):
        rows = slice(4 * k, 4 * k + 4)
        won, lost, blamed = (
            raced.winner[rows] == 0,
            raced.winner[rows] == 1,
            raced.own_crash[rows, 0],
        )
        race = SimpleNamespace(
            crashed=raced.state.crashed[rows],
            fault=raced.state.fault[rows],
            lead=raced.state.lead[rows],
        )
        expected = score_races(won - 1.0 * (lost | blamed), raced.winner[rows], race)
        assert scores[Matchup("Pipkin", "short", name)] == expected
    assert len(scores) == 2
    assert make_task(drive_settings).evaluate(layers).keys() == scores.keys()


def test_scores_and_their_means_are_those_of_the_races():
    """By hand: four races of one matchup; two matchups, of which the second counts three times."""
    race = SimpleNamespace(
        crashed=np.array([True, False, True, False]),
        lead=np.array([1.0, -2.0, 3.0, 6.0]),
        fault=np.array([[1, 0], [0, 0], [0, 1], [0, 0]]),
    )
    winner = np.array([-1, 1, 0, 0], np.int8)
    one = score_races(np.array([-1.0, -1.0, 1.0, 2.0]), winner, race)
    assert one == (4, 0.25, pytest.approx(0.75), 0.5, 0.25, 0.5, 0.25, 2.0)
    alone = SimpleNamespace(crashed=race.crashed[:1], lead=race.lead[:1], fault=race.fault[:1])
    assert np.isnan(score_races(np.ones(1), winner[:1], alone).error)
    other = MatchupScore(10, 0.65, 0.5, 0.9, 0.05, 0.1, 0.05, -2.0)
    scores = {Matchup("A", "short", "x"): one, Matchup("B", "short", "y"): other}
    weights = {"x": 1, "y": 3}
    mean = mean_score(scores, weights)
    error = np.hypot(0.25 * 0.75, 0.75 * 0.5)
    assert mean == (14, *map(pytest.approx, (0.55, error, 0.8, 0.1, 0.2, 0.1, -1.0)))
    assert score_table(scores, weights).splitlines() == [
        "         payoff     +-    won   lost  crashed  at fault    lead",
        "A short   0.250  0.750  50.0%  25.0%    50.0%     25.0%   2.0 m",
        "B short   0.650  0.500  90.0%   5.0%    10.0%      5.0%  -2.0 m",
        "all       0.550  0.419  80.0%  10.0%    20.0%     10.0%  -1.0 m",
    ]
    curves = [EvaluationCurve(seed, (0, 500_000), (scores, {**scores})) for seed in (3, 4)]
    panels = evaluation_curves(curves, weights)
    values = [mean.worth, mean.won, mean.fault]
    assert list(panels) == ["payoff of a race", "races won", "crashes by own fault"]
    for lines, value in zip(panels.values(), values, strict=True):
        assert [line.label for line in lines] == ["seed 3", "seed 4"]
        assert (lines[1].x.tolist(), lines[1].y.tolist()) == ([0.0, 0.5], [value] * 2)
    assert panels["payoff of a race"][0].error.tolist() == [mean.error] * 2


def test_learners_race_in_groups_of_a_circuit_and_rules(drive_settings):
    opponents = {"lattice:pace=0": 1, "pure-pursuit": 1, "lattice": 2}
    tracks = ("Pipkin", "Tarnfjord")
    task = make_task(
        replace(drive_settings, opponents=opponents, tracks=tracks, rivalry=0.3, crash_penalty=7.0)
    )
    groups = task.env_groups()
    assert [(env.num_envs, env.batch.track.name) for env in groups] == [
        (8, "Pipkin"),
        (8, "Tarnfjord"),
    ]
    first = groups[0].batch
    assert {one.name: one.weight for one in first.opponents} == opponents
    options = first.options
    assert (options.time_step, options.rivalry, options.crash_penalty) == (0.04, 0.3, 7.0)
    rules = task.learning_rules(task.tracks[0], task.rules[0])
    assert replace(first.setup.config, start_lines=rules.start_lines) == rules
    assert groups[0].metadata["autoreset_mode"].value == "SameStep"
    assert groups[0].single_action_space.high.tolist() == [10.0] * 2
    assert groups[0].single_observation_space.shape == (len(INPUTS),)
    assert task.identity == {
        "tracks_sha256": {track.name: track.content_hash for track in task.tracks}
    }


def test_duels_are_played_as_in_the_environment(duel_settings):
    """Each game of an evaluation again, in an environment of one."""
    task = make_task(replace(duel_settings, evaluation_races=9, envs=8))
    groups = task.env_groups()
    assert [env.num_envs for env in groups] == [6, 2]
    layers = random_layers(31, 8, 4, seed=3)
    scores, network = task.evaluate(layers), task.network(layers, "net")
    assert list(scores) == [Matchup("Pipkin", "paper", name) for name in duel_settings.opponents]
    for (matchup, score), seed in zip(scores.items(), group_seeds(0, 3, 1), strict=True):
        payoffs = []
        for game in range(3):
            env = DuelEnv(
                track="Pipkin",
                archive=task.archive,
                race=task.game.config,
                opponent=matchup.opponent,
            )
            seen, _ = env.reset(seed=seed + game)
            over = False
            while not over:
                seen, reward, ended, late, _ = env.step(int(network.choose(seen[None])[0]))
                over = ended or late
            payoffs.append(reward)
        assert (score.races, score.worth) == (3, pytest.approx(np.mean(payoffs)))
        assert score.error == pytest.approx(np.std(payoffs, ddof=1) / np.sqrt(3.0))
    assert task.default_name == "default-paper-ppo"
    tracks = {"tracks_sha256": {"Pipkin": task.tracks[0].content_hash}}
    assert task.identity == {"archive_sha256": task.archive.content_hash, **tracks}


def test_a_model_has_the_numbers_of_its_settings(track, drive_settings):
    changes = {
        "batch_size": 50,
        "epochs": 3,
        "discount": 0.9,
        "gae_lambda": 0.8,
        "entropy": 0.01,
        "learning_rate": 0.002,
        "noise": 0.3,
        "value_hidden": (5, 6),
    }
    settings = replace(drive_settings, **changes)
    with own_randomness():
        model = make_model(settings, [drives(track, races=8)], 5, "tanh")
    found = [
        model.n_steps,
        model.batch_size,
        model.n_epochs,
        model.seed,
        model.gamma,
        model.gae_lambda,
        model.ent_coef,
        model.learning_rate,
        model.env._scale,
    ]
    # Four batches of 40, none of 10.
    assert found == [20, 40, 3, 5, 0.9, 0.8, 0.01, 0.002, 0.1]
    np.testing.assert_allclose(model.policy.log_std.detach().numpy(), np.log([0.3, 0.3]), rtol=1e-6)
    kinds = [
        str(layer)
        for net in (model.policy.mlp_extractor.policy_net, model.policy.mlp_extractor.value_net)
        for layer in net
    ]
    assert [kind.split("(")[0] for kind in kinds] == ["Linear", "Tanh"] * 3
    assert [kind.split("out_features=")[1][0] for kind in kinds[::2]] == ["8", "5", "6"]


def test_environments_are_shared_out():
    planners = {"a": "x", "b": "y", "c": "x"}
    groups = planner_groups(10, {"a": 2, "b": 1, "c": 1}, planners)
    assert groups == [(8, [(2, "a"), (1, "c")]), (2, [(1, "b")])]
    assert [share for share, _ in planner_groups(1, {"a": 1, "b": 5}, planners)] == [1, 1]
    seeds = group_seeds(1, 5, 0) + group_seeds(1, 5, 1) + group_seeds(2, 5, 0)
    assert len(set(seeds)) == 15
    assert max(group_seeds(1, 500, 0)) < 2**62  # one may be added a million times
