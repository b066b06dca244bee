"""What an agent loses to an opponent that knows it, found by playing it against every sequence of moves."""

import numpy as np
import pytest
from zoo_games import untrained

from pcs_racing import InputError, make_game
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.networks.metrics import play_profile, score_tree
from pcs_racing_agents.tournament.best_response import best_response_utility
from pcs_racing_agents.trees import build_tree

POLICIES = np.array([4, 6])


@pytest.fixture(scope="module")
def game(oval, archive):
    return make_game(oval, archive, "contest", stay=False, moves=2, step_seconds=0.8)


@pytest.fixture(scope="module")
def start(game) -> Starts:
    return Starts(game.start_lines[:1], np.array([1]))


@pytest.mark.parametrize("seeds", [[3], [3, 4, 9]])
def test_it_is_what_the_game_tree_says(game, start, seeds):
    """Of an agent that never stays: half the NashConv, and what random moves leave."""
    setting = make_setting(game.archive, game.config)
    agent = build("cfr-argmax", setting, network=untrained(setting, stay=False))
    found = [best_response_utility(game, agent, policies=POLICIES, start=start, seeds=seeds, car=car) for car in (0, 1)]
    tree = build_tree(game, POLICIES, start, seeds)
    judged = score_tree(play_profile(lambda seen: agent.probabilities(seen)[:, :-1], tree), tree)
    assert -0.5 * (found[0].best + found[1].best) == pytest.approx(judged.lost_to_best_response, abs=1e-5)
    assert 0.5 * (found[0].random + found[1].random) == pytest.approx(judged.against_random, abs=1e-5)


def test_agents_that_stay_are_judged(game, start):
    """Nobody can reply better to who never switches than by the best of all plans: without noise, of 16."""
    calm = make_game(game.track, game.archive, "paper", moves=2, step_seconds=0.8)
    setting = make_setting(calm.archive, calm.config)
    found = best_response_utility(calm, build("never-switch", setting), policies=POLICIES, start=start, seeds=[0])
    arena = make_game(game.track, game.archive, "paper", stay=True, moves=2, step_seconds=0.8)
    state = arena.reset(np.zeros(16, np.uint64), policies=POLICIES, starts=start.take(np.zeros(16, int)))
    for replies in np.indices((4, 4)).reshape(2, -1):
        state = arena.step(state, np.stack([np.full(16, 4), replies], axis=1))
    worth = arena.reward(state)[:, 0]
    assert found.best == pytest.approx(worth.min())
    assert found.random == pytest.approx(worth.mean())


def test_who_makes_no_moves_can_not_be_judged(game, start):
    setting = make_setting(game.archive, game.config)
    with pytest.raises(InputError, match="'lane-switcher' is a driver and makes no moves"):
        best_response_utility(game, build("lane-switcher", setting), policies=POLICIES, start=start, seeds=[0])
    with pytest.raises(InputError, match="car is 2"):
        best_response_utility(game, build("never-switch", setting), policies=POLICIES, start=start, seeds=[0], car=2)
