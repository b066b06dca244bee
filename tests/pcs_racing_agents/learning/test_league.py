"""A league of planners and frozen copies: weights, files, and a training that adds to it."""

import re

import numpy as np
import pytest
import yaml
from refusal import refused

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.envs.drive import DriveVectorEnv
from pcs_racing.envs.infos import Result
from pcs_racing_agents.learning.league import (
    FILE,
    League,
    league_callback,
    load_league,
    make_league,
    save_league,
)

ROOKIES = {"lattice:pace=0": 2, "pure-pursuit": 1, "gap-follower": 1}
DRIVE = {"track": "Tarnfjord", "duration": 0.5}


def shares(league):
    return league.weights() / league.weights().sum()


def test_an_opponent_that_is_always_beaten_makes_room_for_the_others():
    league = make_league(ROOKIES)
    assert shares(league).tolist() == [0.5, 0.25, 0.25]
    for _ in range(20):
        # Always won, never won, even.
        opponents = [0] * 10 + [1] * 10 + [2] * 10
        results = [Result.WIN] * 10 + [Result.LOSS] * 10 + [Result.WIN, Result.LOSS] * 5
        league = league.record(opponents, results)
    won = [member.won_share for member in league.members]
    assert won == pytest.approx([1.0, 0.0, 0.5], abs=0.01)
    np.testing.assert_allclose(league.weights(), [0.2, 0.1, 1.0], atol=1e-6)
    # Results of a stronger learner count more than the former results.
    for _ in range(30):
        league = league.record([1] * 10, [Result.TIE] * 10)
    assert league.weights()[1] > 0.6
    assert league.record([1, 1], [Result.CRASH, Result.RUNNING]).weights() == pytest.approx(
        league.weights()
    )


def test_a_league_of_planners_is_an_opponent_and_comes_back_from_its_folder(tmp_path):
    league = make_league(ROOKIES).record([0, 0, 1], [Result.WIN, Result.TIE, Result.LOSS])
    assert save_league(tmp_path / "league", league) == tmp_path / "league"
    again = load_league(tmp_path / "league")
    assert [vars(member)["races"] for member in again.members] == [2.0, 1.0, 0.0]
    np.testing.assert_array_equal(again.weights(), league.weights())
    envs = DriveVectorEnv(60, opponent=again.opponents(), **DRIVE)
    envs.reset(seed=0)
    assert set(envs.batch.drawn) == {0, 1, 2}
    assert [one.name for one in envs.batch.opponents] == list(ROOKIES)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    league = make_league(ROOKIES)
    refused("can't write a league into .*file", save_league, tmp_path / "file", league)
    refused("the folder of the league is ''", save_league, "", league)


def changed(tmp_path, **changes):
    """Folder of a league with other fields of its first member; None takes a field away."""
    folder = save_league(tmp_path / "league", make_league(ROOKIES))
    content = yaml.safe_load((folder / FILE).read_text())
    fields = {**content["members"][0], **changes}
    content["members"][0] = {name: value for name, value in fields.items() if value is not None}
    (folder / FILE).write_text(yaml.safe_dump(content))
    return folder


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "lattise"}, "member 0: .*'lattise'.* did you mean"),
        ({"name": "lattice:pase=0"}, "member 0: .*pase"),
        ({"name": "lattice:pace=9"}, "member 0: .*pace.* is 9"),
        ({"weight": 0.0}, r"member 0: weight is 0\.0; it must be a number from 1e-12 to 1e\+12"),
        (
            {"weight": 1e13},
            "weight is 1.*; it must be a number from 1e-12 to 1e",
        ),
        ({"weight": [1, 2]}, r"member 0: weight is \[1, 2\]; it must be a number"),
        ({"name": 3}, "member 0: name is 3; it must be a non-empty text"),
        ({"weight": float("nan")}, "numbers must be finite"),
        ({"won": 3.0}, r"member 0: won is 3\.0; it must be a number from 0 to 0"),
        ({"weight": None}, "member 0 is .* must have the fields name, weight, races, won"),
        ({"skill": 3}, "member 0 is .* must have the fields name, weight, races, won"),
        ({"name": "pure-pursuit"}, "lists 'pure-pursuit' twice"),
        ({"name": "self-0001"}, "member 0: .*self-0001.zip"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_a_damaged_league_is_one_line(tmp_path, changes, message):
    folder = changed(tmp_path, **changes)
    error = UnknownNameError if "lattise" in message else None
    refused(message, load_league, folder, **({"error": error} if error else {}))


def test_a_league_is_neither_empty_nor_endless(tmp_path):
    refused("has 0 opponents", League, ())
    refused("has 101 opponents", make_league, [f"lattice:pace={k / 200}" for k in range(101)])
    refused("can't read .*; a league must have been written by save_league", load_league, tmp_path)


@pytest.mark.parametrize(
    ("opponents", "message"),
    [
        ("lattice", "opponents is 'lattice'; it must list names, or map names to weights"),
        (None, "opponents is None"),
        ([(2, "lattice")], "the name of an opponent is .*; it must be a non-empty text"),
        ({"lattice": "2"}, "opponent 0: weight is '2'; it must be a number"),
        ({"lattice": 10**13}, "opponent 0: weight is 10000000000000; it must be a number"),
        ({"lattice": float("inf")}, "opponent 0: weight is inf; it must be a number"),
    ],
    ids=str,
)
def test_opponents_are_names_with_weights(opponents, message):
    refused(message, make_league, opponents)


@pytest.mark.parametrize(
    ("opponents", "results", "message"),
    [
        ([4], [1], "opponents holds 4 at 0; it must be a whole number from 0 to 2"),
        ([0, 1], [1], r"results has shape \(1,\)"),
        ([0], [77], "results holds 77 at 0; it must be a whole number"),
        (["lattice"], [1], "opponents has shape .* it must hold whole numbers"),
    ],
)
def test_races_that_could_not_have_been_raced_are_refused(opponents, results, message):
    refused(message, make_league(ROOKIES).record, opponents, results)


def test_a_copy_is_of_a_model(tmp_path):
    copy = make_league(ROOKIES).with_copy
    refused("a list is no model of Stable-Baselines3", copy, [3], tmp_path)
    refused("the weight of a copy is 1.*; it must", copy, [3], tmp_path, 1e13)
    assert not [*tmp_path.iterdir()]


# Frozen copies of a model of Stable-Baselines3


@pytest.fixture(scope="module")
def model():
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from pcs_racing.envs.sb3 import make_sb3_vec_env

    league = make_league({"lattice:pace=0": 1})
    env = VecNormalize(make_sb3_vec_env("drive", 8, opponent=league.opponents(), **DRIVE))
    settings = {"n_steps": 8, "batch_size": 64, "n_epochs": 1, "seed": 0, "device": "cpu"}
    return PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8, 8]}, **settings).learn(64)


def copied_races(league):
    """Observations of races against the copies alone."""
    copies = [one for one in league.opponents() if one[1].name.startswith("self-")]
    envs = DriveVectorEnv(6, opponent=copies, **DRIVE)
    seen = [envs.reset(seed=3)[0]]
    for _ in range(4):
        seen.append(envs.step(np.tile([0.0, 0.2], (6, 1)))[0])
    return np.array(seen)


def test_a_copy_is_the_same_after_its_file_and_does_not_learn_on(model, tmp_path):
    folder = tmp_path / "league"
    league = make_league(ROOKIES).with_copy(model, folder, weight=2.0)
    assert [member.name for member in league.members] == [*ROOKIES, "self-0001"]
    before = copied_races(league)
    assert save_league(folder, league) == folder
    assert {file.name for file in folder.iterdir()} == {FILE, "self-0001.zip"}
    model.learn(64, reset_num_timesteps=False)
    np.testing.assert_array_equal(copied_races(league), before)
    np.testing.assert_array_equal(copied_races(load_league(folder)), before)
    later = load_league(folder).with_copy(model, folder)
    assert not np.array_equal(copied_races(League(later.members[-1:])), before)
    make_league(ROOKIES).with_copy(model, folder)  # another training, killed before it saved
    np.testing.assert_array_equal(copied_races(load_league(folder)), before)


def test_the_oldest_copy_leaves(model, tmp_path):
    league = make_league(ROOKIES)
    for _ in range(5):
        league = league.with_copy(model, tmp_path, max_copies=3)
    names = [member.name for member in league.members]
    assert names == [*ROOKIES, "self-0003", "self-0004", "self-0005"]


def test_a_damaged_copy_is_one_line(model, tmp_path):
    save_league(tmp_path, make_league(["lattice"]).with_copy(model, tmp_path))
    (tmp_path / "self-0001.zip").write_text("[1]")
    refused(f"{re.escape(FILE)}: member 1: .*self-0001", load_league, tmp_path)


def test_the_weights_of_a_training_follow_its_results(model):
    league = make_league({"lattice:pace=0": 1, "gap-follower": 1})
    env = model.get_env().venv
    model.set_env(
        type(env)(
            DriveVectorEnv(8, opponent=league.opponents(), autoreset_mode="SAME_STEP", **DRIVE)
        )
    )
    callback = league_callback(league)
    model.learn(128, callback=callback)
    races = [member.races for member in callback.league.members]
    assert min(races) > 0.0
    batch = model.get_env().groups[0].batch
    np.testing.assert_array_equal(batch.weights, callback.league.weights())
    assert batch.weights.tolist() != [1.0, 1.0]
