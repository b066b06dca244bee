import base64
import html
import platform
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from toy_races import STRENGTHS, of, toy_races, toy_table
from toy_report import NASTY, toy_report

from pcs_racing import make_game
from pcs_racing.race.replay import read_replay
from pcs_racing_agents.agents import make_game_spec
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.study import report, report_page
from pcs_racing_agents.study.config import LearningConfig, StudyConfig, TableConfig
from pcs_racing_agents.study.report_page import ExplainedRace, ReportContent
from pcs_racing_agents.study.stages import StudyRaces
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.study.table import by_progress, make_table
from pcs_racing_agents.study.table_output import paper_rows, write_table
from pcs_racing_agents.tournament import cross_pairing, play_pairings
from pcs_racing_agents.tournament.ratings import Ratings, RoundRobin


@pytest.fixture(scope="module")
def raced(oval, archive):
    """A study's races on one track: an agent, and the agent that never switches."""
    game = make_game(oval, archive, "contest", step_seconds=0.8)
    spec = make_game_spec(archive, game.config)
    agents = {name: build(name, spec) for name in ("never-switch", "random-moves")}
    rival = build("lane-switcher", spec)
    pairings = [
        cross_pairing(game, agent, rival, egos=4, opponents=4, lines=2, seed=3)
        for agent in agents.values()
    ]
    cells = [
        StudyRaces("main", *one) for one in zip(pairings, play_pairings(pairings), strict=True)
    ]
    table = TableConfig(("oval",), ("lane-switcher",), tuple(agents))
    config = StudyConfig(table=table, best="random-moves")
    return SimpleNamespace(config=config), cells


@pytest.fixture(scope="module")
def watched(raced) -> ExplainedRace:
    return next(report._watched(*raced))


@pytest.fixture(scope="module")
def content(archive, watched) -> ReportContent:
    return toy_report(archive, watched)


@pytest.fixture(scope="module")
def page(content) -> str:
    return report_page.report_page(content)


class _Balance(HTMLParser):
    """Counts tags and keeps what is written between them."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.frames, self.images = [], [], [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag not in ("meta", "img", "br"):  # which have no end
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
    everything = "".join(parsed.text)
    assert everything.count(NASTY) >= 10
    assert parsed.frames[1]["title"] == NASTY


def test_every_section_is_there_with_its_numbers_and_pictures(page, parsed, content):
    assert re.findall('<section id="([^"]*)"', page) == [
        *(
            "results",
            "all-findings",
            "adaptivity-gain",
            "races-to-watch",
        ),
        *("policies", "ratings", "more", "how-it-was-made"),
    ]
    everything = " ".join(parsed.text)
    for row in content.table.rows:
        for one in (*row.differences, row.gain):
            assert f"{one.result.difference:+.3f}" in everything
    assert "0.569 ± 0.213 GT" in everything
    drawn = [image["src"].split(",")[1] for image in parsed.images if "svg" in image["src"]]
    assert len(drawn) == 4 + 2
    for data in drawn:
        assert ET.fromstring(base64.b64decode(data)).tag.endswith("svg")
    assert all(image["alt"] for image in parsed.images)


def test_every_field_changes_the_page_and_races_are_read_back(tmp_path, content, parsed, watched):
    write, empty = report_page.report_page, ReportContent("")
    for name in ReportContent.__dataclass_fields__:
        if name not in ("epsilon", "curves", "title"):
            assert write(replace(empty, **{name: getattr(content, name)})) != write(empty), name
    file = tmp_path / "race.html"
    file.write_text(parsed.frames[0]["srcdoc"])
    back = read_replay(file)
    assert back.outcome == watched.replay.outcome
    assert np.abs(back.progress - watched.replay.progress).max() < 0.001
    assert any(event.kind == "move" for event in back.events)
    assert {"sandbox", "srcdoc", "title"} == set(parsed.frames[0])


TELL = """<script>
console.log("a race of " + race.car_names + ", " + duration + " s");
</script></body>"""


def test_the_page_works_in_a_browser(tmp_path, content, page, browser):
    # The first race tells that it is there; nothing else in the page may say anything.
    path = tmp_path / "report.html"
    path.write_text(page.replace(html.escape("</body>"), html.escape(TELL), 1))
    browser.open(path)
    assert browser.run("document.title") == content.title
    browser.wait("state.playing", frame=1)  # since it is on the screen
    # One screen and the table; the rest is folded, but not on paper.
    screen = browser.run("document.documentElement.scrollHeight")
    hidden = (
        "[...document.images].filter((image) => !image.checkVisibility({ contentVisibilityAuto:"
        " true })).length"
    )
    assert browser.run(hidden) == 4 + 2
    browser.page.emulate_media(media="print")
    browser.wait(f"{hidden} === 0")
    browser.wait(f"document.documentElement.scrollHeight > {2 * screen}")
    assert browser.run("Math.min(...[...document.images].map((image) => image.naturalWidth))") > 100
    assert browser.said == [
        f"a race of random-moves,lane-switcher, {content.races[0].replay.duration:g} s"
    ]
    assert browser.complaints == []


def test_the_closest_race_of_each_outcome_is_shown(raced, watched):
    races = raced[1][1].races
    assert watched.text.startswith(
        "random-moves (car 0) against lane-switcher on oval, contest rules"
    )
    shown = {race.title: race.replay.lead[-1] for race in report._watched(*raced)}
    switched = races.switches[:, 0] > 0
    masks = {
        "win": ~races.crashed & (races.winner == 0) & switched,
        "loss": ~races.crashed & (races.winner == 1),
        "crash": races.fault[:, 0] > 0,
    }
    for word, mask in masks.items():
        (lead,) = (
            (lead for title, lead in shown.items() if word in title) if mask.any() else (None,)
        )
        assert lead is None or lead in races.lead[mask]
    (title,) = (title for title in shown if "loss" in title)
    gap = np.abs(races.lead[masks["loss"]]).min()
    count = masks["loss"].sum()
    assert title == (
        f"random-moves: a loss; of {count} such races the closest, {gap:.1f} m at the end"
    )


ARMS = {"never-switch": 0.0, "cfr-argmax": 0.5}


@pytest.fixture
def raced_study(tmp_path):
    """A study with one training track of two, and the drawn races of its two tables."""
    table = TableConfig(("Tarnfjord", "Brackwater"), ("never-switch", "somebody"), tuple(ARMS))
    further = replace(table, tracks=("Pipkin",), opponents=("somebody",))
    config = StudyConfig(
        learning=LearningConfig(tracks=("Tarnfjord",)), table=table, further=further
    )
    cells = [
        StudyRaces(name, None, of(races, track, rival, arm))
        for (name, own), races in zip(
            config.tables.items(),
            (
                toy_races(own.tracks, own.opponents, ARMS, 4, 4, seed=seed)
                for seed, own in enumerate(config.tables.values())
            ),
            strict=True,
        )
        for track, arm, rival, _ in races.pairs
    ]
    return Study(config, tmp_path, quiet=True), cells


def test_a_table_has_its_own_races_and_the_papers_figures_only_by_its_rules(raced_study, tmp_path):
    study, cells = raced_study
    races, further = report.races_of(cells), report.races_of(cells, "further")
    known = {"best": "cfr-argmax", "train": {"Tarnfjord"}}
    expected = make_table(races, **known)
    assert report.study_table(study, races) == expected
    assert [row.track for row in report.study_table(study, further).rows] == ["Pipkin"]
    (sheet,) = report._papers_statistic(study, races)
    ahead, written = make_table(by_progress(races), **known), tmp_path / "table_by_progress.csv"
    assert [sheet.head, *sheet.rows] == paper_rows(ahead, "cfr-argmax")
    assert written.read_bytes() == write_table(ahead, tmp_path / "expected.csv").read_bytes()
    contest = replace(study, config=replace(study.config, game={"race": "contest"}))
    bare = replace(expected, rows=tuple(replace(row, paper=None) for row in expected.rows))
    assert report.study_table(contest, races) == bare
    assert list(report._papers_statistic(contest, races)) == []


def test_findings_and_cautions_are_told_in_words():
    toy = toy_table()
    words = [
        "ours scores more in 1 and less in 1 of 2 rows than still",
        "no difference between cfr-argmax and still is certain: in all of 1 row",
        "Gain from observing the race: no difference between ours and cfr-argmax, the best",
    ]
    for said, word in zip(report._findings(toy), words, strict=True):
        assert said.startswith(word)
    assert len(list(report._findings(replace(toy, rows=toy.rows[1:])))) == 1
    assert report._caution(toy).startswith(
        "This is a smoke test, too small to conclude from: 8 races of an agent"
    )
    large = (
        arm._replace(races=races)
        for arm, races in zip(toy.rows[0].arms, (1000, 2000, 1001), strict=True)
    )
    large = replace(toy.rows[0], arms=tuple(large))
    small = replace(large, arms=(*large.arms[1:], large.arms[0]._replace(races=999)))
    assert [bool(report._caution(replace(toy, rows=(large, row)))) for row in (large, small)] == [
        False,
        True,
    ]


def test_agents_stand_in_the_order_of_their_scores_over_all_races():
    races = toy_races(tracks=("Tarnfjord", "Hut"), egos=4, variants=3)
    scores = {
        name: races.score[races.agents.codes[:, 0] == code].mean()
        for code, name in enumerate(races.agents.words)
        if name in STRENGTHS
    }
    found = report.standings(races)
    assert [one.name for one in found] == sorted(scores, key=lambda name: -scores[name])
    for one in found:
        assert (one.score, one.races) == (pytest.approx(scores[one.name]), len(races) // 4)
        assert 0.0 <= one.low < one.score < one.high <= 1.0


def test_a_study_knows_its_tables_and_tracks():
    config = StudyConfig(further={"tracks": ("Pipkin", "Tarnfjord"), "lines": 2})
    assert list(StudyConfig().tables) == ["main"]
    assert [table.lines for table in config.tables.values()] == [5, 2]
    assert config.tracks == ("Tarnfjord", "Pipkin")


def test_ratings_stand_in_order_with_what_is_known_of_them():
    floats = {
        name: np.array(values)
        for name, values in {
            "strength": [0.0, -1.0, 1.0],
            "low": [-0.5, np.nan, 0.5],
            "high": [0.5, np.nan, 1.5],
        }.items()
    }
    ratings = Ratings(
        ("a", "b", "c"), **floats, tie=0.0, races=np.array([8, 6, 4]), left_out=np.array([0, 1, 2])
    )
    names = ("c", "a", "b")
    known = RoundRobin(names, np.zeros((3, 3)), ratings, np.array([0.5, 0.25, 0.25]))
    assert report_page._ratings(ReportContent("", round_robin=known))[1:] == [
        ("c", "+174", "[+87, +261]", "4", "2", "0.50"),
        ("a", "+0", "[-87, +87]", "8", "0", "0.25"),
        ("b", "-174", "-", "6", "1", "0.25"),
    ]
    other = ReportContent("", round_robin=replace(known, equilibrium=None))
    assert {row[5] for row in report_page._ratings(other)[1:]} == {""}
    for nothing in (ReportContent("", round_robin=replace(known, ratings=None)), ReportContent("")):
        assert report_page._ratings(nothing) == []


def test_curves_are_read(tmp_path):
    path = tmp_path / "learning_curves.csv"
    path.write_text("epoch,training_loss,validation_loss\n1,0.5,\n2,1e100,0.3\n")
    training, validation = report.read_curves(path)
    assert (training.label, training.y.tolist(), training.x.tolist()) == (
        "training",
        [0.5, 1e100],
        [1.0, 2.0],
    )
    assert np.isnan(validation.y[0])
    versions = report.software()
    own = (np.__version__, platform.python_version(), f"{platform.system()} {platform.machine()}")
    assert tuple(versions[name] for name in ("numpy", "Python", "machine")) == own
