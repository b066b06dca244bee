"""Races in which a person makes the moves or steers: what the person is told, and the pages in headless Chromium."""

import json

import numpy as np
import pytest
from refusal import refused
from zoo_games import CONFIG, toy_archive

from pcs_racing import make_game
from pcs_racing.base.seeds import race_seed
from pcs_racing.race.races import starts_of
from pcs_racing_agents import make
from pcs_racing_agents.view.person_race import MOST_RACES, PersonRaces, drive_page, make_person_drive, play_page


def answered(races, path, status=200):
    answer = races.answer(path)
    assert answer.status == status
    return json.loads(answer.body)


@pytest.fixture(scope="module")
def races():
    archive = toy_archive()
    game = make_game("Pipkin", archive, CONFIG, stay=True)
    return PersonRaces(game, make("random-moves", archive=archive, race=CONFIG), seed=3)


def test_a_person_is_told_what_every_move_leads_to_and_may_race_drivers(races):
    told = races.situation(0, ())
    game = races.game
    assert [choice["name"] for choice in told["choices"]] == list(game.competitor_moves)
    assert [choice["policy"] for choice in told["choices"]] == game.table[told["policy"]].tolist()
    assert (told["made"], told["over"], told["winner"]) == (0, False, None)
    after = races.situation(0, (2,))
    assert after["policy"] == told["choices"][2]["policy"]
    assert after["history"][0]["you"] == game.competitor_moves[2]
    driven = PersonRaces(races.game, make("lattice:pace=0.3", archive=races.game.archive, race=CONFIG))
    told = driven.situation(0, (1,))
    assert told["history"] == []
    assert told["opponent"] == "lattice:pace=0.3"


def test_races_that_can_not_be_are_refused(races):
    for number, moves, message in [(MOST_RACES, (), str(MOST_RACES)), (0, (5,), "move 5"), (0, (0,) * 5, "5 moves")]:
        refused(message, races.situation, number, moves)
    moves = (0, 3, 1, 4)
    told = races.situation(2, moves)
    assert told["over"]
    assert told["outcome"] == races.replay(2, moves).outcome != ""
    _, played, _ = races._drive(2, moves)
    game = races.game
    starts = starts_of(game.track, game.setup.config, [2], races.seed)
    state = game.reset(np.array([race_seed(races.seed, 2)], np.uint64), policies=played.variants, starts=starts)
    for step, move in enumerate(moves):
        state = game.step(state, np.array([[move, played.moves.codes[0, 1, step]]]))
    assert told["lead"] == pytest.approx(state.race.lead[0], abs=1e-9)
    short, longer = races.replay(1, (0,)), races.replay(1, (0, 3, 1))
    frames = len(short.cars)
    assert short.duration == pytest.approx(2 * CONFIG.step_seconds)
    np.testing.assert_array_equal(short.cars, longer.cars[:frames])
    np.testing.assert_array_equal(short.progress, longer.progress[:frames])
    assert races.situation(1, (0, 3))["history"] == races.situation(1, (0, 3, 1))["history"][:2]


def test_a_person_starts_with_a_policy_like_the_opponents(races):
    """With one of the three of twelve that are nearest to it."""
    places = races.game.archive.normalised
    drawn = {tuple(races._policies(number).tolist()) for number in range(60)}
    for own, rival in drawn:
        apart = np.linalg.norm(places - places[rival], axis=1)
        assert apart[own] <= np.sort(apart)[2]
    assert len({rival for _, rival in drawn}) > 6 < len({own for own, _ in drawn})


def test_addresses(races):
    found = {"/race/0/": 200, "/race/0/1-2": 200, "/race/0/9": 409, "/race/0/1-": 404, "/race/x/": 404, "/a": 404}
    for path, status in found.items():
        assert ("error" in answered(races, path, status)) == (status != 200)


def test_the_page_in_a_browser(races, browser, served):
    browser.open(served(play_page(races), races.answer))
    told = races.situation(0, ())
    goals = {choice["policy"] for choice in told["choices"]} | {told["policy"]}  # to keep the policy is offered once
    moving = [choice for choice in told["choices"] if choice["policy"] != told["policy"]]
    assert browser.wait("document.querySelectorAll('#choices button:enabled').length") == len(moving) + 1 >= len(goals)
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
    assert len(begun["walls"][0]) == 4
    driven = [answered(races, f"/drive/2/{step}/2/0/40") for step in range(0, 20, 2)]
    assert driven[-1]["step"] == 20
    assert driven[-1]["cars"][0][3] == pytest.approx(0.4 * 8.0, abs=0.3)  # m/s: 40 % of the top speed
    assert answered(races, "/begin/2")["cars"] == begun["cars"]
    assert answered(races, "/drive/2/0/15/0/40")["cars"] != begun["cars"]
    assert answered(races, "/drive/2/15/5/0/40") == driven[-1]


def test_a_race_ends_and_what_can_not_be_is_refused():
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    answered(races, "/begin/0")
    for path, status in (("/drive/0/5/1/0/0", 409), ("/drive/1/0/1/0/0", 409), ("/drive/0/0/99/0/0", 409),
                         ("/drive/0/0/1/200/0", 409), ("/drive/0/0/1/0/-1", 404), ("/begin/x", 404)):  # fmt: skip
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
