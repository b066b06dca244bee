"""Evaluations, training environments and the model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from random_layers import random_layers

from pcs_racing.envs.duel import DuelEnv
from pcs_racing_agents.learning.ppo.duels import make_duel_task, planner_groups
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
    evaluation_curves,
    mean_score,
    score_races,
    score_table,
)
from pcs_racing_agents.learning.ppo.learner import group_seeds, make_model, own_randomness


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


def test_duels_are_played_as_in_the_environment(duel_settings):
    """Each game of an evaluation again, in an environment of one."""
    task = make_duel_task(replace(duel_settings, evaluation_races=9, envs=8), None, None, 1)
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
                rules=task.game.config,
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


def test_a_model_has_the_numbers_of_its_settings(duel_settings):
    changes = {
        "batch_size": 50,
        "epochs": 3,
        "discount": 0.9,
        "gae_lambda": 0.8,
        "entropy": 0.01,
        "learning_rate": 0.002,
        "value_hidden": (5, 6),
    }
    settings = replace(duel_settings, rollout=20, envs=8, **changes)
    task = make_duel_task(settings, None, None, 1)
    with own_randomness():
        model = make_model(settings, task.env_groups(), 5, "relu")
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
    kinds = [
        str(layer)
        for net in (model.policy.mlp_extractor.policy_net, model.policy.mlp_extractor.value_net)
        for layer in net
    ]
    assert [kind.split("(")[0] for kind in kinds] == ["Linear", "ReLU"] * 3
    assert [kind.split("out_features=")[1][0] for kind in kinds[::2]] == ["8", "5", "6"]


def test_environments_are_shared_out():
    planners = {"a": "x", "b": "y", "c": "x"}
    groups = planner_groups(10, {"a": 2, "b": 1, "c": 1}, planners)
    assert groups == [(8, [(2, "a"), (1, "c")]), (2, [(1, "b")])]
    assert [share for share, _ in planner_groups(1, {"a": 1, "b": 5}, planners)] == [1, 1]
    seeds = group_seeds(1, 5, 0) + group_seeds(1, 5, 1) + group_seeds(2, 5, 0)
    assert len(set(seeds)) == 15
    assert max(group_seeds(1, 500, 0)) < 2**62  # one may be added a million times
