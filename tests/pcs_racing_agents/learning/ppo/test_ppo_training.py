"""Training as a value: the same again, whoever stopped it where."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from random_layers import random_layers
from refusal import refused
from same_arrays import assert_same

from pcs_racing import InputError, load_archive, load_track, make_game, save_archive
from pcs_racing.planners.network import INPUTS
from pcs_racing.planners.trained import read_driver
from pcs_racing_agents.agents import make
from pcs_racing_agents.base.chunks import read_chunk
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.learning.ppo.evaluation import (
    Matchup,
    MatchupScore,
    mean_score,
    read_evaluations,
    write_evaluations,
)
from pcs_racing_agents.learning.ppo.learner import (
    actor_layers,
    learn_once,
    make_model,
    own_randomness,
)
from pcs_racing_agents.learning.ppo.train import SeedRecord, make_task, train_ppo
from pcs_racing_agents.networks import load_network

torch = pytest.importorskip("torch")


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


def chunk_of(folder, seed=0):
    """What a seed came to, without the clock."""
    arrays = read_chunk(folder / f"chunks/seed-{seed:05d}.npz")
    return {key: array for key, array in arrays.items() if key != "seconds"}


@pytest.mark.parametrize("level", ["duel", "drive"])
def test_a_stopped_training_ends_as_an_undisturbed_one(level, settings, trained, tmp_path):
    """Stopped in its first seed, then in its second: the first is kept."""
    updates = settings[level].steps // (settings[level].steps // 4)
    with pytest.raises(StopError):
        train_ppo(settings[level], tmp_path, progress=stop_after(2), seeds=(0, 1))
    assert not (tmp_path / "chunks").exists()
    with pytest.raises(StopError):
        train_ppo(settings[level], tmp_path, progress=stop_after(updates + 3), seeds=(0, 1))
    done = []
    again = train_ppo(
        settings[level], tmp_path, seeds=(0, 1), progress=lambda *news: done.append(news[0])
    )
    assert done[0] == settings[level].steps
    assert_same(chunk_of(tmp_path), chunk_of(trained[level].folder.parent))
    assert again.curves[0] == trained[level].curves[0]


def test_a_folder_belongs_to_its_settings_and_archive_and_is_only_read_again(
    settings, tmp_path, trained, monkeypatch
):
    """An archive that was exchanged for another under the same name is noticed."""
    own = save_archive(load_archive("default"), tmp_path / "mine")
    few = {"archive": str(own), "opponents": {"random-moves": 1}, "steps": 16}
    train_ppo(settings["duel"], tmp_path / "out", **few)
    save_archive(load_archive("contest"), own)
    refused("archive_sha256 is", train_ppo, settings["duel"], tmp_path / "out", **few)
    monkeypatch.setattr("pcs_racing_agents.learning.ppo.train.learn_once", None)
    again = train_ppo(settings["drive"], trained["drive"].folder.parent)
    assert again.curves == trained["drive"].curves
    with pytest.raises(InputError, match=r"learning_rate is 0\.001, not 0\.002"):
        train_ppo(settings["duel"], trained["duel"].folder.parent, learning_rate=0.002)


def test_two_trainings_in_one_process_do_not_disturb_each_other(settings, trained, tmp_path):
    """torch's random generator belongs to the process: they take turns."""

    def train(level: str) -> None:
        train_ppo(settings[level], tmp_path / level)
        assert_same(chunk_of(tmp_path / level), chunk_of(trained[level].folder.parent))

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(train, settings)) == [None, None]


def test_seeds_differ_the_best_is_kept_and_an_executor_changes_no_weight(
    settings, trained, tmp_path
):
    """Two seeds in turn; other processes are in tests/pcs_racing_agents/base/test_cluster.py."""
    reports = []
    with make_executor("threads", 2) as executor:
        both = train_ppo(
            settings["drive"],
            tmp_path,
            seeds=(0, 1),
            executor=executor,
            progress=lambda *news: reports.append(news),
        )
    assert both.curves[0] == trained["drive"].curves[0]
    assert_same(chunk_of(tmp_path), chunk_of(trained["drive"].folder.parent))
    assert both.curves[1].scores != both.curves[0].scores
    payoffs = [
        max(mean_score(s, settings["drive"].opponents).worth for s in curve.scores)
        for curve in both.curves
    ]
    assert both.seed == int(np.argmax(payoffs))
    assert mean_score(both.scores, settings["drive"].opponents).worth == max(payoffs)
    assert reports[-1][:2] == (1280, 1280)
    assert [news[0] for news in reports] == sorted(news[0] for news in reports)
    assert len(reports) == 11  # at the beginning, after every update, and after every seed


def test_training_ends_at_a_plateau_and_leaves_random_generators_alone(settings, tmp_path):
    level = replace(
        settings["drive"], learning_rate=1e-8, final_learning_rate=0.0, patience=2, steps=10**6
    )
    assert train_ppo(level, tmp_path / "plateau").curves[0].steps == (0, 320, 640)
    np.random.seed(5)  # noqa: NPY002
    torch.manual_seed(5)
    expected = np.random.get_state()[1].copy(), torch.get_rng_state(), torch.get_num_threads()  # noqa: NPY002
    short = train_ppo(settings["drive"], tmp_path / "short", steps=480, evaluate_every=250)
    # after the update that passes a multiple, and at the end
    assert short.curves[0].steps == (0, 320, 480)
    np.testing.assert_array_equal(np.random.get_state()[1], expected[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), expected[1])
    assert torch.get_num_threads() == expected[2]


def test_weights_and_the_learning_rate_keep_to_the_settings_and_weights_that_run_away_are_told(
    settings, trained
):
    """The rate falls linearly from the first step to the last of the settings."""
    drive = replace(settings["drive"], learning_rate=0.01, final_learning_rate=0.002)
    with own_randomness():
        model = make_model(drive, trained["drive"].task.env_groups(), 0, "tanh")
        rates = []
        for _ in range(3):
            learn_once(model, drive, 0.05)
            rates.append(model.policy.optimizer.param_groups[0]["lr"])
        assert max(np.abs(weight).max() for weight in actor_layers(model).weights) == np.float32(
            0.05
        )
    np.testing.assert_allclose(rates, [0.01, 0.008, 0.006])
    with own_randomness():
        model = make_model(settings["drive"], trained["drive"].task.env_groups(), 0, "tanh")
        learn_once(model, settings["drive"], 10.0)
        with torch.no_grad():
            model.policy.action_net.bias[0] = float("nan")
        refused(r"weight .*160 steps", learn_once, model, settings["drive"], 10.0)


@pytest.mark.parametrize("hidden", [(8,), ()])
def test_noise_may_last_for_some_steps(settings, trained, hidden):
    """With ``noise_steps`` it is drawn anew for a rollout's steps together, and about as large as
    without.
    """
    level = replace(settings["drive"], noise=0.1, noise_steps=5, hidden=hidden)
    with own_randomness():
        policy = make_model(level, trained["drive"].task.env_groups(), 3, "tanh").policy
        # Outputs of the layer before the last are about a half in size.
        seen = torch.as_tensor(
            np.random.default_rng(0).choice([-0.55, 0.55], (4, len(INPUTS))).astype(np.float32)
        )
        mean = policy.forward(seen, deterministic=True)[0]
        tried = []
        for _ in range(200):
            policy.reset_noise(4)
            first, again = policy.forward(seen)[0], policy.forward(seen)[0]
            assert torch.equal(first, again)
            tried.append((first - mean).detach().numpy())
    np.testing.assert_allclose(np.std(tried), 0.1 * 0.55 / 0.5, rtol=0.1)
    assert len({row.tobytes() for row in tried}) == 200


def test_the_network_decides_as_stable_baselines_does(settings, trained):
    task = trained["duel"].task
    with own_randomness():
        model = make_model(settings["duel"], task.env_groups(), 0, "relu")
        learn_once(model, settings["duel"], 1e6)
        seen = np.random.default_rng(0).uniform(-1.0, 2.0, (300, 31)).astype(np.float32)
        network = task.network(actor_layers(model), "net")
        decided, expected = network.choose(seen), model.predict(seen, deterministic=True)[0]
        with torch.no_grad():
            logits = model.policy.get_distribution(
                torch.from_numpy(seen)
            ).distribution.logits.numpy()
    first, second = np.sort(logits, axis=1)[:, -1], np.sort(logits, axis=1)[:, -2]
    clear = first - second > 1e-4  # the last bits decide between two that are as good
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(decided[clear], expected[clear])
    values = network(seen)
    np.testing.assert_allclose(
        values - np.logaddexp.reduce(values, axis=1, keepdims=True), logits, atol=1e-5
    )


def test_a_duel_policy_is_an_agent_of_the_zoo_and_a_drive_policy_a_driver(trained):
    network = load_network(trained["duel"].folder)
    assert network.name == "default-paper-ppo"
    assert network.training["setting_opponents"] == "2 random-moves, 1 never-switch, 1 pure-pursuit"
    assert network.training["steps"] == trained["duel"].steps
    network.check_fits(make_game(load_track("Larkmoor"), "default"))
    agent = make("ppo", network=trained["duel"].folder)
    game = make_game(load_track("Pipkin"), "default", stay=True)
    seen = game.observation(game.reset(games=3))[:, 0]
    np.testing.assert_array_equal(agent.act(seen), network.choose(seen))
    layers, manifest = read_driver(trained["drive"].folder)
    for one, two in zip(layers.weights, trained["drive"].layers.weights, strict=True):
        np.testing.assert_array_equal(one, two)
    run, about = trained["drive"], manifest["training"]
    score = mean_score(run.scores, run.settings.opponents)
    figures = {
        key: float(f"{value:.4g}") for key, value in score._asdict().items() if key != "races"
    }
    stated = {
        "algorithm": "PPO",
        "seed": 0,
        "steps": run.steps,
        "steps_of_all_seeds": 640,
        "evaluations": 3,
        **figures,
        "setting_tracks": "Pipkin",
        "setting_hidden": "8",
        "setting_steps": 640,
        "setting_noise": 0.5,
        "setting_opponents": "1 lattice:pace=0, 1 pure-pursuit",
    }
    assert {key: about[key] for key in stated} == stated


def test_a_record_keeps_the_first_of_the_best_and_survives_as_arrays(trained):
    task = trained["drive"].task
    record = SeedRecord(3, {"x": 1, "y": 3})
    layers = [random_layers(len(INPUTS), 8, 2, seed=seed) for seed in range(4)]
    matchups = [Matchup("Pipkin", "short", name) for name in ("x", "y")]
    for k, (one, other) in enumerate([(0.0, 0.1), (0.4, 0.2), (0.4, 0.2), (0.9, 0.0)]):
        scores = [MatchupScore(2, worth, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6) for worth in (one, other)]
        record.add(100 * k, dict(zip(matchups, scores, strict=True)), layers[k])
    assert [record.payoff(k) for k in range(4)] == pytest.approx([0.075, 0.25, 0.25, 0.225])
    assert (record.best_at, record.best, record.curve.steps) == (1, layers[1], (0, 100, 200, 300))
    record.updates, record.seconds = [(160.0, 1.0, 2.0)], 7.0
    again = SeedRecord.from_arrays(3, task, record.arrays())
    assert (again.curve, again.updates, again.seconds) == (
        record.curve,
        record.updates,
        record.seconds,
    )
    np.testing.assert_array_equal(again.best.flat(), layers[1].flat())
    refused(
        "know no archive and no game",
        make_task,
        trained["drive"].settings,
        archive=load_archive("default"),
    )


def test_curves_are_kept_and_other_files_are_none(settings, trained, tmp_path):
    run = trained["drive"]
    result = read_evaluations(run.folder / "curve.csv")
    assert [curve.steps for curve in result] == [(0, 320, 640)]
    assert result[0].scores[1].keys() == run.curves[0].scores[1].keys()
    cell = next(iter(run.scores))
    assert result[0].scores[1][cell] == pytest.approx(run.curves[0].scores[1][cell], rel=1e-5)
    again = write_evaluations(result, tmp_path / "again.csv")
    assert again.read_bytes() == (run.folder / "curve.csv").read_bytes()
    lines = (run.folder.parent / "updates.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in lines[1:]] == ["160", "320", "480", "640"]
    arrays = chunk_of(run.folder.parent)
    rows = [
        f"0,{int(row[0])},{','.join(f'{value:.6g}' for value in row[1:])}"
        for row in arrays["updates"]
    ]
    assert lines[1:] == rows
    assert (
        lines[0]
        == "seed,steps,approx_kl,clip_fraction,entropy_loss,explained_variance,value_loss,reward"
    )
    worse = (run.folder / "curve.csv").read_text().replace("\n0,320,", "\n0,soon,", 1)
    (tmp_path / "curve.csv").write_text(worse)
    refused("line 4 is none of a learning curve", read_evaluations, tmp_path / "curve.csv")
    for text in ["seed,steps\n0,1\n", "no curve at all\nx\n"]:
        (tmp_path / "curve.csv").write_text(text)
        refused("curve", read_evaluations, tmp_path / "curve.csv")
    refused("can't read", read_evaluations, tmp_path / "none.csv")
