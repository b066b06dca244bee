"""Every page in Chromium, wide and as on a phone, light and dark: no complaint, all on the screen,
accessible.
"""

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from toy_report import toy_report

from pcs_racing.race.replay import save_replay
from pcs_racing_agents.study.report import ExplainedRace, report_page


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
    race = ExplainedRace("A race", "What happened.", race_on_a_circle())
    page = get("tmp_path") / "report.html"
    page.write_text(report_page(**toy_report(race, svg)))
    return page


# The maker of a page, and conditions that a complete page meets.
PAGES = {
    "a replay": (replay, "document.documentElement.dataset.drawn"),
    "a bare replay of one car": (bare_replay, "document.documentElement.dataset.drawn"),
    "a report": (report, "document.images.length"),
    "a list of races": (lambda get: get("page"), "document.body.dataset.played"),
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
