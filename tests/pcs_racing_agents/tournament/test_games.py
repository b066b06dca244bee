"""Games of one or several egos: a game does not depend on the other games of its batch."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from refusal import refused
from same_arrays import assert_same
from same_move import Model

from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.make import make_game
from pcs_racing.game.players import always, competitor, never_switch, random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.blind import best_fixed
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.tournament import play_pairing, repeat_race

GAMES = 12


def played(pairing, **changes):
    """Races of a pairing with the observations of both cars."""
    return play_pairing(replace(pairing, **changes), observations=True)


def test_a_played_game_is_the_game_that_the_moves_make(contest, zoo, games_of):
    """Played again move by move with the game alone."""
    pairing = games_of(zoo["random-moves"], zoo["never-switch"])
    races = played(pairing)
    moves = races.moves.codes
    state = contest.reset(pairing.noise, policies=pairing.variants, starts=pairing.starts)
    for step in range(4):
        going = ~contest.done(state)
        np.testing.assert_array_equal(state.policy[going], races.path[going, :, step])
        state = contest.step(state, np.maximum(moves[:, :, step], 0))
    np.testing.assert_array_equal(races.lead, state.race.lead)
    np.testing.assert_array_equal(races.winner, contest.winner(state))
    np.testing.assert_array_equal(races.crash, state.race.crash.max(axis=1))
    np.testing.assert_array_equal(races.fault, state.race.fault)
    np.testing.assert_array_equal(races.overtakes, state.race.overtakes)
    np.testing.assert_array_equal(races.observations, contest.observation(state))
    crashed = races.crashed
    assert 0 < crashed.sum() < GAMES
    assert (races.duration[~crashed] == 4.0).all()
    assert (races.duration[crashed] < 4.0).all()
    assert ((races.path >= 0).sum(axis=2)[~crashed] == 5).all()


def test_a_game_whose_players_move_before_the_start_is_played_and_recorded(contest, zoo, games_of):
    rules = replace(contest.rules, duration=None, steps=(0.0, 1.0, 0.8, 0.8, 0.8))
    pairing = replace(
        games_of(zoo["random-moves"], zoo["never-switch"]), game=replace(contest, rules=rules)
    )
    races = played(pairing)
    state = pairing.game.reset(pairing.noise, policies=pairing.variants, starts=pairing.starts)
    for step in range(rules.moves):
        state = pairing.game.step(state, np.maximum(races.moves.codes[:, :, step], 0))
    np.testing.assert_array_equal(races.lead, state.race.lead)
    whole, *_ = np.flatnonzero(~races.crashed)
    assert races.duration[whole] == rules.ends[-1]
    recorded = repeat_race(pairing, whole)
    np.testing.assert_array_equal(recorded.replay.cars[-1], state.race.cars[whole])


@pytest.mark.parametrize(
    "pair",
    [
        ("random-moves", "random-moves"),
        ("random-moves", "pure-pursuit"),
        ("random-policy", "random-moves"),
        ("pure-pursuit", "random-policy"),
    ],
)
def test_what_comes_of_a_game_depends_on_the_game_alone(contest, zoo, games_of, pair):
    together = games_of(*(zoo[name] for name in pair))
    (expected,) = together.race([together.ego])
    for rows in ([0], [7, 3], [11, 0, 5], []):
        some = replace(together.take(np.array(rows, int)), game=replace(contest, threads=1))
        # Of no games, overtakes have another type.
        assert_same(
            some.race([some.ego])[0],
            {name: column[rows] for name, column in expected.items()},
            strict=False,
        )
    fixed = [name in ("random-policy", "pure-pursuit") for name in pair]
    for name in ("moves", "path"):
        assert ((expected[name] < 0).all(axis=(0, 2)) == fixed).all()


def test_stay_is_a_move_for_everybody_and_a_model_remembers_its_own_game(game, zoo, games_of):
    """Also where the rules do not offer it; who does not know it is not changed by that."""
    bare = replace(game, rules=replace(game.rules, stay=False))
    spec = make_game(None, game.archive, bare.rules)
    races = played(replace(games_of(never_switch(spec), always(spec, "restraint -")), game=bare))
    assert set(races.moves.codes[:, 0].ravel().tolist()) <= {4, -1}
    assert (np.sort(races.path, axis=2)[:, 0, -1] == races.path[:, 0, 0]).all()
    counter = competitor(Counter(), spec)
    for car, cars in enumerate([(counter, zoo["random-moves"]), (zoo["random-moves"], counter)]):
        for columns in games_of(*cars).race(
            [cars[0]] if car == 0 else [cars[0], zoo["never-switch"]]
        ):
            for moves in columns["moves"][:, car]:
                made = moves[moves >= 0].tolist()
                assert made == list(range(len(made)))


class Counter:
    """A model that counts its questions in its memory, in place; its move is the count."""

    name = "counter"

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.zeros(len(observation), int) if state is None else state
        state += ~np.asarray(episode_start)
        return state.copy(), state


@dataclass(frozen=True)
class Leader:
    """Decides by the state of the game: another move for the car in front."""

    name: str = "leader"

    def act(self, observations, turn):
        assert not turn.game.done(turn.state).any()
        return np.where((turn.state.race.lead > 0.0) == (turn.car == 0), 1, 3)


@pytest.fixture(scope="module")
def egos(contest, zoo) -> list:
    spec = make_game(None, contest.archive, contest.rules)
    others = [
        always(spec, "aggressiveness +"),
        random_moves(spec, seed=9),
        best_fixed(spec, target=3),
    ]
    return [
        zoo["never-switch"],
        zoo["random-moves"],
        *others,
        Leader(),
        competitor(Counter(), contest),
    ]


@pytest.mark.parametrize(
    "opponent", ["never-switch", "random-moves", "pure-pursuit", Counter(), Leader()]
)
def test_games_of_several_egos_are_those_of_each_alone(zoo, games_of, egos, opponent):
    pairing = games_of(egos[0], zoo.get(opponent, opponent))
    together = pairing.race(egos)
    for ego, columns in zip(egos, together, strict=True):
        assert_same(columns, pairing.race([ego])[0])
    assert len({columns["lead"].tobytes() for columns in together}) >= 5
    assert any(columns["crash"].any() for columns in together)


@pytest.fixture
def driven(monkeypatch) -> list[int]:
    """Games that each step drives, which a test fills by playing."""
    counts: list[int] = []
    step = RaceGame.step

    def counted(self, state, *arguments, **more):
        counts.append(state.games)
        return step(self, state, *arguments, **more)

    monkeypatch.setattr(RaceGame, "step", counted)
    return counts


def test_the_same_is_driven_once_and_two_moves_to_one_policy_are_one_drive(
    contest, zoo, games_of, egos, driven
):
    pairing = games_of(zoo["never-switch"], zoo["never-switch"])
    pairing.race([zoo["random-moves"]] * 4)
    assert driven == [GAMES] * 4
    driven.clear()
    pairing.race(egos)
    assert GAMES < driven[0] <= len(contest.moves) * GAMES < len(egos) * GAMES
    assert driven == sorted(driven)  # games part, and never meet again
    assert driven[0] < driven[-1] <= len(egos) * GAMES
    # From the edge of the archive some moves lead nowhere, as to stay does.
    targets = contest.table[0]
    nowhere, *_ = [
        move for move in range(4) if targets[move] == targets[contest.moves.index("stay")]
    ]
    other = always(make_game(None, contest.archive, contest.rules), contest.moves[nowhere])
    pairing = replace(
        games_of(zoo["never-switch"], zoo["never-switch"]), variants=np.zeros((GAMES, 2), int)
    )
    driven.clear()
    stays, moves = pairing.race([zoo["never-switch"], other])
    assert driven == [GAMES] * 4
    np.testing.assert_array_equal(stays["lead"], moves["lead"])
    assert (stays["moves"][:, 0] != moves["moves"][:, 0]).any()


@pytest.mark.parametrize(
    "pair",
    [
        ("random-moves", "random-moves"),
        ("random-moves", "lane-switcher:any"),
        ("pure-pursuit", "random-policy"),
    ],
)
def test_a_recorded_game_is_the_game(contest, zoo, games_of, pair):
    pairing = games_of(*(zoo[name] for name in pair))
    races = played(pairing)
    names = (
        pair
        if pair[0] != pair[1]
        else tuple(f"{name} (car {car})" for car, name in enumerate(pair))
    )
    for i in range(6):
        recording = repeat_race(pairing, i, candidates=False)
        replay = recording.replay
        assert replay.lead[-1] == races.lead[i]
        assert recording.played[0] == races[i]._replace(race=0)
        np.testing.assert_array_equal(recording.played.observations[0], races.observations[i])
        assert replay.duration == pytest.approx(races.duration[i], abs=0.04)
        assert ("crash" in replay.outcome) == races.crashed[i]
        assert replay.car_names == names


class Narrow:
    """A model that was trained on another observation."""

    class observation_space:  # noqa: N801
        shape = (7,)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        raise AssertionError("must not be asked")


def test_what_does_not_fit_is_refused_before_the_first_race(zoo, games_of, monkeypatch):
    for cars, change, value in [
        ((Narrow(), "never-switch"), {}, r"'Narrow' .*\(7,\)"),
        (
            ("never-switch", "never-switch"),
            {"variants": np.full((GAMES, 2), 12)},
            "game 0: the ego's variant is 12",
        ),
        (("never-switch", "never-switch"), {"variants": np.zeros((3, 2), int)}, r"\(3, 2\)"),
        (("never-switch", "never-switch"), {"variants": np.zeros((GAMES, 2))}, "whole numbers"),
        (("never-switch", "never-switch"), {"noise": race_seeds(0, 3)}, r"\(3,\)"),
        (
            ("never-switch", "pure-pursuit"),
            {"variants": np.ones((GAMES, 2), int)},
            "opponent's variant is 1",
        ),
    ]:
        monkeypatch.setattr(RaceGame, "reset", lambda *_, **__: pytest.fail("a race was driven"))
        refused(value, played, games_of(*(zoo.get(car, car) for car in cars)), **change)


def test_impossible_egos_and_moves_are_refused(zoo, games_of):
    pairing = games_of(zoo["never-switch"], zoo["never-switch"])
    other = build("cfr-argmax", make_game(None, "default", "paper"))
    refused("cfr-argmax", pairing.race, [zoo["random-moves"], other])
    refused("'Model': game 0: move 5", played, games_of(Model(5), zoo["never-switch"]))
