"""PPO of the duel, in trainings of a second: the same again after any stop."""

import numpy as np
import pytest
import yaml
from random_layers import random_layers
from refusal import refused
from repository import read_page

from pcs_racing import load_archive, make_game
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.agents import make
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.learning import ppo
from pcs_racing_agents.learning.ppo import Evaluation, PPOSettings, load_ppo_settings, train_ppo
from pcs_racing_agents.networks import load_network

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

SMALL = PPOSettings(
    worth="win",
    tracks=("Pipkin",),
    opponents={"random-moves": 2, "never-switch": 1, "pure-pursuit": 1},
    hidden=(8,),
    steps=48,
    envs=4,
    rollout=4,
    evaluate_every=32,
    evaluation_races=8,
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Undisturbed training, and its folder."""
    folder = tmp_path_factory.mktemp("ppo")
    return train_ppo(SMALL, folder), folder


def test_of_several_seeds_the_policy_of_the_best_evaluation_is_kept(trained, tmp_path):
    alone, _ = trained
    both = train_ppo(SMALL, tmp_path, seeds=(0, 1))
    assert [line for line in both.curve if line.seed == 0] == alone.curve
    scores = {
        key: np.average([line.score for line in both.curve if line[:2] == key], weights=[2, 1, 1])
        for key in dict.fromkeys(line[:2] for line in both.curve if line.steps)
    }
    best = max(scores, key=scores.get)
    assert both.best == [line for line in both.curve if line[:2] == best]


def test_a_folder_belongs_to_its_settings_and_archive_and_is_only_read_again(
    trained, tmp_path, monkeypatch
):
    """An archive that was exchanged for another under the same name is noticed."""
    own = save_archive(load_archive("default"), tmp_path / "mine")
    few = {"archive": str(own), "opponents": {"random-moves": 1}, "steps": 16}
    train_ppo(SMALL, tmp_path / "out", **few)
    save_archive(load_archive("contest"), own)
    refused("archive is", train_ppo, SMALL, tmp_path / "out", **few)
    monkeypatch.setattr(ppo, "_train_seed", pytest.fail)
    alone, folder = trained
    assert train_ppo(SMALL, folder).curve == alone.curve
    refused(r"learning_rate", train_ppo, SMALL, folder, learning_rate=0.002)


def test_the_network_is_an_agent_with_its_training_and_its_curve(trained):
    alone, folder = trained
    network = load_network(folder / "agent")
    assert (network.name, network.target) == ("default-paper-ppo", "ppo")
    stated = {
        "algorithm": "PPO",
        "seed": 0,
        "steps": alone.best[0].steps,
        "setting_tracks": "Pipkin",
        "setting_opponents": "2 random-moves, 1 never-switch, 1 pure-pursuit",
        "setting_hidden": "8",
    }
    assert {key: network.training[key] for key in stated} == stated
    game = make_game("Pipkin", "default", stay=True)
    seen = game.observation(game.reset(games=3))[:, 0]
    agent = make("ppo", network=folder / "agent")
    np.testing.assert_array_equal(agent.act(seen), network.choose(seen))
    rows = read_csv(folder / "agent" / "curve.csv").rows()
    assert tuple(rows[0]) == Evaluation._fields
    # Before the first update, after the first one beyond 32 steps, and at the end.
    assert [row["steps"] for row in rows[::3]] == ["0", "32", "48"]
    assert {row["races"] for row in rows} == {"2"}


def test_the_network_decides_as_stable_baselines_does_and_generators_are_left_alone():
    from stable_baselines3 import PPO

    game = make_game("Pipkin", "default", "paper")
    before = np.random.get_state()[1].copy(), torch.get_rng_state(), torch.get_num_threads()
    with ppo.own_randomness():
        kind = {"net_arch": [8], "activation_fn": torch.nn.ReLU}
        model = PPO("MlpPolicy", ppo._make_envs(SMALL, [game], 0), policy_kwargs=kind)
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])
    assert torch.equal(torch.get_rng_state(), before[1])
    assert torch.get_num_threads() == before[2]
    layers = ppo.frozen_model(model, "ppo").layers
    seen = np.random.default_rng(0).uniform(-1.0, 2.0, (300, 31)).astype(np.float32)
    with torch.no_grad():
        logits = model.policy.get_distribution(torch.from_numpy(seen)).distribution.logits.numpy()
    values = ppo._network(game, layers, "net", {})(seen)
    normalised = values - np.logaddexp.reduce(values, axis=1, keepdims=True)
    np.testing.assert_allclose(normalised, logits, atol=1e-5)


def test_games_are_shared_out_by_the_frequency_of_the_opponents():
    game = make_game("Pipkin", "default", "paper")
    opponents = {"random-moves": 5, "never-switch": 2, "pure-pursuit": 1}
    envs = ppo._make_envs(load_ppo_settings(SMALL, opponents=opponents, envs=8), [game] * 2, 3)
    assert [group.num_envs for group in envs.groups] == [5, 2, 1] * 2
    names = [[one.name for one in group.batch.opponents] for group in envs.groups]
    assert names == [[name] for name in opponents] * 2
    assert len(set(envs._group_seeds)) == 6
    few = ppo._make_envs(load_ppo_settings(SMALL, opponents=opponents, envs=1), [game], 3)
    assert few.num_envs == 3


def test_scores_are_means_over_races_by_the_frequency_of_the_opponents():
    game = make_game("Pipkin", "default", "paper", threads=1)
    layers = random_layers(31, 8, 4, seed=3)
    scores = ppo._race(SMALL, [game], layers)
    assert scores.shape == (3, 3)
    assert ((scores[:, :2] >= 0.0) & (scores[:, :2] <= 1.0)).all()
    np.testing.assert_array_equal(ppo._race(SMALL, [game], layers), scores)
    np.testing.assert_allclose(ppo._means(SMALL, scores), [0.5, 0.25, 0.25] @ scores)


def test_lost_weights_are_reported(tmp_path, monkeypatch):
    real = ppo.frozen_model

    def poisoned(model, name):
        layers = real(model, name)
        model.policy.action_net.bias.data.fill_(float("nan"))
        return layers

    monkeypatch.setattr(ppo, "frozen_model", poisoned)
    refused(r"no longer a number .* learning_rate below 0\.001", train_ppo, SMALL, tmp_path)


def test_shipped_settings_are_on_the_page_and_a_file_changes_what_it_names(tmp_path):
    for name in shipped_configs("ppo"):
        assert load_ppo_settings(name).archive in ("default", "contest")
        assert f"`{name}`" in read_page("ppo.md")
    file = tmp_path / "mine.yaml"
    file.write_text("envs: 10\nopponents: {pure-pursuit: 3}\nseeds: [4, 5]\n")
    expected = PPOSettings(envs=10, opponents={"pure-pursuit": 3}, seeds=(4, 5), steps=77)
    assert load_ppo_settings(file, steps=77) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hold: 2", r"unknown ppo setting 'hold'"),
        ("learning_rate: -1.0", r"learning_rate is -1"),
        ("opponents: never-switch", r"opponents is 'never-switch'"),
        ("opponents: {never-switch: 0.5}", r"opponents holds 'never-switch': 0.5"),
    ],
)
def test_impossible_settings_are_named(text, message, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    refused(message, load_ppo_settings, file, error=ConfigError)


@pytest.mark.parametrize(
    "changes",
    [
        {"tracks": ("Nowhere",)},
        {"archive": "nothing"},
        {"rules": "sunday"},
        {"opponents": {"nobody": 1}},
    ],
    ids=str,
)
def test_names_in_settings_must_exist(changes, tmp_path):
    ((_, value),) = changes.items()
    name = value if isinstance(value, str) else next(iter(value))
    refused(name, train_ppo, SMALL, tmp_path / "out", **changes)


def test_training_from_the_command_line(tmp_path, run):
    config = tmp_path / "mine.yaml"
    values = {**plain_settings(SMALL), "opponents": {"never-switch": 1}, "steps": 16}
    config.write_text(yaml.safe_dump(values))
    place = tmp_path / "out"
    arguments = ["train", "ppo", "--config", config, "--out", place, "--seeds", 3, "--name", "mine"]
    code, out, err = run(*arguments)
    assert code == 0
    assert "best: seed 3, " in out
    assert out.endswith(f"race it as ppo:network={place / 'agent'}\n")
    assert "16/16 steps" in err
    created = {path.name for path in place.iterdir() if not path.name.startswith(".")}
    assert created == {"job.yaml", "chunks", "agent"}
    assert load_network(place / "agent").name == "mine"
    assert run(*arguments)[:2] == (0, out)  # finished: it is only read
