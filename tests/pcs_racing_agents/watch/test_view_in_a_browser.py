"""The page in headless Chromium: the list, its filters and keys, a race that plays, names that are
only names.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_races import race_on_a_circle
from toy_races import toy_races
from toy_report import toy_report

from pcs_racing.race.replay import save_replay
from pcs_racing_agents.study.report import report_page
from pcs_racing_agents.study.study import open_results
from pcs_racing_agents.tournament.race_files import race_table, read_results
from pcs_racing_agents.watch.race_choice import choose_races
from pcs_racing_agents.watch.race_replays import RaceRepeater, view_page
from pcs_racing_agents.watch.results_folder import ResultsFolder

NASTY = (
    "</script><script>document.title='taken'</script><img src=x onerror=\"document.title='taken'\">"
)
BLUE, ORANGE = (27, 111, 216), (224, 135, 0)


def coloured(pixels, colour):
    """How many pixels have a colour."""
    return int(np.count_nonzero(np.abs(pixels - colour).sum(axis=-1) < 12))


def played(browser):
    """Wait for a race to have been drawn; its time and duration."""
    return [float(piece) for piece in browser.wait("document.body.dataset.played || ''").split("/")]


def test_the_page_lists_the_races_and_reads_what_was_packed(browser, page, tournament_folder):
    browser.open(page)
    played(browser)
    races = read_results(tournament_folder[0] / "results.csv")
    displayed = browser.run(
        "[...document.querySelectorAll('#pane .line:not([hidden])')].map((line) => line.innerText)"
    )
    assert len(displayed) >= 10
    first = browser.run("Number(document.querySelector('#pane .line').dataset.race)")
    for text in (races[first].ego, races[first].opponent, f"{abs(races[first].lead):.1f}"):
        assert text in displayed[0]
    assert browser.run("document.querySelectorAll('link, script[src], img').length") == 0
    leads = browser.run("Array.from(columns.lead)")  # as packed, without and with differences
    assert leads == pytest.approx(races.lead, abs=0.00051)
    assert browser.run("Array.from(columns.race)") == races.race.tolist()
    assert browser.run("[...replays.keys()]") == list(choose_races(races, 5))


def test_filters_leave_the_races_that_they_name(browser, page, tournament_folder):
    rows = list(read_results(tournament_folder[0] / "results.csv"))
    of_random = [row for row in rows if "random-moves" in (row.ego, row.opponent)]
    lead = [row.lead if row.ego == "random-moves" else -row.lead for row in of_random]
    lost = [
        row
        for row in of_random
        if row.winner == ("opponent" if row.ego == "random-moves" else "ego")
    ]
    expected = {
        "": len(rows),
        "agent=random-moves": len(of_random),
        "agent=random-moves&opponent=never-switch": 6,
        "agent=random-moves&winner=loses": len(lost),
        "agent=random-moves&low=0": sum(one >= 0 for one in lead),
        "crash=any": sum(row.crash != "none" for row in rows),
        "crash=none": sum(row.crash == "none" for row in rows),
        "text=%234": 1,
        "text=NEVER+lane": 6,
        "watchable=1": 5,
        "track=Pipkin": len(rows),
    }
    for link, count in expected.items():
        browser.open(f"{page.as_uri()}#show=list&{link}")
        assert browser.run("Number(document.body.dataset.shown)") == count, link
    # The same by hand, and back again.
    browser.open(page)
    assert browser.run("""(() => {
        const box = document.getElementById("agent");
        box.value = [...box.options].find((option) => option.text === "random-moves").value;
        box.dispatchEvent(new Event("change"));
        return Number(document.body.dataset.shown);
    })()""") == len(of_random)
    assert {
        *browser.run(
            "[...document.querySelectorAll('#pane .line:not([hidden]) .first')].map((e) =>"
            " e.innerText)"
        )
    } == {"random-moves"}
    browser.run("document.getElementById('reset').click()")
    assert browser.run("Number(document.body.dataset.shown)") == len(rows)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_race_plays_with_its_moves_beside_it(browser, page, theme):
    browser.open(f"{page.as_uri()}#theme={theme}&t=1.5")
    assert played(browser)[0] == pytest.approx(1.5, abs=0.01)
    colours = (BLUE, ORANGE) if theme == "light" else ((88, 166, 255), (255, 176, 59))

    def drawn(pixels):
        width = pixels.shape[1]
        track, space = (
            pixels[140:480, 520 : int(0.74 * width)],
            pixels[140:480, int(0.76 * width) :],
        )
        both = all(coloured(track, colour) > 40 for colour in colours)
        return both and sum(coloured(space, colour) for colour in colours) > 40

    browser.look(drawn)
    browser.press("Space")
    browser.wait("Number(document.body.dataset.played.split('/')[0]) > 1.7")
    browser.press("Space")
    assert browser.complaints == []


def test_keys_walk_through_the_list(browser, page):
    browser.open(page)
    played(browser)
    before = browser.run("chosen")
    browser.press("End")
    assert browser.run("chosen") == browser.run("shown[shown.length - 1]")
    browser.press("Home")
    assert browser.run("chosen") == 0
    browser.press("ArrowDown")
    assert browser.run("chosen") == 1
    browser.press("w")
    assert browser.run("Number(document.body.dataset.shown)") == 5
    browser.press("n")
    assert browser.run("here(chosen) && chosen >= 0")
    assert before in browser.run("[...replays.keys()]")
    browser.press("/")
    assert browser.run("document.activeElement.id") == "text"


def test_a_name_is_only_a_name(browser, tournament_folder, tmp_path):
    place, _ = tournament_folder
    results = open_results(place)
    rows = [
        row._replace(ego=NASTY, track=NASTY, ego_moves=(NASTY,), rules="<!--player--><b>")
        for row in results.races
    ]
    repeater = RaceRepeater(results)
    race = repeater.drive(0)
    texts = dict.fromkeys(("title", "track_name", "outcome"), NASTY) | {"car_names": [NASTY, NASTY]}
    events = [[*event[:3], NASTY] for event in race["events"]]
    repeater.results = replace(
        results, races=race_table(rows), folder=Path("$(touch /tmp/never) <b>")
    )
    repeater.circuits = {NASTY: repeater.circuits["Pipkin"]}
    repeater.space |= {"archive": NASTY, "moves": [NASTY] * len(repeater.space["moves"])}
    page = view_page(repeater, {0: NASTY}, {0: {**race, **texts, "events": events}})
    path = tmp_path / "hostile.html"
    path.write_text(page, encoding="utf-8")
    browser.open(path)
    played(browser)
    assert browser.run("document.title") == "never) <b>"
    assert browser.run("document.getElementById('title').innerText") == "never) <b>"
    assert browser.run("document.querySelectorAll('img, b:not(.told b, #which b)').length") == 0
    assert NASTY in browser.run("document.querySelector('#pane .line .first').textContent")
    browser.run("choose(1, false)")
    assert NASTY in browser.run("document.getElementById('instead').textContent")
    assert "'$(touch /tmp/never) <b>'" in browser.run(
        "document.getElementById('instead').textContent"
    )
    assert browser.complaints == []


def test_two_hundred_thousand_races_are_filtered_at_once(browser, tmp_path):
    """No time is asserted; all races are there, sorted, and only visible rows are in the page."""
    races = toy_races(("t",), ("a", "b"), egos=50, variants=50)
    races = replace(races, overtakes=np.random.default_rng(0).integers(0, 3, (200_000, 2)))
    path = tmp_path / "many.html"
    path.write_text(
        view_page(RaceRepeater(ResultsFolder(Path("many"), Path(), races, "", None)), {}, {})
    )
    browser.open(f"{path.as_uri()}#show=list&sort=lead")
    assert browser.run("Number(document.body.dataset.shown)") == 200_000
    assert browser.run("document.querySelectorAll('#pane .line').length") < 60
    order = np.argsort(np.rint(races.lead * 1000), kind="stable")
    assert browser.run("Number(document.querySelector('#pane .line').dataset.race)") == order[0]
    browser.press("End")
    assert browser.run("chosen") == order[-1]
    assert (
        browser.run("[...document.querySelectorAll('#pane .line[aria-selected=true]')].length") == 1
    )
    browser.run("list.scrollTop = 0; drawList()")
    assert browser.run(
        "[...document.querySelectorAll('#pane .race')].every((e) => e.scrollWidth <= e.clientWidth)"
    )
    browser.run("filters.agent = 3; refilter()")
    browser.run("filters.crash = 'own'; refilter()")
    own = (races.agents.codes == 3) & (races.fault > 0) & races.crashed[:, None]
    assert browser.run("shown.length") == np.count_nonzero(own.any(axis=1))
    assert browser.complaints == []


def test_a_phone_shows_the_list_and_then_the_race_or_how_to_watch_it(
    browser, page, tournament_folder
):
    browser.open(page, width=390, height=844)
    assert browser.run("getComputedStyle(document.querySelector('.watch')).display") == "none"
    # Columns up to the result are on the screen, the others right of it; no text is cut.
    assert (
        browser.run("""[...document.querySelector('#pane .line').children].map((cell) => {
        const { left, right } = cell.getBoundingClientRect();
        const edge = list.getBoundingClientRect().right;
        const whole = cell.scrollWidth <= cell.clientWidth;
        return right <= edge && whole ? 0 : left >= edge - 2 ? 1 : -1;
    })""")
        == [0] * 6 + [1] * 7
    )
    browser.run("document.querySelector('#pane .line').click()")
    assert browser.run("getComputedStyle(document.querySelector('.races')).display") == "none"
    browser.open(page)
    absent = browser.run("[...Array(N).keys()].find((i) => !here(i))")
    browser.run(f"choose({absent}, true)")
    text = browser.run("document.getElementById('instead').innerText")
    assert f"pcs-racing view '{tournament_folder[0]}' --index {absent}" in text
    assert f"Race {absent}: " in text


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
    page = get("tmp_path") / "report.html"
    page.write_text(report_page(**toy_report()))
    return page


# The maker of a page, and conditions that a complete page meets.
PAGES = {
    "a replay": (replay, "document.documentElement.dataset.drawn"),
    "a bare replay of one car": (bare_replay, "document.documentElement.dataset.drawn"),
    "a report": (report, "document.querySelector('table')"),
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
