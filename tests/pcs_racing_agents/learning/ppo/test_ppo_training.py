"""Training as a value: the same again, whoever stopped it where."""

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pcs_racing import InputError, load_archive, load_track, make_game, save_archive
from pcs_racing.planners.trained import read_driver
from pcs_racing_agents.agents import make
from pcs_racing_agents.jobs.chunks import read_chunk
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.learning.ppo.evaluation import (
    evaluation_curves,
    mean_score,
    read_evaluations,
    write_evaluations,
)
from pcs_racing_agents.learning.ppo.train import train_ppo
from pcs_racing_agents.networks import load_network


@pytest.fixture(scope="module")
def settings(duel_settings, drive_settings):
    return {"duel": duel_settings, "drive": drive_settings}


@pytest.fixture(scope="module")
def trained(settings, tmp_path_factory):
    """Undisturbed trainings of both levels."""
    return {level: train_ppo(settings[level], tmp_path_factory.mktemp(level)) for level in settings}


class StopError(Exception):
    """Stands for a kill."""


def stop_after(updates):
    def progress(done, all_of_it, what):
        nonlocal updates
        updates -= 1
        if updates < 0:
            raise StopError

    return progress


def state_of(folder, seed=0):
    """The last checkpoint, without the clock."""
    arrays = read_chunk(folder / f"chunks/seed-{seed:05d}.npz")
    return {key: array for key, array in arrays.items() if key != "seconds"}


def assert_same_state(one, two):
    assert set(one) == set(two)
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=key)


@pytest.mark.parametrize("level", ["duel", "drive"])
def test_a_stopped_training_ends_as_an_undisturbed_one(level, settings, trained, tmp_path):
    """Stopped with a checkpoint after each update, and where the last checkpoint is older than the stop."""
    with pytest.raises(StopError):
        train_ppo(settings[level], tmp_path, progress=stop_after(2), checkpoint_seconds=0.0)
    with pytest.raises(StopError):
        train_ppo(settings[level], tmp_path, progress=stop_after(2), checkpoint_seconds=1e9)
    again = train_ppo(settings[level], tmp_path)
    assert_same_state(state_of(tmp_path), state_of(trained[level].folder.parent))
    for name in ("policy/curve.csv", "updates.csv", "policy/weights.safetensors"):
        assert (tmp_path / name).read_bytes() == (trained[level].folder.parent / name).read_bytes(), name
    assert again.steps == trained[level].steps


def test_a_finished_training_is_only_read(settings, trained, monkeypatch):
    from pcs_racing_agents.learning.ppo import seed_training

    monkeypatch.setattr(seed_training, "learn_once", None)
    again = train_ppo(settings["drive"], trained["drive"].folder.parent)
    assert again.curves == trained["drive"].curves


def test_a_damaged_checkpoint_is_made_again(settings, trained, tmp_path, caplog):
    with pytest.raises(StopError):
        train_ppo(settings["drive"], tmp_path, progress=stop_after(2), checkpoint_seconds=0.0)
    file = tmp_path / "chunks" / "seed-00000.npz"
    file.write_bytes(file.read_bytes()[:-300])
    with caplog.at_level(logging.WARNING):
        train_ppo(settings["drive"], tmp_path)
    assert "damaged" in caplog.text
    assert_same_state(state_of(tmp_path), state_of(trained["drive"].folder.parent))


def test_a_folder_belongs_to_its_settings(settings, trained):
    with pytest.raises(InputError, match=r"learning_rate is 0\.001, not 0\.002"):
        train_ppo(settings["duel"], trained["duel"].folder.parent, learning_rate=0.002)


def test_a_folder_belongs_to_its_archive(settings, tmp_path):
    """An archive that was exchanged for another under the same name is noticed."""
    own = save_archive(load_archive("default"), tmp_path / "mine")
    few = {"archive": str(own), "opponents": {"random-moves": 1}, "steps": 16}
    train_ppo(settings["duel"], tmp_path / "out", **few)
    save_archive(load_archive("contest"), own)
    with pytest.raises(InputError, match="archive_sha256 is"):
        train_ppo(settings["duel"], tmp_path / "out", **few)


def test_two_trainings_in_one_process_do_not_disturb_each_other(settings, trained, tmp_path):
    """torch's random generator belongs to the process: they take turns."""

    def train(level: str) -> None:
        train_ppo(settings[level], tmp_path / level, checkpoint_seconds=0.0)
        assert_same_state(state_of(tmp_path / level), state_of(trained[level].folder.parent))

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(train, settings)) == [None, None]


def test_an_executor_changes_no_weight(settings, trained, tmp_path):
    """Pieces of two seeds in turn; other processes are in tests/pcs_racing_agents/jobs/test_cluster.py."""
    reports = []
    with make_executor("threads", 2) as executor:
        both = train_ppo(
            settings["drive"],
            tmp_path,
            seeds=(0, 1),
            executor=executor,
            checkpoint_seconds=0.0,
            progress=lambda *news: reports.append(news),
        )
    assert both.curves[0] == trained["drive"].curves[0]
    assert_same_state(state_of(tmp_path), state_of(trained["drive"].folder.parent))
    assert reports[-1][:2] == (1280, 1280)
    assert [news[0] for news in reports] == sorted(news[0] for news in reports)
    assert len(reports) >= 8  # one for every piece


def test_seeds_differ_and_the_best_is_kept(settings, trained, tmp_path):
    both = train_ppo(settings["drive"], tmp_path, seeds=(0, 1))
    assert both.curves[0] == trained["drive"].curves[0]
    assert both.curves[1].scores != both.curves[0].scores
    worths = [max(mean_score(s, settings["drive"].opponents).worth for s in curve.scores) for curve in both.curves]
    assert both.seed == int(np.argmax(worths))
    assert mean_score(both.scores, settings["drive"].opponents).worth == max(worths)


def test_training_ends_at_a_plateau(settings, tmp_path):
    level = replace(settings["drive"], learning_rate=1e-8, final_learning_rate=0.0, patience=2, steps=10**6)
    result = train_ppo(level, tmp_path)
    assert result.curves[0].steps == (0, 320, 640)


def test_random_generators_of_the_process_are_left_alone(settings, tmp_path):
    import torch

    np.random.seed(5)  # noqa: NPY002
    torch.manual_seed(5)
    expected = np.random.get_state()[1].copy(), torch.get_rng_state(), torch.get_num_threads()  # noqa: NPY002
    train_ppo(settings["drive"], tmp_path, steps=160)
    np.testing.assert_array_equal(np.random.get_state()[1], expected[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), expected[1])
    assert torch.get_num_threads() == expected[2]


def test_weights_that_run_away_are_told(settings, trained):
    import torch

    from pcs_racing_agents.learning.ppo.learner import learn_once, make_learner, own_randomness

    with own_randomness():
        learner = make_learner(settings["drive"], trained["drive"].task.env_groups(), 0, "tanh", 10.0)
        learn_once(learner)
        with torch.no_grad():
            learner.model.policy.action_net.bias[0] = float("nan")
        with pytest.raises(InputError, match=r"weight .*160 steps"):
            learn_once(learner)


# What comes of it


def test_the_network_decides_as_stable_baselines_does(settings, trained):
    import torch

    from pcs_racing_agents.learning.ppo.checkpoint import restore_learner
    from pcs_racing_agents.learning.ppo.learner import actor_layers, make_learner, own_randomness

    run = trained["duel"]
    state = read_chunk(run.folder.parent / "chunks" / "seed-00000.npz")
    arrays = {key: array for key, array in state.items() if key.startswith("learner.")}
    with own_randomness():
        learner = make_learner(settings["duel"], run.task.env_groups(), 0, "relu", 1e6)
        restore_learner(learner, {key.removeprefix("learner."): array for key, array in arrays.items()})
        seen = np.random.default_rng(0).uniform(-1.0, 2.0, (300, 31)).astype(np.float32)
        network = run.task.network(actor_layers(learner), "net")
        np.testing.assert_array_equal(network.choose(seen), learner.model.predict(seen, deterministic=True)[0])
        with torch.no_grad():
            logits = learner.model.policy.get_distribution(torch.from_numpy(seen)).distribution.logits.numpy()
    values = network(seen)
    np.testing.assert_allclose(values - np.logaddexp.reduce(values, axis=1, keepdims=True), logits, atol=1e-5)


def test_a_duel_policy_is_an_agent_of_the_zoo(trained):
    network = load_network(trained["duel"].folder)
    assert network.name == "default-paper-ppo"
    assert network.training["setting_opponents"] == "2 random-moves, 1 never-switch, 1 pure-pursuit"
    assert network.training["steps"] == trained["duel"].steps
    network.check_fits(make_game(load_track("Larkmoor"), "default"))
    agent = make("ppo", network=trained["duel"].folder)
    game = make_game(load_track("Pipkin"), "default", stay=True)
    seen = game.observation(game.reset(games=3))[:, 0]
    np.testing.assert_array_equal(agent.predict(seen)[0], network.choose(seen))


def test_a_drive_policy_is_a_driver(trained):
    layers, manifest = read_driver(trained["drive"].folder)
    for one, two in zip(layers.weights, trained["drive"].layers.weights, strict=True):
        np.testing.assert_array_equal(one, two)
    assert manifest["training"]["seed"] == 0
    assert manifest["training"]["steps_of_all_seeds"] == 640


def test_curves_are_kept(settings, trained, tmp_path):
    run = trained["drive"]
    result = read_evaluations(run.folder / "curve.csv")
    assert [curve.steps for curve in result] == [(0, 320, 640)]
    assert result[0].scores[1].keys() == run.curves[0].scores[1].keys()
    cell = next(iter(run.scores))
    assert result[0].scores[1][cell] == pytest.approx(run.curves[0].scores[1][cell], rel=1e-5)
    again = write_evaluations(result, tmp_path / "again.csv")
    assert again.read_bytes() == (run.folder / "curve.csv").read_bytes()
    lines = (run.folder.parent / "updates.csv").read_text().splitlines()
    assert lines[0].startswith("seed,steps,approx_kl")
    assert [line.split(",")[1] for line in lines[1:]] == ["160", "320", "480", "640"]
    panels = evaluation_curves(result, settings["drive"].opponents)
    assert list(panels) == ["worth of a race", "races won", "crashes by own fault"]
    (worth,) = panels["worth of a race"]
    assert (worth.label, worth.x.tolist()) == ("seed 0", [0.0, 0.00032, 0.00064])
    assert worth.y[1] == mean_score(result[0].scores[1], settings["drive"].opponents).worth


@pytest.mark.parametrize("text", ["seed,steps\n0,1\n", "no curve at all\nx\n"])
def test_other_files_are_no_curves(tmp_path, text):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(InputError, match="curve"):
        read_evaluations(tmp_path / "curve.csv")
    with pytest.raises(InputError, match="can't read"):
        read_evaluations(tmp_path / "none.csv")
