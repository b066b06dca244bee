"""Training as a value: the same again, whoever stopped it where."""

from dataclasses import fields, replace

import numpy as np
import pytest
from refusal import refused
from same_arrays import assert_same

from pcs_racing import load_archive, load_track, make_game
from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.agents import make
from pcs_racing_agents.base.chunks import read_chunk
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.learning.ppo.duels import DuelTask, make_duel_task
from pcs_racing_agents.learning.ppo.evaluation import (
    Matchup,
    MatchupScore,
    mean_score,
)
from pcs_racing_agents.learning.ppo.learner import (
    actor_layers,
    learn_once,
    make_model,
    own_randomness,
)
from pcs_racing_agents.learning.ppo.train import train_ppo, train_seed
from pcs_racing_agents.networks import load_network

torch = pytest.importorskip("torch")


@pytest.fixture(scope="module")
def settings(duel_settings):
    return duel_settings


@pytest.fixture(scope="module")
def trained(settings, tmp_path_factory):
    """Undisturbed training."""
    return train_ppo(settings, tmp_path_factory.mktemp("ppo"))


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


def test_a_stopped_training_ends_as_an_undisturbed_one(settings, trained, tmp_path):
    """Stopped in its first seed, then in its second: the first is kept. The best seed wins."""
    config, reports = settings, []
    for updates in (2, 7):
        assert not (tmp_path / "chunks").exists()
        with pytest.raises(StopError):
            train_ppo(config, tmp_path, progress=stop_after(updates), seeds=(0, 1))
    both = train_ppo(
        config, tmp_path, seeds=(0, 1), progress=lambda *news: reports.append(news[:2])
    )
    # When the seeds are counted, after every update of the second seed, and at its end.
    total = 2 * config.steps
    made = [config.steps + config.steps * k // 4 for k in range(5)]
    assert reports == [(steps, total) for steps in [*made, total]]
    assert_same(chunk_of(tmp_path), chunk_of(trained.folder.parent))
    assert both.curves[0] == trained.curves[0]
    assert both.curves[1].scores != both.curves[0].scores
    payoffs = [
        [mean_score(scores, config.opponents).worth for scores in curve.scores]
        for curve in both.curves
    ]
    assert both.seed == int(np.argmax([max(row) for row in payoffs]))
    assert mean_score(both.scores, config.opponents).worth == max(map(max, payoffs))


def test_a_folder_belongs_to_its_settings_and_archive_and_is_only_read_again(
    settings, tmp_path, trained, monkeypatch
):
    """An archive that was exchanged for another under the same name is noticed."""
    own = save_archive(load_archive("default"), tmp_path / "mine")
    few = {"archive": str(own), "opponents": {"random-moves": 1}, "steps": 16}
    train_ppo(settings, tmp_path / "out", **few)
    save_archive(load_archive("contest"), own)
    refused("archive_sha256 is", train_ppo, settings, tmp_path / "out", **few)
    monkeypatch.setattr("pcs_racing_agents.learning.ppo.train.learn_once", None)
    folder = trained.folder.parent
    assert train_ppo(settings, folder).curves == trained.curves
    refused(r"learning_rate is 0\.001", train_ppo, settings, folder, learning_rate=0.002)


def test_the_first_of_the_best_is_kept_a_plateau_ends_and_random_generators_are_left_alone(
    settings, trained
):
    asked, payoffs = [], [0.1, 0.4, 0.4, 0.2, 0.9]

    class Scripted(DuelTask):
        """A task whose evaluations are written down."""

        def evaluate(self, layers):
            asked.append(layers)
            score = MatchupScore(2, payoffs[len(asked) - 1], 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
            return {Matchup("Pipkin", "paper", name): score for name in self.settings.opponents}

    level = replace(settings, steps=10**6, patience=2, evaluate_every=20)
    task = trained.task
    parts = {field.name: getattr(task, field.name) for field in fields(task)}
    before = np.random.get_state()[1].copy(), torch.get_rng_state(), torch.get_num_threads()
    result = train_seed(Scripted(**{**parts, "settings": level}), None, 3)
    # An evaluation follows the first update that passes a multiple of the interval.
    assert result["steps"].tolist() == [0, 32, 48, 64]
    assert result["scores"][:, 0, 1].tolist() == payoffs[:4]
    best = trained.folder.parent / "x"
    assert layers_of(result, level, best) == pytest.approx(asked[1].flat())
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])
    assert torch.equal(torch.get_rng_state(), before[1])
    assert torch.get_num_threads() == before[2]


def layers_of(result, settings, file):
    from pcs_racing.base.dense import layers_from_bytes

    return layers_from_bytes(file, result["best"].tobytes(), list(settings.hidden))[0].flat()


def test_weights_and_the_learning_rate_keep_to_the_settings_and_lost_weights_are_told(
    settings, trained
):
    """The rate falls linearly from the first step to the last of the settings."""
    own = replace(settings, learning_rate=0.01, final_learning_rate=0.002)
    with own_randomness():
        model = make_model(own, trained.task.env_groups(), 0, "relu")
        rates = []
        for _ in range(3):
            learn_once(model, own, 0.05)
            rates.append(model.policy.optimizer.param_groups[0]["lr"])
        largest = max(np.abs(weight).max() for weight in actor_layers(model).weights)
        assert largest == np.float32(0.05)
        np.testing.assert_allclose(rates, [0.01, 0.008, 0.006])
        with torch.no_grad():
            model.policy.action_net.bias[0] = float("nan")
        refused(r"weight .*48 steps", learn_once, model, own, 10.0)


def test_the_network_decides_as_stable_baselines_does(settings, trained):
    task = trained.task
    with own_randomness():
        model = make_model(settings, task.env_groups(), 0, "relu")
        learn_once(model, settings, 1e6)
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


def test_a_policy_is_an_agent(trained):
    network = load_network(trained.folder)
    assert network.name == "default-paper-ppo"
    assert network.training["setting_opponents"] == "2 random-moves, 1 never-switch, 1 pure-pursuit"
    network.check_fits(make_game(load_track("Larkmoor"), "default"))
    agent = make("ppo", network=trained.folder)
    game = make_game(load_track("Pipkin"), "default", stay=True)
    seen = game.observation(game.reset(games=3))[:, 0]
    np.testing.assert_array_equal(agent.act(seen), network.choose(seen))
    run = trained
    np.testing.assert_array_equal(network.layers.flat(), run.layers.flat())
    score = mean_score(run.scores, run.settings.opponents)
    stated = {
        "algorithm": "PPO",
        "seed": 0,
        "steps": run.steps,
        "steps_of_all_seeds": 64,
        "evaluations": 3,
        "worth": float(f"{score.worth:.4g}"),
        "lead": float(f"{score.lead:.4g}"),
        "setting_tracks": "Pipkin",
        "setting_hidden": "8",
    }
    assert {key: network.training[key] for key in stated} == stated


def test_a_learning_curve_has_a_line_for_each_evaluation(trained):
    run = trained
    rows = read_csv(run.folder / "curve.csv").rows()
    matchup = Matchup(*(rows[0][key] for key in Matchup._fields))
    own = [row for row in rows if all(row[key] == rows[0][key] for key in Matchup._fields)]
    assert [row["steps"] for row in own] == ["0", "32", "64"]
    worth = [scores[matchup].worth for scores in run.curves[0].scores]
    assert [float(row["worth"]) for row in own] == pytest.approx(worth, rel=1e-5)


def test_what_settings_name_must_exist(settings):
    for changes, message in [
        ({"tracks": ("Nowhere",)}, "Nowhere"),
        ({"archive": "nothing"}, "nothing"),
        ({"rules": "sunday"}, "sunday"),
        ({"opponents": {"always-wrong": 1}}, "opponent 'always-wrong' is unknown"),
    ]:
        refused(message, make_duel_task, replace(settings, **changes), None, None, 1)
