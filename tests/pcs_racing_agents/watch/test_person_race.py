"""Races in which a person makes the moves or steers: what the person is told, and the pages in
headless Chromium.
"""

import json

import numpy as np
import pytest
from refusal import refused
from zoo_games import CONFIG, toy_archive

from pcs_racing import make_game
from pcs_racing.base.seeds import race_seed
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.race.races import starts_of
from pcs_racing_agents import make
from pcs_racing_agents.tournament import Pairing
from pcs_racing_agents.watch.explain import explain_race
from pcs_racing_agents.watch.person_race import (
    PersonRaces,
    drive_page,
    make_person_drive,
    play_page,
)


def answered(races, path, status=200):
    answer = races.answer(path)
    assert answer.status == status
    return json.loads(answer.body)


@pytest.fixture(scope="module")
def races():
    archive = toy_archive()
    game = make_game("Pipkin", archive, CONFIG, stay=True)
    return PersonRaces(game, make("random-moves", archive=archive, race=CONFIG), seed=3)


def test_a_person_is_told_what_every_move_leads_to_and_may_race_fixed_policies(races):
    told = races.situation(0, ())
    game = races.game
    assert [choice["name"] for choice in told["choices"]] == list(game.competitor_moves)
    assert [choice["policy"] for choice in told["choices"]] == game.table[told["policy"]].tolist()
    assert (told["made"], told["over"], told["winner"]) == (0, False, None)
    after = races.situation(0, (2,))
    assert after["policy"] == told["choices"][2]["policy"]
    assert after["history"][0]["you"] == game.competitor_moves[2]
    schedule = make(
        "best-schedule", archive=game.archive, race=CONFIG, moves=["restraint +", *["stay"] * 3]
    )
    start = starts_of(game.track, game.setup.config, [0], 3)
    noise = np.array([race_seed(3, 0)], np.uint64)
    pairing = Pairing(game, schedule, races.opponent, races._policies(0)[None], start, noise)
    explained = explain_race(pairing, 0, car=1)
    axes, first = game.archive.characteristics, explained.steps[0]
    assert after == {
        "number": 0,
        "made": 1,
        "moves": 4,
        "ends": game.config.ends,
        "seconds": pytest.approx(1.6),
        "over": False,
        "outcome": "",
        "winner": None,
        "lead": pytest.approx(explained.replay.lead[40]),
        "opponent": "random-moves",
        "track": "Pipkin",
        "policies": game.archive.normalised.tolist(),
        "coordinates": game.archive.coordinates.tolist(),
        "policy": int(explained.played.path[0, 0, 1]),
        "axes": [
            {"name": one.name, "unit": one.unit, "meaning": one.meaning}
            for one in get_characteristics(axes)
        ],
        "choices": [
            {"name": name, "policy": int(end)}
            for name, end in zip(game.competitor_moves, game.table[after["policy"]], strict=True)
        ],
        "opponent_seen": explained.played.observations[0, 0, 8:10].tolist(),
        "you_seen": explained.played.observations[0, 1, 8:10].tolist(),
        "history": [
            {
                "you": "restraint +",
                "opponent": game.competitor_moves[first.move],
                "values": None,
                "probabilities": first.probabilities.tolist(),
            }
        ],
    }
    driven = PersonRaces(
        races.game, make("lattice:pace=0.3", archive=races.game.archive, race=CONFIG)
    )
    told = driven.situation(0, (1,))
    assert told["history"] == []
    assert told["opponent"] == "lattice:pace=0.3"


def test_races_that_can_not_be_are_refused(races):
    for number, moves, message in [
        (0, (5,), "move 5"),
        (0, (0,) * 5, "5 moves"),
    ]:
        refused(message, races.situation, number, moves)
    moves = (0, 3, 1, 4)
    told = races.situation(2, moves)
    assert told["over"]
    assert told["outcome"] == races.replay(2, moves).outcome != ""
    _, played, _ = races._drive(2, moves)
    game = races.game
    starts = starts_of(game.track, game.setup.config, [2], races.seed)
    state = game.reset(
        np.array([race_seed(races.seed, 2)], np.uint64), policies=played.variants, starts=starts
    )
    for step, move in enumerate(moves):
        state = game.step(state, np.array([[move, played.moves.codes[0, 1, step]]]))
    assert told["lead"] == pytest.approx(state.race.lead[0], abs=1e-9)
    short, longer = races.replay(1, (0,)), races.replay(1, (0, 3, 1))
    frames = len(short.cars)
    assert short.duration == pytest.approx(2 * CONFIG.step_seconds)
    np.testing.assert_array_equal(short.cars, longer.cars[:frames])
    np.testing.assert_array_equal(short.progress, longer.progress[:frames])
    np.testing.assert_array_equal(short.paths, longer.paths[:16])
    assert short.events == tuple(event for event in longer.events if event.time < short.duration)
    assert (short.outcome, races.situation(1, (0,))["winner"], told["winner"]) == (
        "",
        None,
        played.winner[0],
    )
    assert races.situation(1, (0, 3))["history"] == races.situation(1, (0, 3, 1))["history"][:2]


def test_a_person_starts_with_a_policy_like_the_opponents(races):
    """With one of the three of twelve that are nearest to it."""
    places = races.game.archive.normalised
    drawn = {tuple(races._policies(number).tolist()) for number in range(60)}
    for own, rival in drawn:
        apart = np.linalg.norm(places - places[rival], axis=1)
        assert apart[own] <= np.sort(apart)[2]
    assert len({rival for _, rival in drawn}) > 6 < len({own for own, _ in drawn})
    driven = PersonRaces(races.game, make("lane-switcher"))
    assert {driven._policies(number)[1] for number in range(150)} == set(range(20))


def test_addresses(races):
    found = {
        "/race/0/": 200,
        "/race/0/1-2": 200,
        "/race/0/9": 409,
        "/race/0/1-": 404,
        "/race/x/": 404,
        "/a": 404,
    }
    for path, status in found.items():
        assert ("error" in answered(races, path, status)) == (status != 200)


def test_the_page_in_a_browser(races, browser, served):
    browser.open(served(play_page(races), races.answer))
    told = races.situation(0, ())
    # to keep the policy is offered once
    goals = {choice["policy"] for choice in told["choices"]} | {told["policy"]}
    moving = [choice for choice in told["choices"] if choice["policy"] != told["policy"]]
    assert (
        browser.wait("document.querySelectorAll('#choices button:enabled').length")
        == len(moving) + 1
        >= len(goals)
    )
    for made in range(1, races.game.config.moves + 1):
        browser.run("document.querySelector('#choices button').click()")
        browser.wait(f"document.querySelectorAll('#history tr').length === {made}")
    told = races.situation(0, tuple(browser.run("moves")))
    assert told["over"]
    words = ("You won", "You lost", "Nobody won")[-1 if told["winner"] is None else told["winner"]]
    assert browser.run("document.querySelector('#lead').innerText").startswith(words)


@pytest.mark.parametrize("name", ["lattice:pace=0.3", "random-moves"])
def test_a_person_steers_step_by_step_and_the_same_commands_give_the_same_race(name):
    races = make_person_drive(make(name), seed=3, track="Pipkin")
    begun = answered(races, "/begin/2")
    assert (begun["number"], begun["step"], begun["result"], begun["opponent"]) == (2, 0, "", name)
    driven = [answered(races, f"/drive/2/{step}/2/0/40") for step in range(0, 20, 2)]
    assert answered(races, "/begin/2")["cars"] == begun["cars"]
    assert answered(races, "/drive/2/0/15/0/40")["cars"] != begun["cars"]
    assert answered(races, "/drive/2/15/5/0/40") == driven[-1]
    env = DriveEnv(track="Pipkin", opponent=make(name), time_step=0.02, look_ahead=())
    env.reset(seed=3 + 2)
    for _ in range(20):
        info = env.step(np.array([0.0, -0.2], np.float32))[4]
    expected = np.round(np.column_stack([info["poses"], np.asarray(info["velocities"])[:, 0]]), 4)
    assert driven[-1] == {
        "number": 2,
        "step": 20,
        "cars": expected.tolist(),
        "lead": float(info["lead"]),
        "result": "",
        "fault": 0,
    }
    assert begun["track"] == "Pipkin"
    assert begun["line"] == np.round(env.batch.track.line[:, :2], 3).tolist()
    assert begun["walls"] == np.round(env.batch.track.arrays.walls, 3).tolist()
    turned = [
        answered(races, "/begin/2") and answered(races, f"/drive/2/0/25/{side}/20")["cars"]
        for side in (-100, 100)
    ]
    ahead = np.exp(1j * begun["cars"][0][2])
    left = [
        np.imag(np.conj(ahead) * complex(*np.subtract(cars[0][:2], begun["cars"][0][:2])))
        for cars in turned
    ]
    assert left[0] < 0.0 < left[1]


def test_a_race_ends_and_what_can_not_be_is_refused():
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    answered(races, "/begin/0")
    for path, status in (
        ("/drive/0/5/1/0/0", 409),
        ("/drive/1/0/1/0/0", 409),
        ("/drive/0/0/26/0/0", 409),
        ("/drive/0/0/0/0/0", 409),
        ("/drive/0/0/1/101/0", 409),
        ("/drive/0/0/1/-101/0", 409),
        ("/drive/0/0/1/0/101", 409),
        ("/drive/0/0/1/0/-1", 404),
        ("/begin/x", 404),
    ):
        assert "error" in answered(races, path, status)
    step, result = 0, ""
    while not result:
        now = answered(races, f"/drive/0/{step}/25/100/60")  # round and round, into a wall
        step, result = now["step"], now["result"]
    assert now["fault"] == 1
    assert answered(races, f"/drive/0/{step}/25/0/0") == now


def test_the_page_to_steer_in_a_browser(browser, served):
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    browser.open(served(drive_page(races), races.answer, method="POST"))
    browser.run("document.querySelector('#begin').click()")
    browser.wait("document.querySelector('#status').innerText.includes('lattice')")
    browser.run("window.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }))")
    browser.wait("race.step > 20 && command.speed > 0.2")
