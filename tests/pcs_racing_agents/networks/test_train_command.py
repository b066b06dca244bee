import csv

import numpy as np
import pytest
from refusal import refused
from toy_trees import random_tree

from pcs_racing import make_game
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.networks import load_network, load_train_settings
from pcs_racing_agents.networks.from_trees import train_regrets
from pcs_racing_agents.networks.rows import pair_number
from pcs_racing_agents.networks.training import Epoch
from pcs_racing_agents.trees import build_trees

pytest.importorskip("torch")

TOY = GameIdentity(
    tuple(f"x{i}" for i in range(15)), ("a", "b", "c"), (0.35,), "toy", "0" * 64, "paper"
)
QUICK = load_train_settings(target="advantage", hidden=(16,), epochs=3, iterations=20)


@pytest.fixture(scope="module")
def game():
    return make_game("Pipkin", steps=(1.0,) * 3)


@pytest.fixture(scope="module")
def folder(game, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trees")
    build_trees(game, folder, pairs=8)
    return folder


def names_in(folder) -> set[str]:
    return {file.name for file in folder.iterdir()}


@pytest.mark.parametrize("target", ["regret", "advantage"])
def test_the_command_writes_network_curves_and_scores(game, folder, tmp_path, printed, target):
    out = tmp_path / "net"
    options = ["--target", target, "--epochs", 4, "--hidden", 8, "--seed", 3]
    text = printed("train", "regret", folder, *options, "--out", out)
    files = {"weights.safetensors", "manifest.yaml"}
    assert names_in(out) == files | {"learning_curves.csv"}
    network = load_network(out)
    network.check_fits(game)
    known = (network.name, network.target, network.clipped, network.hidden)
    assert known == ("net", target, target == "regret", (8,))
    facts = network.training
    assert (facts["trees"], facts["tracks"], facts["setting_seed"]) == (8, "Pipkin", 3)
    curves = list(csv.DictReader((out / "learning_curves.csv").read_text().splitlines()))
    assert list(curves[0]) == list(Epoch._fields)
    assert [row["epoch"] for row in curves] == ["0", "1", "2", "3", "4"]
    for words in ("choices on held-out rows:", "  random moves ", f"network: {out}"):
        assert words in text


def test_one_command_has_one_result_and_folders_must_be_of_one_game(
    game, folder, tmp_path, printed, run
):
    options = ["--epochs", 2, "--name", "same", "--out"]
    for name in ("one", "two"):
        printed("train", "regret", folder, *options, tmp_path / name)
    files = names_in(tmp_path / "one")
    assert files == {"weights.safetensors", "manifest.yaml", "learning_curves.csv"}
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    build_trees(game, tmp_path / "more", pairs=3, seed=1)
    printed("train", "regret", folder, tmp_path / "more", *options, tmp_path / "both")
    assert load_network(tmp_path / "both").training["trees"] == 11
    other = make_game("Pipkin", steps=(1.0,) * 3, epsilon=0.2)
    build_trees(other, tmp_path / "other", pairs=2)
    code, _, err = run("train", "regret", folder, tmp_path / "other", "--out", tmp_path / "none")
    assert code == 2
    assert "hold trees of different games: epsilon is 0.2 in one and" in err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("given", "arguments", "message"),
    [
        ("trees", ["--target", "joy"], "target is 'joy'; it must be one of regret"),
        ("trees", ["--config", "nowhere"], "train settings 'nowhere' are unknown"),
        ("nothing", [], "holds no game trees"),
    ],
)
def test_bad_options_are_one_line(folder, tmp_path, told, given, arguments, message):
    (tmp_path / "nothing").mkdir()
    known = {"trees": folder, "nothing": tmp_path / "nothing"}
    command = ["train", "regret", known[given], *arguments, "--out", tmp_path / "out"]
    assert told(*command).count(message) == 1
    assert not (tmp_path / "out").exists()


def toy_trees(count=6):
    return [random_tree(seed=i, policies=(i, i + 1)) for i in range(count)]


def train_toys(trees, settings=QUICK, **options):
    pairs = [tree.policies for tree in trees]
    return train_regrets(trees.__getitem__, pairs, TOY, settings, name="toy", **options)


def test_no_starting_pair_is_learned_from_and_judged_by():
    pairs = [(0, 1), (1, 0), (2, 3), (4, 5), (5, 4), (6, 7)]
    trees = [random_tree(seed=i, policies=pair) for i, pair in enumerate(pairs)]
    for seed in range(4):
        told = []
        settings = load_train_settings(QUICK, seed=seed, test_share=0.4, epochs=1)
        trained = train_toys(trees, settings, solving=lambda *news, told=told: told.append(news))
        assert trained.scores["toy"].shape == (trained.network.training["test_trees"], 2)
        assert trained.network.training["test_trees"] in (2, 3, 4)
        assert trained.network.training["starting_pairs"] == 2
        assert told[-1] == (6, 6, "solved for advantage")
        known = {int(pair_number(pair)) for pair in [(0, 1), (2, 3), (4, 5), (6, 7)]}
        assert set(trained.result.validation_pairs) <= known


def test_without_held_out_trees_the_validation_rows_judge_and_too_few_pairs_are_refused():
    trained = train_toys(toy_trees(3), load_train_settings(QUICK, test_share=0.0))
    assert trained.scores == {}
    assert trained.rows.rows == 20  # one tree
    best = trained.result.epochs[trained.result.best]
    assert trained.rows.agreement == pytest.approx(best.validation_agreement, abs=1e-6)
    over = random_tree(policies=(9, 9), ended={0: np.ones((1, 1), bool), 1: np.ones((1, 9), bool)})
    trained = train_toys([over, *toy_trees(3), over], load_train_settings(QUICK, test_share=0.0))
    assert trained.network.training["rows"] == 60
    assert trained.network.training["trees"] == 5
    refused("2 starting pairs", train_toys, toy_trees(2))
    refused(
        "1 starting pairs", train_toys, toy_trees(1), load_train_settings(QUICK, test_share=0.0)
    )
