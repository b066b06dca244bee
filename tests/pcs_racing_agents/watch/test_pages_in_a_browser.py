"""Every page in Chromium, wide and as on a phone, light and dark: no complaint, all on the screen,
accessible.
"""

from pathlib import Path

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from toy_report import toy_report
from zoo_games import CONFIG

from pcs_racing import make_game
from pcs_racing.race.replay import read_replay, save_replay
from pcs_racing_agents import make
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.study.report_page import ExplainedRace, report_page
from pcs_racing_agents.watch.person_race import (
    PersonRaces,
    drive_page,
    make_person_drive,
    play_page,
)


@pytest.fixture(scope="module")
def explained(tournament_folder, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("explained")
    assert main(["explain", str(tournament_folder[0]), "--index", "1", "--out", str(folder)]) == 0
    return folder / "race.html"


def replay(get, moment="#t=nonsense&follow=7", **changes):
    path = save_replay(
        race_on_a_circle(**{"candidates": 3, **changes}), get("tmp_path") / "race.html"
    )
    return path.as_uri() + moment


def bare_replay(get):
    two = race_on_a_circle(0.0)
    one = {
        "cars": two.cars[:, :1],
        "progress": two.progress[:, :1],
        "car_names": ("alone",),
        "events": (),
    }
    return replay(
        get,
        "#play=1",
        **one,
        candidates=0,
        paths=None,
        ittc=None,
        line_speed=None,
        walls=np.zeros((0, 4)),
    )


def report(get):
    # Wider than any screen, instead of pictures that take seconds to draw.
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" width="1500" height="200"/>'
    get("monkeypatch").setattr("pcs_racing_agents.study.report_page._draw", lambda *_, **__: svg)
    race = ExplainedRace("A race", "What happened.", read_replay(get("explained")))
    page = get("tmp_path") / "report.html"
    page.write_text(report_page(toy_report(get("archive"), race)))
    return page


def play(get):
    archive = get("archive")
    rival = make("random-moves", archive=archive, race=CONFIG)
    races = PersonRaces(make_game("Pipkin", archive, CONFIG, stay=True), rival, seed=3)
    return get("served")(play_page(races), races.answer)


def drive(get):
    races = make_person_drive(make("lattice:pace=0.3"), track="Pipkin")
    return get("served")(drive_page(races), races.answer, method="POST")


# What makes a page, and what is true of it when all of it is there.
PAGES = {
    "a replay": (replay, "document.documentElement.dataset.drawn"),
    "a bare replay of one car": (bare_replay, "document.documentElement.dataset.drawn"),
    "an explained race": (lambda get: get("explained"), "document.documentElement.dataset.drawn"),
    "a report": (report, "document.images.length"),
    "a list of races": (lambda get: get("page"), "document.body.dataset.played"),
    "play": (play, "document.querySelector('#choices button:enabled')"),
    "play at the wheel": (drive, "race || document.querySelector('#begin').click()"),
}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_its_screen_and_hinders_nobody(name, browser, request):
    make_page, there = PAGES[name]
    # races that play by themselves take time
    browser.open(make_page(request.getfixturevalue), motion="reduce")
    browser.wait(f"Boolean(({there}))")
    browser.run("for (const part of document.querySelectorAll('details')) part.open = true")
    for width, height in ((1280, 720), (390, 844)):
        for scheme in ("light", "dark"):
            browser.show(width, height, scheme, motion="reduce")
            assert browser.run("document.documentElement.scrollWidth") <= width, (width, scheme)
            assert browser.hindrances() == [], (width, scheme)
    assert browser.complaints == []
