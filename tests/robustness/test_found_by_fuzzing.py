"""Inputs that fuzzing found (`tools/fuzz.py`), small; each ended in another error than ours once."""

import io
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from pcs_racing import GameConfig, InputError, RaceConfig, load_archive, load_race_config, load_track
from pcs_racing.characteristics import get_characteristics
from pcs_racing.envs.drive import checked_seed
from pcs_racing.envs.drive_batch import DriveOptions
from pcs_racing.map_files import parse_grid
from pcs_racing_agents.approximator import load_network
from pcs_racing_agents.ppo.settings import load_ppo_settings
from pcs_racing_agents.strategies.fits import Fit, load_fit
from pcs_racing_agents.study.cell_races import COLUMNS, read_races
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.report_inputs import LOSSES, read_curves, read_losses
from pcs_racing_agents.synthesis.config import ArchiveConfig
from pcs_racing_agents.trees import load_trees
from pcs_racing_agents.trees.tree import tree_from_arrays

NAMES = ("x" * 300, "../" + "x" * 5000, "a\x00b", "a\nb", "\ud800", "")


@pytest.mark.parametrize("load", [load_track, load_archive, load_network, load_race_config])
@pytest.mark.parametrize("name", NAMES)
def test_names_that_no_file_can_have(load, name):
    with pytest.raises(InputError) as caught:
        load(name)
    assert "\n" not in str(caught.value)


def test_long_values_make_short_messages():
    with pytest.raises(InputError) as caught:
        load_track("x" * 100_000)
    assert len(str(caught.value)) < 2000


@pytest.mark.parametrize(
    "make",
    [
        lambda: GameConfig(utility=["win"]),
        lambda: GameConfig(characteristics=[np.zeros(2)]),
        lambda: RaceConfig(start=np.array([])),
        lambda: get_characteristics([["restraint"]]),
        lambda: DriveOptions(max_range="far"),
        lambda: DriveOptions(fov=[1.0]),
        lambda: DriveOptions(beams=10**9),
        lambda: StudyConfig(race=("contest",)),
        lambda: StudyConfig(synthesis=("contest",)),
        lambda: StudyConfig(archive=0.5),
        lambda: ArchiveConfig(tracks=None),
        lambda: Fit(["best-fixed"], 1, "a", "b", "c", [0.5], 4),
        lambda: Fit("best-fixed", 1, "a", "b", "c", 0.5, 4),
        lambda: load_fit(-1),
        lambda: load_fit({"a": 1}),
        lambda: checked_seed(-126),
        lambda: checked_seed([1]),
        lambda: checked_seed(True),
    ],
)
def test_values_of_other_types(make):
    with pytest.raises(InputError):
        make()


def test_a_level_that_is_a_list(tmp_path):
    (tmp_path / "ppo.yaml").write_text("level: [duel]\n")
    with pytest.raises(InputError, match="level"):
        load_ppo_settings(tmp_path / "ppo.yaml")


@pytest.mark.parametrize("number", ["nan", "inf", "1e300"])
def test_tables_with_numbers_that_are_none(tmp_path, number):
    races = dict.fromkeys(COLUMNS, "0") | {"winner": "ego", "crash": "", "fault": "", "start_s": number}
    (tmp_path / "results.csv").write_text(",".join(races) + "\n" + ",".join(races.values()) + "\n")
    with pytest.raises(InputError):
        read_races(tmp_path / "results.csv")


def test_tables_that_are_infinite_or_empty(tmp_path):
    (tmp_path / "losses.csv").write_text(f"track,agent,{','.join(LOSSES)}\nPipkin,a,inf,1,1\n")
    with pytest.raises(InputError, match="'inf'"):
        read_losses(tmp_path / "losses.csv")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="no column"):
        read_curves(tmp_path / "empty.csv")


SETTINGS = {
    "archive": {"name": "a", "sha256": "0"},
    "track": {"name": "t", "sha256": "0"},
    "rules": {"moves": 1},
    "pairs": [[0, 1]],
    "encoding": ["step"],
    "move_names": ["a +", "a -"],
}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("archive", 3), ("archive", {"name": "a"}), ("track", {"name": "t", "sha256": None}), ("rules", {"moves": "a"}),
        ("rules", {"moves": 10**9}), ("pairs", []), ("pairs", [3]), ("encoding", None), ("move_names", [1]),
    ],
)  # fmt: skip
def test_manifests_of_trees_that_say_something_else(tmp_path, key, value):
    manifest = {"kind": "game trees", "settings": {**SETTINGS, key: value}}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(manifest))
    with pytest.raises(InputError, match=key):
        load_trees(tmp_path)


def tree() -> dict[str, np.ndarray]:
    zero = np.zeros(1, np.int64)
    return {
        "policies": np.array([0, 1]), "start_s": np.array(1.0), "side": np.array(0), "seeds": np.ones(1, np.uint64),
        "table": np.array([[0, 1], [0, 1]]), "points": np.zeros((2, 2)), "driven": zero, "live": zero, "crashed": zero,
        "payoffs": np.zeros((1, 2, 2), np.float32), "leads_0": np.zeros((1, 1, 1)),
        "estimates_0": np.zeros((1, 1, 1, 2, 2), np.float32), "over_0": np.zeros((1, 1, 1), np.bool_),
    }  # fmt: skip


def test_the_tree_that_the_next_test_breaks_is_sound():
    assert tree_from_arrays(tree(), 1, "it").game_tree() is not None


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("side", np.array("a")), ("start_s", np.zeros(2)), ("seeds", np.zeros(0, np.uint64)), ("points", np.zeros(2)),
        ("points", np.array([["a", "b"]] * 2)), ("table", np.zeros(2, np.int64)), ("crashed", np.zeros(3, np.int64)),
        ("payoffs", np.full((1, 2, 2), "x")), ("over_0", np.zeros((1, 1, 1))),
    ],
)  # fmt: skip
def test_trees_of_other_types_and_shapes(name, array):
    with pytest.raises(InputError, match="it"):
        tree_from_arrays({**tree(), name: array}, 1, "it")


def test_a_tree_too_large_to_be_one():
    arrays = tree()
    arrays["table"] = np.zeros((2, 8), np.int64)
    for k in range(12):
        arrays |= {f"{name}_{k}": arrays[f"{name}_0"] for name in ("leads", "estimates", "over")}
    with pytest.raises(InputError, match="leaves"):
        tree_from_arrays(arrays, 12, "it")


def test_a_picture_of_one_row():
    file = io.BytesIO()
    Image.fromarray(np.array([[0, 150, 255]], np.uint8)).save(file, "PNG")
    grid = parse_grid(Path("x.png"), file.getvalue(), {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.25})
    assert grid.tolist() == [[True, False, False]]
