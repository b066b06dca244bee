"""Trained planners as competitors."""

import pickle

from random_layers import random_layers

from pcs_racing.planners.field.lidar_ppo import SIZES, save_lidar_planner
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents import make
from pcs_racing_agents.agents.own_code import own_code
from pcs_racing_agents.agents.zoo import load_entrant


def test_a_trained_planner_races_by_its_name_or_its_folder_with_a_hash_of_its_weights(
    spec, tmp_path
):
    shipped = load_entrant("lidar-ppo", spec)
    assert shipped.planner is get_planner("lidar-ppo")
    assert pickle.loads(pickle.dumps(shipped)).planner is shipped.planner
    hashes = {shipped.content_hash, make("pure-pursuit").content_hash}
    # Of one name and parameters: results of one must not be taken for the other's.
    for seed in (0, 1):
        layers = random_layers(*SIZES, seed=seed)
        place = save_lidar_planner(tmp_path / f"{seed}", layers, name="mine", training={})
        own = load_entrant(str(place), spec)
        assert own.name == own.planner.name == str(place)
        hashes.add(own.content_hash)
    assert len(hashes) == 4


def test_planners_numbers_and_modules_that_do_not_exist_name_no_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("lattice.py", "mine.py"):
        (tmp_path / file).write_text("raise AssertionError('it must not run')\n")
    for text in ("lattice:front", "mine:3", "mine.py:3", "no_such_module:mine"):
        assert own_code(text) is None
