"""Races in which a person steers: what the page is told, and what it is refused."""

import json

import pytest

from pcs_racing_agents import make
from pcs_racing_agents.view.person_race import drive_page, make_person_drive


def told(races, path, status=200):
    answer = races.answer(path)
    assert answer.status == status
    return json.loads(answer.body)


@pytest.mark.parametrize("name", ["lattice:pace=0.3", "random-moves"])
def test_a_person_steers_step_by_step_and_the_same_commands_give_the_same_race(name):
    races = make_person_drive(make(name), seed=3, track="Pipkin")
    begun = told(races, "/begin/2")
    assert (begun["number"], begun["step"], begun["result"], begun["opponent"]) == (2, 0, "", name)
    assert len(begun["walls"][0]) == 4
    driven = [told(races, f"/drive/2/{step}/2/0/40") for step in range(0, 20, 2)]
    assert driven[-1]["step"] == 20
    assert driven[-1]["cars"][0][3] == pytest.approx(0.4 * 8.0, abs=0.3)  # m/s: 40 % of the top speed
    assert told(races, "/begin/2")["cars"] == begun["cars"]
    assert told(races, "/drive/2/0/15/0/40")["cars"] != begun["cars"]
    assert told(races, "/drive/2/15/5/0/40") == driven[-1]


def test_a_race_ends_and_what_can_not_be_is_refused():
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    told(races, "/begin/0")
    for path, status in (("/drive/0/5/1/0/0", 409), ("/drive/1/0/1/0/0", 409), ("/drive/0/0/99/0/0", 409),
                         ("/drive/0/0/1/200/0", 409), ("/drive/0/0/1/0/-1", 404), ("/begin/x", 404)):  # fmt: skip
        assert "error" in told(races, path, status)
    step, result = 0, ""
    while not result:
        now = told(races, f"/drive/0/{step}/25/100/60")  # round and round, into a wall
        step, result = now["step"], now["result"]
    assert now["fault"] == 1
    assert told(races, f"/drive/0/{step}/25/0/0") == now


def test_the_page_in_a_browser(browser, served):
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    browser.open(served(drive_page(races), races.answer))
    browser.run("document.querySelector('#begin').click()")
    browser.wait("document.querySelector('#status').innerText.includes('lattice')")
    browser.run("window.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }))")
    browser.wait("race.step > 20 && command.speed > 0.2")
