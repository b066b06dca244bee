import numpy as np
import pytest
from random_layers import random_layers
from refusal import refused

from pcs_racing import InputError, load_game_config, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.agents.blind import always, never_switch, random_moves
from pcs_racing_agents.agents.drivers import planner_driver
from pcs_racing_agents.agents.setting import make_setting
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.learning.responses import ResponseSettings, branch_games, learn_response, merge_networks
from pcs_racing_agents.learning.responses.branches import outcome
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament.games import game_between


@pytest.fixture(scope="module")
def setting():
    return make_setting("default", load_game_config("paper", moves=2, step_seconds=2.0))


@pytest.fixture(scope="module")
def game(setting):
    return make_game("Tarnfjord", setting.archive, setting.config)


def test_a_branch_is_what_comes_of_playing_its_moves(game, setting):
    keys = race_seeds(3, 4)
    stay = never_switch(setting)
    result = branch_games(game, random_moves(setting, seed=1), keys, 1, [stay], stay, payoff="utility")
    # The same by hand: stay, then the move, against the same opponent.
    rival = random_moves(setting, seed=1)
    for move in range(len(game.move_names)):
        state = game.reset(keys)
        for own_move in (len(game.move_names) - 1, move):
            reply, _ = rival.predict(game.observation(state)[:, 1])
            state = game.step(state, np.stack([np.full(4, own_move), reply], axis=1))
        np.testing.assert_array_equal(result.outcomes[:, move], game.reward(state)[result.game, 0])


def test_moves_that_lead_to_the_same_policy_are_driven_once(game, setting):
    asked = []

    class Stays:
        name = "stays"

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            asked.append(len(observation))
            return np.full(len(observation), len(setting.moves) - 1), None

    keys, stay = race_seeds(3, 60), never_switch(setting)
    result = branch_games(game, stay, keys, 0, [stay], Stays(), payoff="utility")
    after = game.next_policy(game.reset(keys).policy[:, :1], np.arange(len(game.move_names)))[result.game]
    assert asked[0] <= sum(len(np.unique(policies)) for policies in after) < after.size
    for policies, outcomes in zip(after, result.outcomes, strict=True):
        for policy in np.unique(policies):
            assert len(np.unique(outcomes[policies == policy])) == 1


def test_branches_do_not_depend_on_the_batch_and_a_driver_may_be_the_opponent(game, setting):
    keys = race_seeds(5, 6)
    rest = ([random_moves(setting), never_switch(setting)], always(setting, "restraint +"))
    rival = random_moves(setting, seed=2)
    whole = branch_games(game, rival, keys, 1, *rest)
    parts = [branch_games(game, rival, keys[k : k + 2], 1, *rest) for k in (0, 2, 4)]
    np.testing.assert_array_equal(whole.outcomes, np.concatenate([piece.outcomes for piece in parts]))
    np.testing.assert_array_equal(whole.observations, np.concatenate([piece.observations for piece in parts]))
    rival = planner_driver(setting, name="lane-switcher")
    game = game_between(game, never_switch(setting), rival)
    result = branch_games(game, rival, race_seeds(0, 3), 0, [never_switch(setting)], never_switch(setting))
    assert result.outcomes.shape == (len(result.game), len(game.move_names))
    assert np.isin(result.outcomes, (0.0, 0.5, 1.0)).all()


def test_a_win_is_1_a_tie_a_half_and_a_crash_that_pays_neither_car_0(game):
    state = game.reset(games=4)
    state.race.progress[:, 0] = state.race.progress[:, 1] + [5.0, -5.0, 0.0, 5.0]
    state.race.crash[3, 1] = 1
    state.step[:] = game.config.moves
    np.testing.assert_array_equal(outcome(game, state), [1.0, 0.0, 0.5, 0.0])
    np.testing.assert_array_equal(outcome(game, state, "utility"), game.reward(state)[:, 0])


def test_impossible_requests_are_refused(game, setting, tmp_path):
    stay = never_switch(setting)
    refused("step is 2", branch_games, game, stay, race_seeds(0, 1), 2, [stay], stay)
    refused("payoff is 'glory'", outcome, game, game.reset(games=1), "glory")
    other = make_game("Tarnfjord", setting.archive, load_game_config(setting.config, moves=3))
    with open_job(tmp_path / "c", "response", {}) as job:
        refused("one of each", learn_response, [game], [], setting, ResponseSettings(), job)
        with pytest.raises(InputError, match="games of 2 moves"):
            learn_response([game, other], [never_switch(setting)], setting, ResponseSettings(), job)


def network(seed: int, hidden: tuple[int, ...] = (5, 4), clipped: bool = False) -> RegretNetwork:
    rng = np.random.default_rng(seed)
    game = GameIdentity(("a", "b", "c"), ("left", "right"), (0.35,), "toy", "0" * 64, "paper")
    layers = random_layers(3, *hidden, 2, seed=seed)
    mean, scale = rng.normal(size=3).astype(np.float32), rng.uniform(0.5, 2.0, 3).astype(np.float32)
    return RegretNetwork(f"net-{seed}", game, "advantage", clipped, layers, mean, scale)


def test_the_merged_network_puts_out_the_mean_of_members_of_one_kind():
    for hidden in [(), (6,), (5, 4), (4, 3, 5)]:
        members = [network(seed, hidden) for seed in range(3)]
        x = np.random.default_rng(9).normal(size=(20, 3))
        merged = merge_networks(members, "merged")
        np.testing.assert_allclose(merged(x), np.mean([m(x) for m in members], axis=0), atol=2e-5)
    merge_networks([network(0, (5, 4)), network(1, (2, 7))], "merged")
    refused("different numbers of layers", merge_networks, [network(0), network(1, (5,))], "merged")
    with pytest.raises(InputError, match="networks 'net-0' and 'net-1' differ in clipped"):
        merge_networks([network(0), network(1, clipped=True)], "merged")
    refused("give at least one", merge_networks, [], "merged")
    refused("mean of clipped networks", merge_networks, [network(0, clipped=True), network(1, clipped=True)], "merged")
