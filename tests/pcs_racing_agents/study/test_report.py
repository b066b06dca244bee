import base64
import html
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from replay_pages import race_in
from toy_races import of, toy_line, toy_races, toy_table
from toy_report import NASTY, toy_report

from pcs_racing_agents.base.style import COLOURS, picture_bytes
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.study import report
from pcs_racing_agents.study.config import LearningConfig, StudyConfig, TableConfig
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament import cross_pairing, play_pairing

SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="1500" height="200"/>'


@pytest.fixture(scope="module")
def raced(tmp_path_factory):
    """A study's races on one track."""
    config = StudyConfig(
        rules={"rules": "contest", "steps": (0.8,) * 5},
        archive="contest",
        table=TableConfig(("Pipkin",), ("lane-switcher:any",), ("random-moves",)),
        best="random-moves",
    )
    study = Study(config, tmp_path_factory.mktemp("study"), quiet=True)
    cars = study.agent("random-moves"), study.agent("lane-switcher:any")
    pairing = cross_pairing(study.game("Pipkin"), *cars, egos=4, opponents=4, lines=2, seed=3)
    return study, play_pairing(pairing)


@pytest.fixture(scope="module")
def watched(raced):
    return list(report.watched_races(*raced))


@pytest.fixture(scope="module")
def content(watched):
    return toy_report(watched[0], SVG)


@pytest.fixture(scope="module")
def page(content) -> str:
    return report.report_page(**content)


class _Balance(HTMLParser):
    """Counts tags and keeps the text between them."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.frames, self.images = [], [], [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag not in ("meta", "img", "br"):  # without an end
            self.open.append(tag)
        self.frames += [values] if tag == "iframe" else []
        self.images += [values] if tag == "img" else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def parsed(page) -> _Balance:
    result = _Balance()
    result.feed(page)
    result.close()
    assert result.open == []
    return result


def test_the_page_loads_nothing_and_texts_stay_texts(page, parsed):
    assert "default-src 'none'" in page
    outside = re.sub(r'srcdoc="[^"]*"', "", page)
    assert not re.search(r"https?://", outside)
    assert not re.search(r"<(link|script)|@import|url\(", outside)
    assert set(re.findall(r'src="([^,"]*),', outside)) == {"data:image/svg+xml;base64"}
    assert "<b>" not in page
    assert page.count("<!doctype html>") == 1
    assert "".join(parsed.text).count(NASTY) >= 10
    assert parsed.frames[1]["title"] == NASTY
    assert {"sandbox", "srcdoc", "title"} == set(parsed.frames[0])
    for image in parsed.images:
        assert ET.fromstring(base64.b64decode(image["src"].split(",")[1])).tag.endswith("svg")
        assert image["alt"]


def test_every_argument_changes_the_page_and_races_are_read_back(content, parsed, watched):
    for name in set(content) - {"title"}:
        assert report.report_page("", **{name: content[name]}) != report.report_page(""), name
    back = race_in(parsed.frames[0]["srcdoc"])
    assert back["outcome"] == watched[0].replay.outcome
    assert np.abs(back["progress"] - watched[0].replay.progress).max() < 0.001
    assert any(kind == "move" for _, _, kind, _ in back["events"])


TELL = """<script>
console.log("a race of " + race.car_names + ", " + duration + " s");
</script></body>"""


def test_the_page_works_in_a_browser(tmp_path, content, page, browser):
    # The first race reports that it is there; nothing else in the page may say anything.
    path = tmp_path / "report.html"
    path.write_text(page.replace(html.escape("</body>"), html.escape(TELL), 1))
    browser.open(path)
    assert browser.run("document.title") == content["title"]
    browser.wait("state.playing", frame=1)  # since it is on the screen
    # One screen and the table; the rest is folded, but not on paper.
    screen = browser.run("document.documentElement.scrollHeight")
    hidden = (
        "[...document.images].filter((image) => !image.checkVisibility({ contentVisibilityAuto:"
        " true })).length"
    )
    assert browser.run(hidden) == len(content["pictures"]) + 2
    browser.page.emulate_media(media="print")
    browser.wait(f"{hidden} === 0")
    browser.wait(f"document.documentElement.scrollHeight > 1.5 * {screen}")
    assert browser.said == [
        f"a race of random-moves,lane-switcher:any, {content['races'][0].replay.duration:g} s"
    ]
    assert browser.complaints == []


def test_the_closest_race_of_each_outcome_is_shown(raced, watched):
    races = raced[1]
    assert watched[0].text.startswith(
        "random-moves (car 0) against lane-switcher:any on Pipkin, contest rules"
    )
    shown = {race.title: race.replay.lead[-1] for race in watched}
    switched = races.switches[:, 0] > 0
    masks = {
        "win": ~races.crashed & (races.winner == 0) & switched,
        "loss": ~races.crashed & (races.winner == 1),
        "crash": races.fault[:, 0] > 0,
    }
    for word, mask in masks.items():
        leads = [lead for title, lead in shown.items() if word in title]
        assert len(leads) == mask.any()
        closest = np.abs(races.lead[mask]).min(initial=np.inf)
        assert all(abs(lead) == pytest.approx(closest, abs=0.002) for lead in leads)
    (title,) = (title for title in shown if "loss" in title)
    gap, count = np.abs(races.lead[masks["loss"]]).min(), masks["loss"].sum()
    assert title == f"random-moves: a loss; of {count} such races the closest, {gap:.1f} m"


ARMS = {"never-switch": 0.0, "cfr-argmax": 0.5}


def test_each_table_has_its_own_races_and_the_papers_figures_only_by_its_rules(
    tmp_path, monkeypatch
):
    table = TableConfig(("Tarnfjord", "Brackwater"), ("never-switch", "somebody"), tuple(ARMS))
    config = StudyConfig(
        learning=LearningConfig(tracks=("Tarnfjord",)),
        table=table,
        further=replace(table, tracks=("Pipkin",)),
    )
    races = toy_races((*table.tracks, "Pipkin"), table.opponents, ARMS, 4, 4)
    seed = races.seed._replace(words=("0", "100"), codes=(races.track.codes == 2).astype(np.int8))
    races = replace(races, seed=seed)
    monkeypatch.setattr(report, "watched_races", lambda study, races: [])
    study = Study(config, tmp_path, quiet=True)
    report.write_report(study, races)
    main, further, ahead = (
        read_csv(tmp_path / f"table{name}.csv").rows() for name in ("", "_further", "_by_progress")
    )
    assert {(row["track"], row["train"]) for row in main} == {
        ("Tarnfjord", "1"),
        ("Brackwater", "0"),
    }
    assert {row["track"] for row in further} == {"Pipkin"}
    first = of(races, "Tarnfjord", "never-switch", "cfr-argmax")
    (line,) = (row for row in ahead if row["arm"] == "cfr-argmax" and row["paper_gt"] == "0.569")
    assert float(line["score"]) == pytest.approx((first.lead > 0.0).mean(), abs=1e-6)
    page = (tmp_path / "report.html").read_text()
    assert "data:image/svg" in page
    assert "smoke test" in page
    contest = Study(replace(config, rules="contest"), tmp_path / "contest", quiet=True)
    contest.folder.mkdir()
    report.write_report(contest, races)
    assert {row["paper_gt"] for row in read_csv(contest.folder / "table.csv").rows()} == {""}
    assert not (contest.folder / "table_by_progress.csv").exists()


def test_findings_count_the_rows_whose_interval_leaves_out_zero():
    assert list(report.findings(toy_table(), "ours")) == [
        "ours scores more in 1 and less in 1 of 2 rows than still (-0.250 to +0.250); in 0 the"
        " 95 % interval contains 0.",
        "ours scores more in 0 and less in 0 of 1 rows than cfr-argmax, the best baseline in"
        " training (+0.125 to +0.125); in 1 the 95 % interval contains 0.",
        "cfr-argmax scores more in 0 and less in 0 of 1 rows than still (+0.125 to +0.125); in 1"
        " the 95 % interval contains 0.",
    ]


@pytest.mark.parametrize(("races", "small"), [(999, True), (1000, False)])
def test_a_small_study_says_so(races, small):
    line = toy_line("score", "Hut", True, "somebody", "still", "still")
    many = line._replace(result=replace(line.result, units=2000))
    few = line._replace(result=replace(line.result, units=races))
    assert bool(report.caution([many, few])) == small


def test_the_picture_holds_the_numbers_of_the_table_each_in_the_place_of_its_agent():
    """Agents below each other, a gap where one did not race; hollow at p >= 0.05."""
    figure = report.differences_picture(toy_table())
    first, second = figure.axes

    def drawn(axes):
        return [
            (
                line.get_xdata()[0],
                line.get_xdata()[-1],
                line.get_ydata()[0],
                line.get_marker(),
                line.get_markerfacecolor() == "white",
            )
            for line in axes.lines[1:]
        ]

    assert drawn(first)[:4] == [
        (0.125, 0.375, 0, "None", False),
        (0.25, 0.25, 0, "o", False),
        (-0.125, 0.375, -1, "None", False),
        (0.125, 0.125, -1, "o", True),
    ]
    assert drawn(second)[0] == (-0.3125, -0.1875, 0, "None", False)
    assert [line.get_color() for line in first.lines[1:7:2]] == [COLOURS[0], COLOURS[0], COLOURS[1]]
    labels = [label.get_text() for label in first.get_yticklabels()]
    assert labels == ["ours", "cfr-argmax", "ours - cfr-argmax"]
    assert second.get_title(loc="left") == "Hut (test), somebody"
    again = picture_bytes(report.differences_picture(toy_table()))
    assert picture_bytes(figure) == again
