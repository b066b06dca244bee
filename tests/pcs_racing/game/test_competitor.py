"""The one way to ask a competitor for its moves, whatever it is, and the names of those that are
known.
"""

import json
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, make_game, parse_policy
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game import competitor as competitors
from pcs_racing.game.competitor import (
    RandomMoves,
    SameMove,
    as_agent,
    ask_moves,
    check_competitor,
    competitor_names,
    is_model,
    make_competitor,
)
from pcs_racing.planners.registry import planner_names

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
    np.testing.assert_array_equal(ask_moves(as_agent(Looks()), game, state, 1, rows=rows), expected)
    np.testing.assert_array_equal(turns[0][0], game.observation(state)[rows, 1])
    assert (turns[0][1].memories, turns[0][1].deterministic) == ([None, None], True)


def test_a_model_keeps_a_state_for_each_game(game, state):
    memories = [None] * GAMES
    for asked in range(2):
        moves = ask_moves(as_agent(Counter()), game, state, 0, memories=memories)
        assert moves.tolist() == [asked] * GAMES
    memories[2] = None  # this game begins again
    moves = ask_moves(as_agent(Counter()), game, state, 0, memories=memories)
    assert moves.tolist() == [2, 2, 0, 2]


def test_functions_and_random_moves_draw_from_the_generator_of_each_game_that_is_not_over(
    game, state
):
    def draws(observation, generator):
        return generator.integers(4)

    expected = [np.random.default_rng(i).integers(4) for i in range(GAMES)]
    for agent in (as_agent(draws), RandomMoves()):
        assert ask_moves(agent, game, state, 0, generators=generators()).tolist() == expected
    assert not ask_moves(as_agent(parse_policy("pure-pursuit")), game, state, 0).any()
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

    refused(
        f"competitor 'fails': {type(error).__name__}",
        ask_moves,
        as_agent(fails),
        game,
        state,
        0,
        generators=generators(),
    )


def test_competitors_are_listed_and_made_by_name(game, monkeypatch):
    """Ours and those of other packages' collections, which are asked last."""
    others = SimpleNamespace(
        names=lambda archive, config: ["mine", "always-mine"],
        make=lambda *given: SameMove("made", given),
    )
    monkeypatch.setattr(competitors, "collections", lambda: [others])
    moves = [f"always-{move}" for move in game.competitor_moves]
    expected = {"never-switch", "random-moves", "mine", *moves, *planner_names()}
    assert competitor_names(game) == sorted(expected)
    for i, name in enumerate(moves):
        assert make_competitor(name.replace(" ", ""), game) == SameMove(name, i)
    assert isinstance(make_competitor("random-moves", game), RandomMoves)
    keeps = make_competitor("never-switch", game)
    assert [policy.name for policy in keeps.policies] == [
        f"default[{i}]" for i in range(len(game.archive))
    ]
    assert make_competitor("lattice:pace=0.25", game).name == "lattice:pace=0.25"
    for name in ("mine", "mine : a=1", "my.zip", "always-mine"):
        assert make_competitor(name, game).move == (name, game.archive, game.config)
    refused("opponent 'yours' is unknown", make_competitor, "yours", game, error=UnknownNameError)


def test_collections_are_modules_and_a_broken_one_is_named(monkeypatch):
    points = [EntryPoint("toys", "json", competitors.ENTRY_POINTS)]
    monkeypatch.setattr(competitors, "_declared", lambda: points)
    assert competitors.collections() == [json]
    points.append(EntryPoint("none", "json.nowhere", competitors.ENTRY_POINTS))
    refused("'none' can't be loaded from json.nowhere", competitors.collections)


def test_who_can_not_take_part_is_refused_before_a_race(game):
    """What a model says of its observations and moves, also one within an agent, is compared with
    the game.
    """
    size, moves = len(game.observation_elements), len(game.competitor_moves)

    def model(shape=(size,), n=moves):
        spaces = {
            "observation_space": SimpleNamespace(shape=shape),
            "action_space": SimpleNamespace(n=n),
        }
        return SimpleNamespace(predict=print, name="net", **spaces)

    def refuse(game):
        raise InputError(f"asked about {game.track.name}")

    fits = model(), model(n=1), model((size,), None), SimpleNamespace(predict=print, model=model())
    for one in (*fits, len):
        check_competitor(game, as_agent(one))
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
        refused(message, check_competitor, game, as_agent(wrong))
    for wrong in (3, SameMove, np.zeros(2)):
        refused("is not a competitor", as_agent, wrong)
    given = model(), len, RandomMoves(), Counter(), SameMove("same", 1)
    names = [as_agent(one).name for one in given]
    assert names == ["net", "len", "random-moves", "Counter", "same"]
    assert [as_agent(as_agent(one), "other").name for one in given] == ["other"] * 5
    assert as_agent(given[-1]) is given[-1]
    space = SimpleNamespace(shape=(2,))
    for candidate, whether in [
        ("a.zip", True),
        (Path("b.zip"), True),
        ("zip", False),
        (Path("a.py"), False),
        (model(), False),
        (SimpleNamespace(predict=print, action_space=space), True),
        (SimpleNamespace(action_space=space), False),
    ]:
        assert is_model(candidate) is whether
