import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from toy_races import of, toy_line, toy_races, toy_table
from toy_report import NASTY, toy_report

from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.study import report
from pcs_racing_agents.study.config import LearningConfig, StudyConfig, TableConfig
from pcs_racing_agents.study.study import Study


class _Balance(HTMLParser):
    """Counts tags and keeps the text between them."""

    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br"):  # without an end
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_loads_nothing_and_texts_stay_texts():
    page, parsed = report.report_page(**toy_report()), _Balance()
    parsed.feed(page)
    parsed.close()
    assert parsed.open == []
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|<(link|script|b>)|@import|url\(|src=", page)
    assert page.count("<!doctype html>") == 1
    assert "".join(parsed.text).count(NASTY) >= 8


def test_every_argument_changes_the_page():
    content = toy_report()
    for name in set(content) - {"title"}:
        assert report.report_page("", **{name: content[name]}) != report.report_page(""), name


def test_the_page_works_in_a_browser(tmp_path, browser):
    path = tmp_path / "report.html"
    content = toy_report()
    path.write_text(report.report_page(**content))
    browser.open(path)
    assert browser.run("document.title") == content["title"]
    # The first table is open; the rest is folded, but not on paper.
    hidden = (
        "[...document.querySelectorAll('table')].filter((table) =>"
        " !table.checkVisibility({ contentVisibilityAuto: true })).length"
    )
    assert browser.run(hidden) == 2
    browser.page.emulate_media(media="print")
    browser.wait(f"{hidden} === 0")
    assert browser.complaints == []


ARMS = {"never-switch": 0.0, "cfr-argmax": 0.5}


def test_each_table_has_its_own_races_and_the_papers_figures_only_by_its_rules(tmp_path):
    table = TableConfig(("Tarnfjord", "Brackwater"), ("never-switch", "somebody"), tuple(ARMS))
    config = StudyConfig(
        learning=LearningConfig(tracks=("Tarnfjord",)),
        table=table,
        further=replace(table, tracks=("Pipkin",)),
    )
    races = toy_races((*table.tracks, "Pipkin"), table.opponents, ARMS, 4, 4)
    seed = races.seed._replace(words=("0", "100"), codes=(races.track.codes == 2).astype(np.int8))
    races = replace(races, seed=seed)
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
