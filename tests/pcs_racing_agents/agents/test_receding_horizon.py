from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from zoo_games import untrained

from pcs_racing import CONTEST, GameConfig, InputError, RaceGame, UnknownNameError, get_planner
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.state import put_games, take_games
from pcs_racing_agents.agents import Decider, make_setting, parse_agent
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.lookahead import guess_games, look_ahead, merge_histories, root_games, search_game
from pcs_racing_agents.agents.receding_horizon import receding_horizon
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.solvers import GameTree, solve_exact

STAY = 4
NOISY = GameConfig(race=replace(CONTEST, steering_noise=0.03), step_seconds=0.8, epsilon=0.5, utility="lead-at-crash")


@pytest.fixture(scope="module")
def noisy(oval, archive) -> RaceGame:
    """The contest's rules, with more noise."""
    return RaceGame(oval, archive, NOISY)


def some_games(game: RaceGame, games: int = 6, seed: int = 1, moves: int = 1):
    """Games in which both players have moved at random."""
    rng = np.random.default_rng(seed)
    state = game.reset(games=games, seed=seed)
    for _ in range(moves):
        state = game.step(state, rng.integers(0, len(game.move_names), (games, 2)))
    return state


def test_merged_histories_are_those_of_the_same_policies_in_small_games():
    table = np.array([[1, 1, 0], [0, 2, 2], [2, 2, 2]])
    for policy, same in enumerate(zip(*merge_histories(table, np.arange(3), 2), strict=True)):
        paths = [(table[policy, a], table[table[policy, a], b]) for a in range(3) for b in range(3)]
        np.testing.assert_array_equal(same[2], [paths.index(path) for path in paths])
    np.testing.assert_array_equal(same[2], np.zeros(9))  # from policy 2 nothing leads away
    rng = np.random.default_rng(0)
    payoffs = rng.normal(size=(2, 3, 2, 3, 2))  # moves of car 0 and car 1 in turn
    tree = solve_exact(GameTree.from_payoffs(payoffs[0]))
    histories = payoffs.reshape(2, 3, 2, 3, 2).transpose(0, 1, 3, 2, 4).reshape(2, 9, 4)
    games = root_games(histories, (3, 2), 2)
    np.testing.assert_allclose(games[0].reshape(-1), tree.node_values[1], atol=1e-12)
    best_reply = root_games(histories[:, :, :1], (3, 1), 2)
    np.testing.assert_array_equal(best_reply[:, :, 0], payoffs[:, :, 0, :, 0].max(axis=2))


@pytest.mark.parametrize("car", [0, 1])
def test_what_is_looked_ahead_is_the_game_itself(game, car):
    """Every pair of histories leads where the game leads that is played move by move."""
    state = some_games(game)
    guess = guess_games(game, game, state, car, state.race.seed)
    moves = np.arange(5)
    payoffs = look_ahead(game, guess, car, (moves, moves), 2, "rollout", lambda _, end, car: end.race.lead)
    assert payoffs.shape == (6, 25, 25)
    rng = np.random.default_rng(3)
    for _ in range(4):
        plan = rng.integers(0, 5, (2, 2))  # of car 0 and of car 1
        end = guess
        for move in (*plan.T, (STAY, STAY)):
            end = game.step(end, np.tile(move, (6, 1)))
        own, other = plan[car], plan[1 - car]
        np.testing.assert_array_equal(payoffs[:, own[0] * 5 + own[1], other[0] * 5 + other[1]], end.race.lead)


def test_a_look_at_the_next_step_is_the_best_reply_to_a_static_opponent(game, setting):
    state = some_games(game)
    guess = guess_games(game, game, state, 0, state.race.seed)
    moves = np.arange(5), np.array([STAY])
    payoffs = look_ahead(game, guess, 0, moves, 1, "now", lambda _, end, car: end.race.lead)
    for move in range(5):
        after = game.step(guess, np.tile([move, STAY], (6, 1)))
        np.testing.assert_array_equal(payoffs[:, move, 0], after.race.lead)
    # With the last move at hand, the move that is made pays most of all in the game as it is guessed.
    agent = receding_horizon(setting)
    state = some_games(game, games=12, moves=3)
    games, _ = agent.root_games(game, state, 1)
    guess = guess_games(game, game, state, 1, state.race.seed)
    paid = [game.reward(game.step(guess, np.tile([STAY, move], (12, 1))))[:, 1] for move in range(5)]
    running = ~game.done(state)
    np.testing.assert_array_equal(games[running, :, 0], np.stack(paid, axis=1)[running])
    selected = agent.decide(game, state, 1)
    best = np.max(paid, axis=0)
    np.testing.assert_allclose(np.stack(paid, axis=1)[np.arange(12), selected][running], best[running], atol=1e-6)


@pytest.mark.parametrize("options", [{"depth": 2}, {"opponent": "equilibrium", "decision": "sample"}])
@pytest.mark.parametrize("car", [0, 1])
def test_it_does_not_know_what_can_not_be_seen(noisy, archive, options, car):
    """The opponent's policy, its plans, and the noise to come may be any others: it decides alike."""
    agent = receding_horizon(make_setting(archive, NOISY), noises=2, **options)
    state = some_games(noisy)
    other = 1 - car
    hidden = state.copy()
    hidden.policy[:, other] = 11 - hidden.policy[:, other]
    hidden.theta[:, other] += 0.1
    hidden.own[:, other] = 0.3
    hidden.race.seed[:] += np.uint64(7)
    for array in (hidden.race.memory, hidden.race.path, hidden.race.command):
        array[:, other] += 0.1
    hidden.race.disturbance[:] = -0.02
    result, expected = (agent.root_games(noisy, games, car)[0] for games in (hidden, state))
    np.testing.assert_array_equal(result, expected)
    assert np.ptp(expected, axis=1).max() > 0.0
    faster = state.copy()
    faster.race.cars[:, other, 3] += 0.5
    assert (agent.root_games(noisy, faster, car)[0] != expected).any()


def test_two_views_of_a_network(game, setting):
    """What a situation is worth to one car it is not to the other."""
    network = untrained(setting, "static-q")
    agent = receding_horizon(setting, leaf="network", network=network)
    state = some_games(game)
    first, second = (agent._value(game, state, car) for car in range(2))
    np.testing.assert_array_equal(first, -second)
    running = ~game.done(state)
    best = network(game.observation(state)).max(axis=2)
    np.testing.assert_allclose(first[running], 0.5 * (best[:, 0] - best[:, 1])[running], rtol=1e-5)
    hidden = state.copy()  # the network sees own policies: the opponent's is only guessed
    hidden.own[:, 1] = 0.3
    hidden.policy[:, 1] = 0
    np.testing.assert_array_equal(agent.root_games(game, hidden, 0)[0], agent.root_games(game, state, 0)[0])


@pytest.mark.parametrize(
    "options",
    [{"depth": 2}, {"leaf": "now", "depth": 3}, {"opponent": "equilibrium", "decision": "sample", "noises": 2}],
)
def test_every_game_is_decided_by_itself(noisy, archive, options):
    agent = receding_horizon(make_setting(archive, NOISY), seed=5, **options)
    state = noisy.reset(games=9)
    for moves, seed in enumerate((1, 2, 3)):
        put_games(state, np.arange(3) + 3 * moves, some_games(noisy, 3, seed, moves))
    together = agent.decide(noisy, state, 0)
    order = np.array([8, 0, 4, 4, 2])
    np.testing.assert_array_equal(agent.decide(noisy, take_games(state, order), 0), together[order])
    alone = [agent.decide(replace(noisy, threads=1), take_games(state, [i]), 0)[0] for i in range(9)]
    np.testing.assert_array_equal(alone, together)
    assert agent.decide(noisy, take_games(state, np.arange(0)), 0).shape == (0,)


def test_noise_is_averaged_over(noisy, game, archive, setting):
    """Its own noise, as its seed says; without any the same is found however often it looks."""
    rough = make_setting(archive, NOISY)
    state = some_games(noisy)
    first, second, other = (
        receding_horizon(rough, seed=seed, noises=noises).root_games(noisy, state, 0)[0]
        for seed, noises in ((0, 1), (0, 2), (1, 1))
    )
    assert (first != second).any()
    assert (first != other).any()
    assert receding_horizon(rough).noises == 4
    assert receding_horizon(setting).noises == 1
    calm = some_games(game)
    once, twice = (receding_horizon(setting, noises=n).root_games(game, calm, 0)[0] for n in (1, 2))
    np.testing.assert_array_equal(once, twice)


def test_of_races_won_alike_the_clearer_one_and_never_a_move_that_is_not_offered(game, archive):
    """Where only winning counts, the lead decides between equals, and never more."""
    winning = replace(game, config=replace(game.config, utility="win"))
    agent = receding_horizon(make_setting(archive, winning.config))
    state = some_games(winning, moves=3)
    values = agent.root_games(winning, state, 0)[0][:, :, 0]
    guess = guess_games(winning, winning, state, 0, state.race.seed)
    ends = [winning.step(guess, np.tile([move, STAY], (6, 1))) for move in range(5)]
    won = np.stack([winning.reward(end)[:, 0] for end in ends], axis=1)
    lead = np.stack([end.race.lead for end in ends], axis=1)
    np.testing.assert_array_equal(np.round(values), won)
    selected = agent.decide(winning, state, 0)
    for row in np.flatnonzero(~winning.done(state)):
        assert won[row, selected[row]] == won[row].max()
        assert lead[row, selected[row]] >= lead[row, won[row] == won[row].max()].max() - 1e-5
    state = some_games(winning)  # with moves left, the lead stands for the chance to win
    early = receding_horizon(make_setting(archive, winning.config), leaf="now").root_games(winning, state, 0)[0]
    after = winning.step(guess_games(winning, winning, state, 0, state.race.seed), np.full((6, 2), STAY))
    lead, running = after.race.lead / LEAD_SCALE, ~winning.done(after)
    assert lead[running].min() < 0.0
    np.testing.assert_allclose(early[running, STAY, 0], np.clip(lead, -1.0, 1.0)[running], atol=1e-6)
    # Played where the rules do not offer it, it makes the moves that there are.
    strict = replace(game, config=replace(game.config, stay=False))
    agent = receding_horizon(make_setting(archive, strict.config))
    state = some_games(strict)
    assert agent.root_games(strict, state, 0)[0].shape == (6, 4, 1)
    assert (agent.decide(strict, state, 0) < 4).all()
    assert search_game(strict).config.stay


def test_by_name(setting):
    created = parse_agent("receding-horizon:depth=2,opponent=equilibrium", setting, seed=4)
    assert isinstance(created, Decider)
    assert created.name == "receding-horizon:depth=2,opponent=equilibrium"
    same = receding_horizon(setting, depth=2, opponent="equilibrium", seed=4)
    assert competitor_hash(created) == competitor_hash(same)
    for other in ({"seed": 5}, {"depth": 3}, {"leaf": "now"}, {"decision": "sample"}, {"noises": 2}):
        assert competitor_hash(replace(same, **other)) != competitor_hash(same), other


def test_impossible_options(setting):
    for options, message in [
        ({"depth": 0}, "the depth of agent 'receding-horizon' is 0"),
        ({"seed": -1}, "the seed of agent 'receding-horizon' is -1"),
        ({"leaf": "lead"}, "'lead'; it must be one of rollout, now, network"),
        ({"opponent": ["static"]}, "it must be one of static, equilibrium"),
        ({"depth": 4, "opponent": "equilibrium"}, "make its depth 4 or its noises 1 smaller"),
        ({"network": "out/net"}, "only leaf 'network' asks one"),
    ]:
        refused(message, receding_horizon, setting, **options)


def test_networks_and_games_that_do_not_fit_are_refused(setting, archive, game):
    with pytest.raises(InputError, match=r"has target 'regret', .* must be 'static-q'"):
        receding_horizon(setting, leaf="network", network=untrained(setting, "regret"))
    with pytest.raises(UnknownNameError, match=r"network, .*'toy-paper-static-q'"):
        build("receding-horizon", setting, leaf="network")
    faster = make_setting(archive, replace(setting.config, moves=9, step_seconds=0.4))
    refused("sees 31", receding_horizon, faster, leaf="network", network=untrained(setting, "static-q"))
    agent = receding_horizon(setting)
    longer = replace(game, config=replace(game.config, moves=5))
    refused("games of 4 moves", agent.decide, longer, longer.reset(games=1), 0)
    driver = get_planner("pure-pursuit").policy()
    outside = replace(game, opponent_planner="pure-pursuit")
    state = outside.reset(games=2, opponents=driver)
    refused(r"car 1 of game 0, .*outside", agent.decide, outside, state, 1)
