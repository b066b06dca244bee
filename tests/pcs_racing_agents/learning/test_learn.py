"""Agents that ``train`` trains, in games of two moves: responses, response oracles, self-play."""

import numpy as np
import pytest
from long_jobs import files
from refusal import refused

from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning.psro import learn_psro, load_psro_settings
from pcs_racing_agents.learning.responses import learn_response, load_response_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings

pytest.importorskip("torch", reason="torch is not installed")


def test_psro_plays_an_equilibrium_of_its_responses(lesson, learner, tmp_path):
    settings = load_psro_settings(rounds=3, races=20, learner=learner)
    with open_job(tmp_path / "one", "psro", {}) as job:
        networks = learn_psro(*lesson, settings, job)
    assert 1 <= len(networks.networks) <= 3
    assert networks.weights.sum() == pytest.approx(1.0)
    assert len({network.name for network in networks.networks}) == len(networks.networks)


def test_shares_divide_the_games(lesson, learner, tmp_path):
    settings = load_response_settings(learner)
    with open_job(tmp_path / "shares", "response", {}) as job:
        network = learn_response(*lesson, settings, job, shares=[3, 1])
        # At each of two steps; races that were over before give no row.
        assert settings.starts < network.training["rows"] <= 2 * settings.starts
        for shares in ([1.0], [0, 0], [1, -1], [1, np.nan]):
            refused("shares", learn_response, *lesson, settings, job, shares=shares)


GAME = ["--track", "Tarnfjord", "--duration", "2.5"]


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("response", "starts: 24\nrounds: 1\nmembers: 1\nhidden: [8]\nepochs: 4\n"),
        ("psro", "rounds: 2\nraces: 4\nlearner: {learner}\n"),
        ("self-play", "iterations: 2\nstarts: 8\nhidden: [8]\nepochs: 2\n"),
    ],
)
def test_the_command_learns_an_agent_that_races_and_again_after_a_stop(
    method, settings, learner, tmp_path, printed
):
    config = tmp_path / "settings.yaml"
    config.write_text(settings.format(learner=learner), encoding="utf-8")
    out = tmp_path / method
    command = ["train", method, *GAME, "--config", config, "--out", out]
    (last,) = [line for line in printed(*command).splitlines() if line.startswith("written: ")]
    agent = last.rpartition("race it as ")[2]
    printed("tournament", *GAME, "--agents", agent, "never-switch", "--races", 2)
    learned = files(out)
    for file in sorted((out / "chunks").glob("*.npz"))[::2]:
        file.unlink()
    printed(*command)
    assert files(out) == learned


def test_impossible_settings_are_refused():
    for load, change, message in [
        (load_response_settings, {"worth": "fame"}, "worth is 'fame'"),
        (load_response_settings, {"members": 0}, "members is 0"),
        (load_psro_settings, {"learner": "nobody"}, "'nobody' are unknown"),
        (load_psro_settings, {"rounds": 1}, "rounds is 1"),
        (load_self_play_settings, {"iterations": 0}, "iterations is 0"),
        (load_self_play_settings, {"weights": "square"}, "weights is 'square'"),
    ]:
        refused(message, load, **change)
