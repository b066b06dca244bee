"""Inputs that fuzzing found, which ended in another error than ours once, and hostile ones.

Nothing that is read runs code, leaves the map's folder, or takes memory or time out of proportion.
"""

import io
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from refusal import refused

from pcs_racing import (
    InputError,
    load_archive,
    load_rules,
    load_track,
    make_game,
    racer,
    record_race,
    save_replay,
)
from pcs_racing.base.errors import check_number, check_seed
from pcs_racing.base.files import plain_yaml
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.duel import HeadToHeadEnv
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.players import competitor
from pcs_racing.planners.learned import load_planner
from pcs_racing.race.config import Rules
from pcs_racing.track.map_files import parse_grid, read_map, write_map
from pcs_racing_agents.agents.blind import Fit, load_fit
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.cli.options import output_folder
from pcs_racing_agents.learning.ppo import load_ppo_settings
from pcs_racing_agents.networks import load_network, load_network_set
from pcs_racing_agents.networks.training import load_train_settings
from pcs_racing_agents.policies.config import FrontConfig
from pcs_racing_agents.study.config import LearningConfig, StudyConfig, load_study_config
from pcs_racing_agents.study.study import open_results
from pcs_racing_agents.tournament.protocol import load_protocol
from pcs_racing_agents.tournament.race_files import read_results, write_results
from pcs_racing_agents.trees import load_trees
from pcs_racing_agents.trees.tree import tree_from_arrays
from pcs_racing_agents.watch.frames import write_gif


@pytest.mark.parametrize("load", [load_track, load_archive, load_network, load_rules])
@pytest.mark.parametrize("name", ["x" * 300, "../" + "x" * 5000, "a\x00b", "a\nb", "\ud800", ""])
def test_names_that_no_file_can_have(load, name):
    refused(r"\S", load, name)


NO_FILE = ["a\0b.{}", "\ud800.{}", "a/\0/b.{}"]


@pytest.mark.parametrize("name", NO_FILE)
def test_no_place_that_takes_a_path_takes_one_that_no_file_can_have(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    archive, track = load_archive("default"), load_track("Pipkin")
    replay = record_race(track, racer("lattice"), racer("lattice"), load_rules("paper"), seed=0)
    folder, file, game = (
        Path(name.format("d")),
        name.format,
        make_game(None, "default", "paper"),
    )
    for call in (
        lambda: load_track(file("yaml")),
        lambda: load_archive(folder),
        lambda: load_rules(file("yaml")),
        lambda: load_fit(file("yaml")),
        lambda: racer(file("zip")),
        lambda: make_game("Pipkin", folder),
        lambda: load_network_set(folder),
        lambda: load_network(folder),
        lambda: load_trees(folder),
        lambda: read_results(file("csv")),
        lambda: open_results(folder),
        lambda: load_ppo_settings(file("yaml")),
        lambda: load_protocol(file("yaml"), []),
        lambda: load_study_config(file("yaml")),
        lambda: load_planner(folder),
        lambda: save_archive(archive, folder),
        lambda: save_replay(replay, file("html")),
        lambda: write_results([], folder),
        lambda: output_folder(folder),
        lambda: write_map(read_map(track.folder)._replace(folder=folder)),
        lambda: write_gif(replay, folder),
        lambda: open_job(folder, "kind", {}).__enter__(),
        lambda: competitor(file("zip"), game),
    ):
        refused(r"\S", call)
    assert not [*tmp_path.iterdir()]


def test_values_of_other_types():
    for make in [
        lambda: Rules(utility=["win"]),
        lambda: Rules(characteristics=[np.zeros(2)]),
        lambda: Rules(start=np.array([])),
        lambda: get_characteristics([["restraint"]]),
        lambda: DriveOptions(max_range="far"),
        lambda: DriveOptions(fov=[1.0]),
        lambda: DriveOptions(beams=10**9),
        lambda: StudyConfig(rules=("contest",)),
        lambda: StudyConfig(archive=0.5),
        lambda: LearningConfig(trees="many"),
        lambda: load_train_settings(b"study"),
        lambda: FrontConfig(tracks=None),
        lambda: Fit(["best-fixed"], 1, GameIdentity((), (), (0.5,), "a", "b", "c")),
        lambda: load_fit(-1),
        lambda: load_fit({"a": 1}),
        lambda: check_seed(-126),
        lambda: check_seed([1]),
        lambda: check_seed(True),
    ]:
        refused(" (is|are|must) ", make)
    assert Rules(epsilon=[np.array(0.5)]) == Rules(epsilon=0.5)
    with pytest.raises(InputError, match="line 2") as caught:
        plain_yaml("password: [a, b\n")  # a link may have led there
    assert "password" not in str(caught.value)
    for epsilon in (
        type("Long", (), {"__len__": lambda self: 10**9, "__getitem__": lambda self, i: 0.5})(),
        10**400,
        [np.array([0.5, 1.0])],
        [[0.5]],
        [1j],
        [True],
    ):
        refused("epsilon is", Rules, epsilon=epsilon)
    with warnings.catch_warnings(action="error"):
        assert check_number("x", np.float16(0.5), 0.0, 1e300) == 0.5
        assert check_number("x", np.float16(0.5), above=-1e300) == 0.5
        assert Rules(epsilon=np.float16(0.5)) == Rules(epsilon=0.5)
    env = HeadToHeadEnv(track="Pipkin", steps=(0.1,) * 2)
    refused("policies has shape", env.reset, seed=0, options={"policies": [[0], [1, 2]]})
    env.reset(seed=0)
    refused("moves are", env.step, {"car_0": [[0], [1, 2]], "car_1": 0})


SETTINGS = {
    "archive": {"name": "a", "sha256": "0"},
    "track": {"name": "t", "sha256": "0"},
    "rules": {"name": "paper", "epsilon": 0.5, "steps": [8.0, 8.0]},
    "pairs": [[0, 1]],
    "encoding": ["step"],
    "move_names": ["a +", "a -"],
}


def test_manifests_of_trees_that_say_something_else(tmp_path):
    for key, value in [
        ("archive", 3),
        ("archive", {"name": "a"}),
        ("track", {"name": "t", "sha256": None}),
        ("rules", {"steps": "a"}),
        ("rules", {"steps": [8.0] * 1000}),
        ("pairs", []),
        ("pairs", [3]),
        ("encoding", None),
        ("move_names", [1]),
    ]:
        manifest = {"kind": "game trees", "settings": {**SETTINGS, key: value}}
        (tmp_path / "job.yaml").write_text(yaml.safe_dump(manifest))
        refused(key, load_trees, tmp_path)


def tree() -> dict[str, np.ndarray]:
    zero = np.zeros(1, np.int64)
    return {
        "policies": np.array([0, 1]),
        "start_s": np.array(1.0),
        "side": np.array(0),
        "seeds": np.ones(1, np.uint64),
        "handicaps": np.zeros((1, 2)),
        "table": np.array([[0, 1], [0, 1]]),
        "points": np.zeros((2, 2)),
        "driven": zero,
        "live": zero,
        "crashed": zero,
        "payoffs": np.zeros((1, 2, 2), np.float32),
        "leads_0": np.zeros((1, 1, 1)),
        "estimates_0": np.zeros((1, 1, 1, 2, 2), np.float32),
        "over_0": np.zeros((1, 1, 1), np.bool_),
    }


def test_trees_that_the_next_tests_break_are_sound_and_one_too_large_is_refused():
    assert tree_from_arrays(tree(), 1, "it").game_tree() is not None
    arrays = tree()
    arrays["table"] = np.zeros((2, 8), np.int64)
    for k in range(12):
        arrays |= {f"{name}_{k}": arrays[f"{name}_0"] for name in ("leads", "estimates", "over")}
    refused("with 8 choices .* leaves", tree_from_arrays, arrays, 12, "it")


def test_trees_of_other_types_and_shapes():
    for name, array in [
        ("side", np.array("a")),
        ("start_s", np.zeros(2)),
        ("seeds", np.zeros(0, np.uint64)),
        ("points", np.zeros(2)),
        ("points", np.array([["a", "b"]] * 2)),
        ("table", np.zeros(2, np.int64)),
        ("crashed", np.zeros(3, np.int64)),
        ("payoffs", np.full((1, 2, 2), "x")),
        ("over_0", np.zeros((1, 1, 1))),
    ]:
        refused("it", tree_from_arrays, {**tree(), name: array}, 1, "it")


def test_tracks_that_are_no_name_and_a_picture_of_one_row():
    for track in [5, 0.5, ["Pipkin"], {"a": 1}, b"Pipkin"]:
        refused("track is", make_game, track)
    file = io.BytesIO()
    Image.fromarray(np.array([[0, 150, 255]], np.uint8)).save(file, "PNG")
    grid = parse_grid(
        Path("x.png"),
        file.getvalue(),
        {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.25},
    )
    assert grid.tolist() == [[True, False, False]]


@pytest.mark.skipif(
    not Path("/proc/self/statm").is_file(), reason="limits of memory are tested on Linux"
)
def test_hostile_inputs_are_refused_in_little_memory(tmp_path):
    script = Path(__file__).with_name("hostile.py")
    command = [sys.executable, str(script), str(tmp_path)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    *wrong, last = found.stdout.splitlines() or [""]
    assert wrong == [], found.stderr[-2000:]
    assert last.endswith("cases"), found.stderr[-2000:]
    assert int(last.split()[0]) > 80
