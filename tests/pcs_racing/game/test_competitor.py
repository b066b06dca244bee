"""The one way to ask a competitor for its moves, whatever it is."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import make_game, parse_policy
from pcs_racing.game.competitor import PolicySet, RandomMoves, SameMove, ask_moves

GAMES = 4


@pytest.fixture(scope="module")
def game():
    return make_game("Tarnfjord", step_seconds=1.0)


@pytest.fixture(scope="module")
def state(game):
    return game.reset(np.arange(GAMES))


def generators():
    return [np.random.default_rng(i) for i in range(GAMES)]


class Counter:
    """A predictor that remembers how often it was asked in a game: its move is that number."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        asked = 0 if state is None else state
        assert (asked == 0) == episode_start.all()
        return np.full(len(observation), asked), asked + 1


class Chooses:
    """It chooses a policy before each race of a match, and makes no moves in it."""

    def choose(self, observation):
        return np.zeros(len(observation))


class ChoosesAndMoves(Chooses, SameMove):
    """It does both."""


def test_a_predictor_sees_what_its_car_observes_and_keeps_a_state_for_each_game(game, state):
    seen = []

    class Looks:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            seen.append((observation, deterministic))
            return np.arange(len(observation)), None

    assert ask_moves(Looks(), game, state, 1).tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(seen[0][0], game.observation(state)[:, 1])
    assert seen[0][1]  # its best move, unless a draw is asked for
    memories = [None] * GAMES
    for asked in range(2):
        assert ask_moves(Counter(), game, state, 0, memories=memories).tolist() == [asked] * GAMES
    memories[2] = None  # this game begins anew
    assert ask_moves(Counter(), game, state, 0, memories=memories).tolist() == [2, 2, 0, 2]


def test_a_decider_gets_the_games_it_is_asked_about_and_who_only_chooses_stays(game, state):
    class Decides:
        name = "decides"

        def decide(self, game, state, car):
            return state.policy[:, car] % 2

    rows = np.array([1, 3])
    expected = np.zeros(GAMES, int)
    expected[rows] = state.policy[rows, 1] % 2
    np.testing.assert_array_equal(ask_moves(Decides(), game, state, 1, rows=rows), expected)
    stay = len(game.competitor_moves) - 1
    assert game.competitor_moves[stay] == "stay"
    assert ask_moves(Chooses(), game, state, 0).tolist() == [stay] * GAMES
    assert ask_moves(ChoosesAndMoves("both", 1), game, state, 0).tolist() == [1] * GAMES


def test_functions_and_random_moves_draw_from_the_generator_of_each_game_that_is_not_over(game, state):
    def draws(observation, generator):
        return generator.integers(4)

    expected = [np.random.default_rng(i).integers(4) for i in range(GAMES)]
    assert ask_moves(draws, game, state, 0, generators=generators()).tolist() == expected
    assert ask_moves(RandomMoves(), game, state, 0, generators=generators()).tolist() == expected
    policy = parse_policy("pure-pursuit")
    for driver in (policy, PolicySet("driver", (policy,))):
        assert not ask_moves(driver, game, state, 0).any()
    over = state.copy()
    over.race.crash[1] = 2
    assert ask_moves(SameMove("first", 3), game, over, 0).tolist() == [3, 0, 3, 3]


@pytest.mark.parametrize("answer", [4.5, 99, -1, "left", None])
def test_an_impossible_answer_names_who_gave_it(game, state, answer):
    refused(r"competitor 'poor'", ask_moves, SameMove("poor", answer), game, state, 0)


@pytest.mark.parametrize("error", [RuntimeError("lost"), SystemExit(0), AssertionError()])
def test_whatever_a_competitor_raises_is_one_line(game, state, error):
    def fails(observation, rng):
        raise error

    refused(f"competitor 'fails': {type(error).__name__}", ask_moves, fails, game, state, 0, generators=generators())
