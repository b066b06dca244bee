"""Players of the game: constant players, agents of models and functions, moves on request."""

from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, make_game, racer
from pcs_racing.game.players import (
    ConstantPlayer,
    always,
    ask_moves,
    check_competitor,
    competitor,
    draw,
    hash_rows,
    random_moves,
)
from pcs_racing.planners.planner import PolicySet

GAMES = 4


@pytest.fixture(scope="module")
def game():
    return make_game("Tarnfjord", steps=(1.0,) * 5)


@pytest.fixture(scope="module")
def state(game):
    return game.reset(np.arange(GAMES))


class Counter:
    """A model that remembers how often it was asked in a game: its move is that number."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        asked = 0 if state is None else state
        assert (asked == 0) == episode_start.all()
        return np.full(len(observation), asked), asked + 1


def test_an_agent_sees_what_its_car_observes_and_the_games_behind(game, state):
    turns = []

    class Looks:
        def act(self, observations, turn):
            turns.append((observations, turn))
            return turn.state.policy[:, turn.car] % 2

    rows = np.array([1, 3])
    expected = np.zeros(GAMES, int)
    expected[rows] = state.policy[rows, 1] % 2
    moves = ask_moves(competitor(Looks(), game, name="looks"), game, state, 1, rows=rows)
    np.testing.assert_array_equal(moves, expected)
    np.testing.assert_array_equal(turns[0][0], game.observation(state)[rows, 1])
    assert (turns[0][1].memories, turns[0][1].deterministic) == ([None, None], True)


def test_a_model_keeps_a_state_for_each_game(game, state):
    memories, agent = [None] * GAMES, competitor(Counter(), game)
    for asked in range(2):
        moves = ask_moves(agent, game, state, 0, memories=memories)
        assert moves.tolist() == [asked] * GAMES
    memories[2] = None  # this game begins again
    assert ask_moves(agent, game, state, 0, memories=memories).tolist() == [2, 2, 0, 2]
    asked = []
    plain = SimpleNamespace(predict=lambda seen, *_: (asked.append(seen) or [1] * len(seen), None))
    assert ask_moves(competitor(plain, game), game, state, 0).tolist() == [1] * GAMES
    assert len(asked) == 1  # for all games, since it has no state


def test_a_function_draws_by_the_key_the_step_and_the_car_of_each_game(game, state):
    def draws(observation, generator):
        return generator.integers(4)

    agent = competitor(draws, game)
    keys = state.race.seed.tolist()
    for car in range(2):
        expected = [np.random.default_rng([key, 0, car]).integers(4) for key in keys]
        assert ask_moves(agent, game, state, car).tolist() == expected
    assert not ask_moves(competitor("pure-pursuit", game), game, state, 0).any()
    over = state.copy()
    over.race.crash[1] = 2
    first = always(game, game.moves[3])
    assert ask_moves(first, game, over, 0).tolist() == [3, 0, 3, 3]


def test_random_moves_are_the_offered_moves_drawn_by_observation_and_seed(game, state):
    agent = random_moves(game)
    assert agent.chances == (0.25, 0.25, 0.25, 0.25, 0.0)  # the paper's rules offer no "stay"
    rows = np.random.default_rng(0).normal(size=(400, 31)).astype(np.float32)
    moves = agent.act(rows)
    assert len(set(moves.tolist())) == 4
    np.testing.assert_array_equal(agent.act(rows[::-1])[::-1], moves)
    np.testing.assert_array_equal([int(agent.act(row[None])[0]) for row in rows], moves)
    assert 0.1 < np.mean(random_moves(game, seed=5).act(rows) == moves) < 0.4


def splitmix(number):
    """The output function of splitmix64 (Steele and others, 2014)."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        number %= 2**64
        number = (number ^ (number >> shift)) * factor
    number %= 2**64
    return number ^ (number >> 31)


def test_draws_follow_the_chances_and_rounding_never_draws_what_is_impossible():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(20_000, 31)).astype(np.float32)
    chances = np.tile([0.1, 0.0, 0.6, 0.3, 0.0], (20_000, 1))
    share = np.bincount(draw(chances, rows, 0), minlength=5) / 20_000
    np.testing.assert_allclose(share, chances[0], atol=0.02)
    assert share[1] == share[4] == 0.0
    # A change in the last bit of one number is another situation.
    changed = rows.copy()
    changed[:, 17] = np.nextafter(rows[:, 17], np.float32(np.inf))
    assert abs(np.mean(draw(chances, changed, 0) == draw(chances, rows, 0)) - 0.46) < 0.02
    assert len(np.unique(hash_rows(rows, 0))) == 20_000
    # By definition: the words of a row one after the other.
    golden, state = 0x9E3779B97F4A7C15, splitmix(8 * 0x9E3779B97F4A7C15)
    for word in rows[0].view(np.uint32).tolist():
        state = splitmix((state ^ word) + golden)
    assert int(hash_rows(rows[:1], 7)[0]) == state
    assert int(draw(np.full((1, 2**20), 2.0**-20), rows[:1], 7)[0]) == state >> 44
    zeros = np.zeros((1, 3), np.float32)
    np.testing.assert_array_equal(hash_rows(zeros, 1), hash_rows(-zeros, 1))
    # Chances that add up to a bit less or more than 1.
    rows = np.random.default_rng(1).normal(size=(5000, 2)).astype(np.float32)
    for chances in (
        [0.0, 1.0 - 1e-16, 0.0],
        [0.3, 0.3, 0.4 - 1e-12],
        [0.0, 1e-300, 0.0],
        [5e-324, 0.0],
        [0.1] * 10,
    ):
        assert (np.array(chances)[draw(np.tile(chances, (5000, 1)), rows, 3)] > 0.0).all()


@pytest.mark.parametrize("answer", [4.5, 99, -1, "left", None])
def test_an_impossible_answer_names_who_gave_it(game, state, answer):
    poor = SimpleNamespace(name="poor", act=lambda observations, turn: [answer] * GAMES)
    refused(r"competitor 'poor'", ask_moves, poor, game, state, 0)


@pytest.mark.parametrize("error", [RuntimeError("lost"), SystemExit(0), AssertionError()])
def test_any_error_of_a_competitor_is_one_line(game, state, error):
    def fails(observation, rng):
        raise error

    message = f"competitor 'fails': {type(error).__name__}"
    refused(message, ask_moves, competitor(fails, game), game, state, 0)


def test_a_competitor_that_does_not_fit_the_game_is_refused_before_a_race(game):
    """The spaces of a model, also within an agent, are compared with the game."""
    size, moves = len(game.observation_elements), len(game.moves)

    def model(shape=(size,), n=moves):
        spaces = {
            "observation_space": SimpleNamespace(shape=shape),
            "action_space": SimpleNamespace(n=n),
        }
        return SimpleNamespace(predict=print, name="net", **spaces)

    def refuse(game):
        raise InputError(f"asked about {game.track.name}")

    fits = model(), model(n=1), model((size,), None), SimpleNamespace(predict=print, model=model())
    for one in fits:
        check_competitor(game, competitor(one, game))
    for wrong, message in [
        (
            model((size + 1,)),
            rf"'net' takes observations of shape \({size + 1},\); .* have shape \({size},\)",
        ),
        (
            model(n=moves + 1),
            rf"'net' has {moves + 1} moves; this game has {moves} \(aggressiveness \+, ",
        ),
        (SimpleNamespace(predict=print, model=model((1,))), r"shape \(1,\)"),
        (SimpleNamespace(predict=print, check_fits=refuse), "asked about Tarnfjord"),
    ]:
        refused(message, check_competitor, game, competitor(wrong, game))
    refused(
        "'few' has 2 moves; this game has 5",
        check_competitor,
        game,
        ConstantPlayer("few", (0.5, 0.5)),
    )


def test_policies_of_a_set_share_a_planner():
    lattice, pursuit = racer("lattice"), racer("pure-pursuit")
    assert PolicySet("d", [lattice]).policies == (lattice,)  # no list that a caller may change
    refused("'d' has no policy", PolicySet, "d", ())
    refused("one planner", PolicySet, "d", (lattice, pursuit))
