"""Trained planners as competitors."""

import pickle

import pytest
from random_layers import random_layers

from pcs_racing import make_game
from pcs_racing.base.dense import DenseLayers
from pcs_racing.planners.network import INPUTS
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.trained import save_trained
from pcs_racing_agents.agents import make
from pcs_racing_agents.agents.own_code import own_code
from pcs_racing_agents.agents.zoo import load_entrant
from pcs_racing_agents.tournament import cross_pairing, play_pairing


@pytest.fixture(scope="module")
def layers():
    return random_layers(len(INPUTS), 6, 2, seed=1)


def test_a_trained_planner_races_by_its_name_or_its_folder_with_a_hash_of_its_weights(
    layers, spec, tmp_path
):
    shipped = load_entrant("ppo-drive", spec)
    assert shipped.planner is get_planner("ppo-drive")
    assert pickle.loads(pickle.dumps(shipped)).planner is shipped.planner
    hashes = {shipped.content_hash, make("pure-pursuit").content_hash}
    # Of one name and without parameters: results of one must not be taken for the other's.
    for factor in (1.0, 1.5):
        scaled = DenseLayers(tuple(factor * weight for weight in layers.weights), layers.biases)
        place = save_trained(tmp_path / f"{factor}", scaled, name="mine", hold=4, training={})
        own = load_entrant(str(place), spec)
        assert (own.name, own.planner.name) == ("mine", "mine")
        hashes.add(own.content_hash)
    assert len(hashes) == 4


def test_the_shipped_planner_drives_away_from_slower_cars_on_a_held_out_circuit():
    game = make_game("Saltmere", "default", "contest", threads=1)
    # the shipped planner was trained against slower planners
    slow = make("gap-follower:top_speed=5")
    pairing = cross_pairing(game, make("ppo-drive"), slow, egos=1, opponents=1, lines=4, seed=5)
    races = play_pairing(pairing)
    ahead = races.side == 0
    assert ahead.sum() == 4
    assert (races.lead[ahead] > 30.0).all()
    assert not races.crashed[ahead].any()


def test_planners_numbers_and_modules_that_do_not_exist_name_no_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("lattice.py", "mine.py"):
        (tmp_path / file).write_text("raise AssertionError('it must not run')\n")
    for text in ("lattice:front", "mine:3", "mine.py:3", "no_such_module:mine"):
        assert own_code(text) is None
