"""Several egos in the same games against one opponent: the same results, in fewer drives."""

from dataclasses import dataclass

import numpy as np
import pytest

from pcs_racing import InputError, RaceGame, load_race_config, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.races import draw_starts
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.blind import always, best_fixed, random_moves
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.tournament.games import PlayedGames, play_each, play_games

GAMES = 12


class Counter:
    """A model that counts in its memory, in place, how often it was asked; its move is that number."""

    name = "counter"

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.zeros(len(observation), int) if state is None else state
        state += ~np.asarray(episode_start)
        return state.copy(), state


@dataclass(frozen=True)
class Leader:
    """Decides by the state of the game: another move for the car in front."""

    name: str = "leader"

    def decide(self, game, state, car):
        return np.where((state.race.lead > 0.0) == (car == 0), 1, 3)


@pytest.fixture(scope="module")
def contest(oval, archive) -> RaceGame:
    """Games with short steps, so disturbed that some end in a crash."""
    return make_game(oval, archive, load_race_config("contest", steering_noise=0.2), step_seconds=0.8)


@pytest.fixture(scope="module")
def given(contest) -> dict:
    """Starts of some games; a driver has one variant, the first."""
    return {
        "policies": np.stack([np.random.default_rng(3).integers(0, 12, GAMES), np.zeros(GAMES, int)], axis=1),
        "starts": draw_starts(contest.track, contest.setup.config, GAMES, 5),
        "seeds": race_seeds(6, GAMES),
    }


@pytest.fixture(scope="module")
def zoo(contest) -> dict:
    setting = make_setting(contest.archive, contest.config)
    named = {name: build(name, setting) for name in ("random-moves", "never-switch", "pure-pursuit")}
    named["best-fixed"] = best_fixed(setting, target=3)
    for move in ("aggressiveness +", "restraint -"):
        named[move] = always(setting, move)
    return {**named, "other random moves": random_moves(setting, seed=9), "counter": Counter(), "leader": Leader()}


EGOS = ("never-switch", "random-moves", "aggressiveness +", "leader", "counter", "other random moves", "best-fixed")


def assert_same(found: PlayedGames, expected: PlayedGames) -> None:
    for name in PlayedGames._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("opponent", ["never-switch", "random-moves", "pure-pursuit", "counter", "leader"])
def test_games_of_several_egos_are_those_of_each_alone(contest, zoo, given, opponent):
    together = play_each(contest, [zoo[name] for name in EGOS], zoo[opponent], **given)
    assert len(together) == len(EGOS)
    for name, played in zip(EGOS, together, strict=True):
        assert_same(played, play_games(contest, zoo[name], zoo[opponent], **given))
    assert len({played.lead.tobytes() for played in together}) >= 5
    assert any(played.crash.any() for played in together)


def test_batches_are_cut_without_a_trace(contest, zoo, given, monkeypatch):
    egos = [zoo[name] for name in EGOS]
    whole = play_each(contest, egos, zoo["random-moves"], **given)
    monkeypatch.setattr("pcs_racing_agents.tournament.games.BATCH", 5 * len(EGOS))
    for part, expected in zip(play_each(contest, egos, zoo["random-moves"], **given), whole, strict=True):
        assert_same(part, expected)


@pytest.fixture
def driven(monkeypatch) -> list[int]:
    """Games that each step drives, which a test fills by playing."""
    counts: list[int] = []
    apply = RaceGame.apply

    def counted(self, state, *arguments):
        counts.append(state.games)
        return apply(self, state, *arguments)

    monkeypatch.setattr(RaceGame, "apply", counted)
    return counts


def test_what_is_the_same_is_driven_once(contest, zoo, given, driven):
    play_each(contest, [zoo["random-moves"]] * 4, zoo["never-switch"], **given)
    assert driven == [GAMES] * 4
    driven.clear()
    play_each(contest, [zoo["never-switch"], zoo["aggressiveness +"]], zoo["never-switch"], **given)
    assert driven[0] <= 2 * GAMES
    assert driven == sorted(driven)  # games part, and never meet again
    driven.clear()
    play_each(contest, [zoo[name] for name in EGOS], zoo["never-switch"], **given)
    choices = len(contest.competitor_moves)
    assert GAMES < driven[0] <= choices * GAMES < len(EGOS) * GAMES
    assert driven[0] < driven[-1] <= len(EGOS) * GAMES


def test_two_moves_to_one_policy_are_one_drive(contest, zoo, given, driven):
    """From the edge of the archive some moves lead nowhere, as to stay does."""
    policy = 0
    stay = contest.competitor_moves.index("stay")
    targets = contest.next_policy(np.full(5, policy), np.arange(5))
    same = [move for move in range(4) if targets[move] == targets[stay]]
    assert same
    egos = [zoo["never-switch"], always(make_setting(contest.archive, contest.config), contest.move_names[same[0]])]
    rows = {**given, "policies": np.zeros((GAMES, 2), int)}
    stays, moves = play_each(contest, egos, zoo["never-switch"], **rows)
    assert driven == [GAMES] * 4
    np.testing.assert_array_equal(stays.lead, moves.lead)
    assert (stays.moves[:, 0] != moves.moves[:, 0]).any()


def test_impossible_egos_are_refused(contest, zoo, given):
    for egos, message in [([], "egos are nobody"), ([zoo["random-moves"], zoo["pure-pursuit"]], "a driver only alone")]:
        with pytest.raises(InputError, match=message):
            play_each(contest, egos, zoo["never-switch"], **given)
    other = build("never-switch", make_setting("default", "paper"))
    with pytest.raises(InputError, match="never-switch"):
        play_each(contest, [zoo["random-moves"], other], zoo["never-switch"], **given)
