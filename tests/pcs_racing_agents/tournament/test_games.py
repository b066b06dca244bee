from dataclasses import replace

import numpy as np
import pytest

from pcs_racing import InputError, RaceGame, Starts, get_planner
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.competitor import ask_moves
from pcs_racing.race.races import draw_starts
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.blind import always, never_switch, random_moves
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.tournament.games import PlayedGames, play_games

GAMES = 12


@pytest.fixture(scope="module")
def given(contest) -> dict:
    """Starts of some games."""
    rng = np.random.default_rng(3)
    return {
        "policies": rng.integers(0, 12, (GAMES, 2)),
        "starts": draw_starts(contest.track, contest.setup.config, GAMES, 5),
        "seeds": race_seeds(6, GAMES),
    }


@pytest.fixture(scope="module")
def cars(contest):
    setting = make_setting(contest.archive, contest.config)
    return {name: build(name, setting) for name in ("random-moves", "never-switch", "random-policy", "pure-pursuit")}


def some(given: dict, chosen: list[int]) -> dict:
    rows = np.array(chosen, int)
    return {
        "policies": given["policies"][rows],
        "starts": given["starts"].take(rows),
        "seeds": given["seeds"][rows],
    }


def assert_same(found: PlayedGames, expected: PlayedGames, rows) -> None:
    for name in PlayedGames._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[rows], err_msg=name)


def test_a_played_game_is_the_game_that_the_moves_make(contest, cars, given):
    """Played again move by move with the game alone."""
    played = play_games(contest, cars["random-moves"], cars["never-switch"], **given)
    state = contest.reset(given["seeds"], policies=given["policies"], starts=given["starts"])
    for step in range(4):
        np.testing.assert_array_equal(state.policy[~contest.done(state)], played.policy[~contest.done(state), :, step])
        state = contest.step(state, np.maximum(played.moves[:, :, step], 0))
    np.testing.assert_array_equal(played.lead, state.race.lead)
    np.testing.assert_array_equal(played.winner, contest.winner(state))
    np.testing.assert_array_equal(played.utility, contest.reward(state)[:, 0])
    np.testing.assert_array_equal(played.observations, contest.observation(state))
    assert (played.moves[:, 1][played.moves[:, 1] >= 0] == 4).all()
    assert len(set(played.moves[:, 0].ravel().tolist())) > 3
    crashed = played.crash.any(axis=1)
    assert (played.duration[~crashed] == 4.0).all()
    assert (played.duration[crashed] < 4.0).all()
    assert ((played.policy >= 0).sum(axis=2)[~crashed] == 5).all()


@pytest.mark.parametrize(
    "pair",
    [
        ("random-moves", "random-moves"),
        ("random-moves", "pure-pursuit"),
        ("random-policy", "random-moves"),
        ("pure-pursuit", "random-policy"),
    ],
)
def test_what_comes_of_a_game_depends_on_the_game_alone(contest, cars, given, pair):
    ego, opponent = (cars[name] for name in pair)
    selected = given | {
        "policies": np.minimum(given["policies"], [0 if name == "pure-pursuit" else 11 for name in pair])
    }
    together = play_games(contest, ego, opponent, **selected)
    for rows in ([0], [7, 3], [11, 0, 5]):
        assert_same(play_games(replace(contest, threads=1), ego, opponent, **some(selected, rows)), together, rows)
    drivers = [name in ("random-policy", "pure-pursuit") for name in pair]
    assert ((together.moves < 0).all(axis=(0, 2)) == drivers).all()
    assert ((together.policy < 0).all(axis=(0, 2)) == drivers).all()


def test_batches_are_cut_without_a_trace(contest, cars, given, monkeypatch):
    whole = play_games(contest, cars["random-moves"], cars["random-moves"], **given)
    monkeypatch.setattr("pcs_racing_agents.tournament.games.BATCH", 5)
    assert_same(play_games(contest, cars["random-moves"], cars["random-moves"], **given), whole, slice(None))
    none = play_games(contest, cars["random-moves"], cars["random-moves"], **some(given, []))
    assert none.lead.shape == (0,)
    assert none.policy.shape == (0, 2, 5)


def test_arms_share_everything_until_their_moves_differ(contest, cars, given):
    """Common random numbers: an ego that stays and one that moves see the same first step."""
    stay, move = (
        play_games(contest, cars[name], cars["random-moves"], **given) for name in ("never-switch", "random-moves")
    )
    block = 6
    np.testing.assert_array_equal(stay.observations[:, :, :block], move.observations[:, :, :block])
    np.testing.assert_array_equal(stay.noise, move.noise)
    assert (stay.lead != move.lead).any()


def test_stay_is_a_move_for_everybody(game, given):
    """Also where the rules do not offer it; who does not know it is not changed by that."""
    bare = replace(game, config=replace(game.config, stay=False))
    setting = make_setting(game.archive, bare.config)
    played = play_games(bare, never_switch(setting), always(setting, "restraint -"), **given)
    assert set(played.moves[:, 0].ravel().tolist()) <= {4, -1}
    assert (np.sort(played.policy, axis=2)[:, 0, -1] == played.policy[:, 0, 0]).all()


def test_the_score_counts_wins_and_half_of_the_ties(contest, cars, given):
    played = play_games(contest, cars["random-moves"], cars["never-switch"], **some(given, [0, 1, 2, 3]))
    made_up = played._replace(
        winner=np.array([0, 1, -1, -1], np.int8), crash=np.array([[0, 0], [0, 0], [0, 0], [2, 2]], np.int8)
    )
    np.testing.assert_array_equal(made_up.score, [1.0, 0.0, 0.5, 0.0])
    np.testing.assert_array_equal(made_up.tie, [False, False, True, False])


class Counter:
    """A model with a memory: its move is how often it was asked."""

    name = "counter"

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.zeros(len(observation), int) if state is None else state
        state = np.where(episode_start, 0, state + 1)
        return state, state


class Looker:
    """Decides by the state of the game."""

    name = "looker"

    def __init__(self) -> None:
        self.asked: list[int] = []

    def decide(self, game, state, car):
        assert not game.done(state).any()
        self.asked.append(state.games)
        return np.where(state.race.lead > 0.0, 1, 3) if car == 0 else np.zeros(state.games, int)


def test_models_with_a_memory_and_deciders(contest, cars, given):
    played = play_games(contest, Counter(), cars["never-switch"], **given)
    for moves in played.moves[:, 0]:
        steps = [move for move in moves.tolist() if move >= 0]
        assert steps == list(range(len(steps)))
    looker = Looker()
    played = play_games(contest, looker, cars["never-switch"], **given)
    assert looker.asked[0] == (played.moves[:, 0, 0] >= 0).sum()
    assert set(played.moves[:, 0].ravel().tolist()) <= {1, 3, -1}


def test_moves_of_one_car(contest, cars):
    state = contest.reset(games=5, seed=1)
    moves = ask_moves(cars["random-moves"], contest, state, 1)
    np.testing.assert_array_equal(moves, cars["random-moves"].predict(contest.observation(state)[:, 1])[0])
    assert (ask_moves(cars["pure-pursuit"], contest, state, 1) == 0).all()


class Wrong:
    name = "wrong"

    def __init__(self, answer) -> None:
        self.answer = answer

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.answer(len(observation)), None


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda n: np.full(n, 5), "competitor 'wrong': game 0: move 5"),
        (lambda n: np.full(n, -1), r"move -1"),
        (lambda n: np.zeros(n), r"shape \(12,\) and type float64"),
        (lambda n: np.zeros(n + 1, int), "predict returned"),
        (lambda n: 0, "predict returned"),
    ],
)
def test_wrong_moves_are_refused(contest, cars, given, answer, message):
    with pytest.raises(InputError, match=message):
        play_games(contest, Wrong(answer), cars["never-switch"], **given)


class Narrow:
    """A model that was trained on another observation."""

    class observation_space:  # noqa: N801
        shape = (7,)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        raise AssertionError("must not be asked")


def test_what_does_not_fit_is_refused_before_the_first_race(contest, game, cars, given, monkeypatch):
    monkeypatch.setattr(RaceGame, "reset", lambda *_, **__: pytest.fail("a race was driven"))
    stay, lattice = cars["never-switch"], get_planner("lattice").policy()
    with pytest.raises(InputError, match=r"competitor 'Narrow' takes observations of shape \(7,\)"):
        play_games(contest, Narrow(), stay, **given)
    for change, message in [
        ({"policies": np.full((GAMES, 2), 12)}, "game 0: the ego's variant is 12"),
        ({"policies": np.zeros((3, 2), int)}, r"policies of shape \(3, 2\)"),
        ({"policies": np.zeros((GAMES, 2))}, "must be whole numbers"),
        ({"seeds": race_seeds(0, 3)}, r"seeds of shape \(3,\)"),
    ]:
        with pytest.raises(InputError, match=message):
            play_games(contest, stay, stay, **(given | change))
    with pytest.raises(InputError, match="game 0: the opponent's variant is 1"):
        play_games(contest, stay, lattice, **(given | {"policies": np.ones((GAMES, 2), int)}))
    with pytest.raises(InputError, match="can't race"):
        play_games(contest, stay, "never-switch", **given)
    assert isinstance(given["starts"], Starts)
    assert random_moves(make_setting(game.archive, game.config)).setting.offered == 5
