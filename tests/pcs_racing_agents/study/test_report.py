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
from refusal import refused
from toy_races import of, toy_races, toy_table
from toy_report import NASTY, toy_report

from pcs_racing import make_game, read_replay
from pcs_racing_agents.agents import make_game_spec
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.study import report, reporting
from pcs_racing_agents.study import report_inputs as inputs
from pcs_racing_agents.study.playing import StudyRaces
from pcs_racing_agents.study.report import ReportContent, report_page, write_page
from pcs_racing_agents.study.study import Study, StudyConfig
from pcs_racing_agents.study.table import by_progress, make_table
from pcs_racing_agents.study.table_text import paper_rows, write_table
from pcs_racing_agents.tournament import cross_pairing, play_pairings
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow, concatenate_races
from pcs_racing_agents.tournament.ratings import Ratings
from pcs_racing_agents.tournament.round_robin import RoundRobin


@pytest.fixture(scope="module")
def raced(oval, archive):
    """A pairing of an agent, its races, and those of the agent that never switches."""
    game = make_game(oval, archive, "contest", step_seconds=0.8)
    spec = make_game_spec(archive, game.config)
    agent, base, rival = (
        build(name, spec) for name in ("random-moves", "never-switch", "lane-switcher")
    )
    pairings = [
        cross_pairing(game, arm, rival, egos=4, opponents=4, lines=2, seed=3)
        for arm in (agent, base)
    ]
    return pairings[0], *play_pairings(pairings)


@pytest.fixture(scope="module")
def watched(raced) -> inputs.ExplainedRace:
    pairing, ours, baseline = raced
    closest = next(iter(inputs.select_highlights(ours, baseline).values()))
    return inputs.watch_race(pairing, closest.race, closest.title)


@pytest.fixture(scope="module")
def content(archive, watched) -> ReportContent:
    return toy_report(archive, watched)


@pytest.fixture(scope="module")
def page(content) -> str:
    return report_page(content)


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
    assert everything.count(NASTY) >= 12
    assert parsed.frames[1]["title"] == NASTY


def test_every_section_is_there_with_its_numbers_and_pictures(page, parsed, content):
    assert re.findall('<section id="([^"]*)"', page) == [
        *(
            "results",
            "all-findings",
            "adaptivity-gain",
            "races-to-watch",
            "which-move-in-which-situation",
        ),
        *("policies", "ratings", "more", "how-it-was-made"),
    ]
    everything = " ".join(parsed.text)
    for row in content.table.rows:
        for one in (*row.differences, row.gain):
            assert f"{one.result.difference:+.3f}" in everything
    assert "0.569 ± 0.213 GT" in everything
    assert "63.0 (1.1 min)" in everything
    drawn = [image["src"].split(",")[1] for image in parsed.images if "svg" in image["src"]]
    assert len(drawn) == 7 + 2
    for data in drawn:
        assert ET.fromstring(base64.b64decode(data)).tag.endswith("svg")
    assert all(image["alt"] for image in parsed.images)


def test_the_page_is_written_races_read_back_and_every_field_told(
    tmp_path, content, page, parsed, watched
):
    assert write_page(content, tmp_path / "report.html").read_text() == page
    # What is given changes the page.
    for name in ReportContent.__dataclass_fields__:
        empty = ReportContent("")
        if name not in ("epsilon", "loss_unit", "curves", "reward_curves", "title"):
            assert report_page(replace(empty, **{name: getattr(content, name)})) != report_page(
                empty
            ), name
    file = tmp_path / "race.html"
    file.write_text(parsed.frames[0]["srcdoc"])
    back = read_replay(file)
    assert back.outcome == watched.replay.outcome
    assert np.abs(back.progress - watched.replay.progress).max() < 0.001
    assert any(event.kind == "move" for event in back.events)
    assert {"sandbox", "srcdoc", "title"} == set(parsed.frames[0])


TELL = """<script>console.log("a race of " + race.car_names + ", " + duration + " s");</script></body>"""


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
    assert browser.run(hidden) == 7 + 2
    browser.page.emulate_media(media="print")
    assert browser.run(hidden) == 0
    assert browser.run("document.documentElement.scrollHeight") > 2 * screen
    assert browser.run("Math.min(...[...document.images].map((image) => image.naturalWidth))") > 100
    assert browser.said == [
        f"a race of random-moves,lane-switcher, {content.races[0].replay.duration:g} s"
    ]
    assert browser.complaints == []


def test_a_highlight_shows_its_race(raced, watched):
    _, ours, baseline = raced
    race = {one.title: one.race for one in inputs.select_highlights(ours, baseline).values()}[
        watched.title
    ]
    assert watched.replay.lead[-1] == ours.lead[race]
    assert watched.text.startswith(
        "random-moves (car 0) against lane-switcher on oval, contest rules"
    )


def test_the_most_telling_race_of_each_kind_is_the_closest_one():
    """Of races by hand: a better kind goes before a closer race; what did not occur is absent."""

    def races(name, *rows):
        words = ("winner", "lead", "fault", "ego_path", "ego_moves")
        made = [
            RaceRow(ego=name, opponent="b", **dict(zip(words, row, strict=True))) for row in rows
        ]
        return race_table(
            row._replace(crash="none" if row.fault == "none" else "wall") for row in made
        )

    moves = (("+", "-", "+"), ("+",), ())
    switched, kept, driver = ((0, 1, 1, 2), moves[0]), ((0, 0, 0, 0), moves[0]), ((0,), moves[2])
    ours = races(
        "a",
        ("ego", 3.0, "none", *switched),
        ("ego", 0.5, "none", *switched),
        ("ego", 2.0, "none", *switched),
        ("ego", 0.1, "none", *kept),
        ("opponent", -4.0, "none", *kept),
        ("opponent", -1.0, "none", *kept),
        ("opponent", -0.2, "ego", *driver),
        ("opponent", -6.0, "both", (0, 1), ("+",)),
        ("none", 0.3, "opponent", *kept),
    )
    rows = [
        ("opponent", -1.0, "none", *driver),
        ("ego", 1.0, "none", *driver),
        ("opponent", -1.0, "none", *driver),
    ]
    base = races(
        "still",
        *rows,
        *[("ego", 1.0, "none", *driver)] * 2,
        *[("opponent", -1.0, "none", *driver)] * 4,
    )
    highlight = inputs.Highlight
    assert inputs.select_highlights(ours, base) == {
        "win": highlight(0, 2.0, "A win by switching; still starts alike and loses", 2, 2),
        "loss": highlight(0, 4.0, "A loss; still starts alike and wins", 4, 1),
        "crash": highlight(0, 6.0, "A crash that a is to blame for", 7, 1),
    }
    some = np.array([1, 5, 6])
    assert inputs.select_highlights(ours.take(some), base.take(some)) == {
        "win": highlight(1, 0.5, "A win, policies being switched", 0, 1),
        "loss": highlight(1, 1.0, "A loss", 1, 1),
        "crash": highlight(1, 0.2, "A crash before the first move that a is to blame for", 2, 1),
    }
    assert inputs.select_highlights(ours.take([3, 8]), base.take([3, 8])) == {}


@pytest.fixture
def raced_study(tmp_path):
    """A study of two circuits, of which agents learned on one, with the races of its two tables,
    drawn.
    """
    arms = {"never-switch": 0.0, "cfr-argmax": 0.5}
    config = StudyConfig(
        circuits=("Tarnfjord",),
        tracks=("Tarnfjord", "Brackwater"),
        opponents=("never-switch", "somebody"),
        arms=tuple(arms),
    )
    cells = [
        StudyRaces(
            table,
            SimpleNamespace(
                game=SimpleNamespace(track=SimpleNamespace(name=track)), names=(arm, rival)
            ),
            of(races, track, rival, arm),
        )
        for table, races in (
            ("main", toy_races(config.tracks, config.opponents, arms, 4, 4)),
            ("further", toy_races(("Pipkin",), ("somebody",), arms, 4, 4, seed=1)),
        )
        for track, arm, rival, _ in races.pairs
    ]
    return Study(config, tmp_path, quiet=True), cells


def test_a_table_has_its_own_races_and_the_papers_figures_only_by_its_rules(raced_study, tmp_path):
    study, cells = raced_study
    races = concatenate_races(cell.races for cell in cells if cell.table == "main")
    known = {"base": "never-switch", "best": "cfr-argmax", "seen": {"Tarnfjord"}}
    expected = make_table(races, **known)
    assert reporting.study_table(study, cells, "main") == expected
    assert [row.track for row in reporting.study_table(study, cells, "further").rows] == ["Pipkin"]
    (sheet,) = reporting._papers_statistic(study, cells)
    ahead, written = make_table(by_progress(races), **known), tmp_path / "table_by_progress.csv"
    assert [sheet.head, *sheet.rows] == paper_rows(ahead, "cfr-argmax")
    assert written.read_bytes() == write_table(ahead, tmp_path / "expected.csv").read_bytes()
    written.unlink()
    contest = replace(study, config=replace(study.config, race="contest"))
    bare = replace(expected, rows=tuple(replace(row, paper=None) for row in expected.rows))
    assert reporting.study_table(contest, cells, "main") == bare
    without = [cell for cell in cells if cell.pairing.names[0] == "never-switch"]
    alone = replace(
        study, config=replace(study.config, arms=("never-switch",), best="never-switch")
    )
    assert [
        *reporting._papers_statistic(contest, cells),
        *reporting._papers_statistic(alone, without),
    ] == []
    assert not written.exists()


def test_findings_and_cautions_are_told_in_words():
    toy = toy_table()
    assert list(reporting._findings(replace(toy, rows=toy.rows[:1], best="cfr-argmax"))) == [
        (
            "cfr-argmax and still can't be told apart: in all of 1 row (+0.125) the 95 % interval"
            " contains 0."
        ),
        "ours scores more in 1 of 1 row than still (+0.250).",
        (
            "What looking at the race brings: cfr-argmax and cfr-argmax, the best baseline in"
            " training can't be told apart: in all of 1 row (+0.125) the 95 % interval contains 0."
        ),
    ]
    words = [
        "ours scores more in 1 and",
        "cfr-argmax and still can't",
        "What looking at the race brings: ours and cfr",
    ]
    assert [
        said.startswith(word) for said, word in zip(reporting._findings(toy), words, strict=True)
    ] == [True] * 3
    assert len(list(reporting._findings(replace(toy, rows=toy.rows[1:])))) == 1
    assert reporting._caution(toy).startswith(
        "This is a smoke test, too small to conclude from: 8 races of an agent"
    )
    large = (
        arm._replace(races=races)
        for arm, races in zip(toy.rows[0].arms, (1000, 2000, 1001), strict=True)
    )
    large = replace(toy.rows[0], arms=tuple(large))
    small = replace(large, arms=(*large.arms[1:], large.arms[0]._replace(races=999)))
    assert [
        bool(reporting._caution(replace(toy, rows=(large, row)))) for row in (large, small)
    ] == [False, True]


def test_of_all_rows_the_closest_race_of_the_best_kind_is_watched(raced_study, monkeypatch):
    study, cells = raced_study
    monkeypatch.setattr(reporting, "watch_race", lambda *given: given)
    highlight = inputs.Highlight
    highlights = {
        ("Tarnfjord", "never-switch"): {
            "win": highlight(1, 0.5, "W1", 3, 7),
            "crash": highlight(0, 2.0, "C", 1, 1),
        },
        ("Tarnfjord", "somebody"): {"win": highlight(0, 3.0, "W0", 4, 2)},
        ("Brackwater", "never-switch"): {"win": highlight(0, 2.5, "W0", 5, 3)},
        ("Brackwater", "somebody"): {},
    }

    def select(races, baseline):
        (track, ego, opponent, _), (there, base, other, _) = (
            next(iter(races.pairs)),
            next(iter(baseline.pairs)),
        )
        assert (track, opponent, ego, base) == (there, other, "cfr-argmax", "never-switch")
        return highlights[track, opponent]

    monkeypatch.setattr(reporting, "select_highlights", select)
    watched = [
        (pairing.game.track.name, pairing.names[1], race, title)
        for pairing, race, title in reporting._watched(study, cells)
    ]
    assert watched == [
        ("Brackwater", "never-switch", 5, "W0: of 5 such races the closest, 2.5 m at the end"),
        ("Tarnfjord", "never-switch", 1, "C: of 1 such races the closest, 2.0 m at the end"),
    ]


def test_the_seeds_and_tables_of_a_study_follow_from_its_settings(tmp_path):
    config = StudyConfig(
        seed=5,
        further_lines=2,
        further_tracks=("Pipkin", "Tarnfjord"),
        further_opponents=("random-moves",),
        further_arms=("ppo", "cfr-argmax"),
    )
    arms = ("never-switch", "best-fixed", "best-schedule", "best-lead-plan", "cfr-argmax")
    rivals = ("never-switch", "random-policy", "lane-switcher")
    assert config.tables == {
        "main": (("Tarnfjord",), rivals, arms, 5),
        "further": (("Tarnfjord", "Pipkin"), (*rivals, "random-moves"), (*arms, "ppo"), 2),
    }
    assert list(StudyConfig().tables) == ["main"]
    assert config.every_track == ("Tarnfjord", "Pipkin")
    seeds = {"study": 5, "trees": 1_000_005, "training races": 2_000_005, "races of the table": 5}
    assert reporting._seeds(Study(config, tmp_path)) == seeds
    more = replace(config, pairs=0, responses=("quick",), rated=("never-switch", "ppo"))
    assert reporting._seeds(Study(more, tmp_path)) == {
        "study": 5,
        "training races": 2_000_005,
        "answers": 3_000_005,
        "races of the table": 5,
        "all against all": 5_000_005,
    }


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
    known = RoundRobin(names, np.zeros((3, 3)), 0.1, ratings, np.array([0.5, 0.25, 0.25]), None)
    assert report._ratings(ReportContent("", round_robin=known))[1:] == [
        ("c", "+174", "[+87, +261]", "4", "2", "0.50", ""),
        ("a", "+0", "[-87, +87]", "8", "0", "0.25", ""),
        ("b", "-174", "-", "6", "1", "0.25", ""),
    ]
    other = replace(known, equilibrium=None, alpha_rank=np.array([0.125, 0.875, 0.0]))
    assert [row[5:] for row in report._ratings(ReportContent("", round_robin=other))[1:]] == [
        ("", "0.12"),
        ("", "0.88"),
        ("", "0.00"),
    ]
    for nothing in (ReportContent("", round_robin=replace(known, ratings=None)), ReportContent("")):
        assert report._ratings(nothing) == []


def test_curves_are_read_and_damaged_ones_refused(tmp_path):
    path = tmp_path / "learning_curves.csv"
    path.write_text("epoch,training_loss,validation_loss\n1,0.5,\n2,0.25,0.3\n")
    training, validation = inputs.read_curves(path)
    assert (training.label, training.y.tolist(), training.x.tolist()) == (
        "training",
        [0.5, 0.25],
        [1.0, 2.0],
    )
    assert np.isnan(validation.y[0])
    path.write_text("step,won\n5,0.5\n10,1e100\n")
    (won,) = inputs.read_curves(path, "won", x="step")
    assert (won.label, won.y.tolist(), won.x.tolist()) == ("won", [0.5, 1e100], [5.0, 10.0])
    refused("has no column 'lost'", inputs.read_curves, path, "lost", x="step")
    refused("can't read", inputs.read_curves, tmp_path / "nothing.csv")
    for head, value in (("name", "0.1"), ("epoch", "much"), ("epoch", "inf")):
        path.write_text(f"{head},training_loss,validation_loss\n{value},0.5,0.3\n")
        refused("epoch" if head == "name" else repr(value), inputs.read_curves, path)
    versions = inputs.software()
    own = (np.__version__, platform.python_version(), f"{platform.system()} {platform.machine()}")
    assert tuple(versions[name] for name in ("numpy", "Python", "machine")) == own
