"""Every page in Chromium, wide and as on a phone, light and dark: no complaint, all on the screen, accessible."""

from pathlib import Path

import pytest
from recorded_races import race_on_a_circle
from repository import REPOSITORY
from toy_report import toy_report
from zoo_games import CONFIG

from pcs_racing import make_game
from pcs_racing.race.replay_files import read_replay, save_replay
from pcs_racing_agents import make
from pcs_racing_agents.benchmark.card import board_page, read_cards, write_card
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.study.report import write_page
from pcs_racing_agents.study.report_inputs import ExplainedRace
from pcs_racing_agents.view.person_drive import drive_page, make_person_drive
from pcs_racing_agents.view.person_race import PersonRaces, play_page


@pytest.fixture(scope="module")
def explained(tournament_folder, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("explained")
    assert main(["explain", str(tournament_folder[0]), "--index", "1", "--out", str(folder)]) == 0
    return folder / "race.html"


def replay(get):
    return save_replay(race_on_a_circle(candidates=3), get("tmp_path") / "race.html")


def alone(get):
    two = race_on_a_circle()
    one = {"cars": two.cars[:, :1], "progress": two.progress[:, :1], "car_names": ("alone",)}
    return save_replay(race_on_a_circle(**one, ittc=None, paths=None, events=()), get("tmp_path") / "race.html")


def report(get):
    # Wider than any screen, instead of pictures that take seconds to draw.
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" width="1500" height="200"/>'
    get("monkeypatch").setattr("pcs_racing_agents.study.report._draw", lambda *_, **__: svg)
    race = ExplainedRace("A race", "What happened.", read_replay(get("explained")))
    return write_page(toy_report(get("archive"), race), get("tmp_path") / "report.html")


def card(get):
    (one, *_) = read_cards([REPOSITORY / "benchmarks" / "bench_v2"])
    return write_card(one, get("tmp_path"), [("A race", read_replay(get("explained")))])[2]


def leaderboard(get):
    page = get("tmp_path") / "leaderboard.html"
    page.write_text(board_page(read_cards([REPOSITORY / "benchmarks" / "bench_v2"])), encoding="utf-8")
    return page


def play(get):
    archive = get("archive")
    rival = make("random-moves", archive=archive, race=CONFIG)
    races = PersonRaces(make_game("Pipkin", archive, CONFIG, stay=True), rival, seed=3)
    return get("served")(play_page(races), races.answer)


def drive(get):
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    return get("served")(drive_page(races), races.answer)


# What makes a page, and what is true of it when all of it is there.
PAGES = {
    "a replay": (replay, "document.documentElement.dataset.drawn"),
    "a replay of one car": (alone, "document.documentElement.dataset.drawn"),
    "an explained race": (lambda get: get("explained"), "document.documentElement.dataset.drawn"),
    "a report": (report, "document.images.length"),
    "a list of races": (lambda get: get("page"), "document.body.dataset.played"),
    "a card": (card, "document.querySelector('table')"),
    "the leaderboard": (leaderboard, "document.querySelector('table')"),
    "play": (play, "document.querySelector('#choices button:enabled')"),
    "play at the wheel": (drive, "race || document.querySelector('#begin').click()"),
}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_its_screen_and_hinders_nobody(name, browser, request):
    make_page, there = PAGES[name]
    browser.open(make_page(request.getfixturevalue))
    browser.wait(f"Boolean(({there}))")
    browser.run("for (const part of document.querySelectorAll('details')) part.open = true")
    for width, height in ((1280, 720), (390, 844)):
        for scheme in ("light", "dark"):
            browser.show(width, height, scheme)
            assert browser.run("document.documentElement.scrollWidth") <= width, (width, scheme)
            assert browser.hindrances() == [], (width, scheme)
    assert browser.complaints == []
