import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from repository import python_blocks, read_page, run_block
from scipy import stats
from toy_races import of, toy_races

from pcs_racing_agents.results.race_files import race_table, read_results, write_results
from pcs_racing_agents.results.races import RaceRow
from pcs_racing_agents.study import table_text as texts
from pcs_racing_agents.study.table import PAPER_TABLE, by_progress, make_table
from pcs_racing_agents.tournament.statistics import compare, holm


@pytest.fixture(scope="module")
def races():
    return toy_races()


@pytest.fixture(scope="module")
def table(races):
    return make_table(races, best="our-best", open_loop="best-fixed", seen={"Tarnfjord"})


def test_the_papers_rows_stand_beside_theirs_and_p_values_are_adjusted(table):
    assert [(row.track, row.opponent) for row in table.rows[:2]] == [
        ("Tarnfjord", "never-switch"),
        ("Tarnfjord", "random-policy"),
    ]
    assert [row.paper for row in table.rows] == [
        PAPER_TABLE["Non-GT", True], PAPER_TABLE["Random", True], None, PAPER_TABLE["Non-GT", False],
        PAPER_TABLE["Random", False], None,
    ]  # fmt: skip
    for arm in ("best-fixed", "cfr-argmax", "our-best"):
        result = [next(one for one in row.differences if one.arm == arm) for row in table.rows]
        assert [one.p_holm for one in result] == holm([one.result.p_clustered for one in result]).tolist()
    assert [row.gain.p_holm for row in table.rows] == holm([row.gain.result.p_clustered for row in table.rows]).tolist()
    told = ["0.500", "0.014", "3.7e-03", "3.0e-09", "< 1e-99", "-"]
    assert [texts.p_text(p) for p in (0.5, 0.0142, 0.0037, 3e-9, 0.0, np.nan)] == told


def test_a_row_says_what_the_statistics_say(races, table):
    ours, base = (of(races, "Brackwater", "random-policy", arm) for arm in ("cfr-argmax", "never-switch"))
    expected = compare(ours.score, base.score, *base.variants.T, start=base.start_s)
    row = table.rows[4]
    result = next(one for one in row.differences if one.arm == "cfr-argmax")
    assert result.result == expected
    assert result.two_way == compare(ours.score, base.score, *base.variants.T)
    arm = next(arm for arm in row.arms if arm.arm == "cfr-argmax")
    assert arm.score == expected.mean_a == pytest.approx(ours.score.mean())
    assert (arm.crash, arm.own_crash) == (ours.crashed.mean(), ours.fault[:, 0].mean())
    assert arm.sd == pytest.approx(ours.score.reshape(12, -1).mean(axis=1).std(ddof=1))
    assert arm.low < arm.score < arm.high
    best, open_loop = (of(races, "Brackwater", "random-policy", arm) for arm in ("our-best", "best-fixed"))
    assert row.gain.result.difference == pytest.approx(best.score.mean() - open_loop.score.mean())


def test_the_papers_statistic_counts_who_is_ahead_whatever_happened(races):
    ahead = by_progress(races)
    assert ahead.score.tolist() == (np.sign(races.lead) / 2 + 0.5).tolist()
    head, *rows = texts.paper_rows(make_table(ahead), "cfr-argmax")
    assert [row[:2] for row in rows] == [(row.track, row.opponent) for row in make_table(races).rows if row.paper]
    ours, base = (of(ahead, *rows[0][:2], arm).score for arm in ("cfr-argmax", "never-switch"))
    egos = np.unique(of(ahead, *rows[0][:2], "cfr-argmax").variants[:, 0], return_inverse=True)[1]
    means = [np.bincount(egos, score) / np.bincount(egos) for score in (base, ours)]
    assert rows[0][2:4] == tuple(f"{mean.mean():.3f} ± {mean.std(ddof=1):.3f}" for mean in means)
    assert rows[0][head.index("p")] == texts.p_text(stats.ttest_rel(*means).pvalue)


def test_the_order_of_the_races_and_a_file_between_do_not_matter(races, tmp_path):
    """Within an arm: it is compared race by race whatever stands where."""
    ours = np.flatnonzero(races.agents.codes[:, 0] == races.agents.words.index("our-best"))
    order = np.arange(len(races))
    order[ours] = np.concatenate([np.random.default_rng(1).permutation(piece) for piece in np.split(ours, 6)])
    options = {"best": "our-best", "open_loop": "best-fixed", "seen": {"Tarnfjord"}}
    assert make_table(races.take(order), **options) == make_table(races, **options)
    some = races.take(np.arange(0, len(races), 5))  # of each start line both sides or none
    rounded = replace(some, start_s=some.start_s + 1e-7)
    assert make_table(read_results(write_results(rounded, tmp_path / "results.csv"))) == make_table(rounded)


def test_few_start_lines_are_taken_as_given():
    table = make_table(toy_races(lines=2))
    assert not table.rows[0].lines_drawn
    assert table.rows[0].differences[0].result == table.rows[0].differences[0].two_way
    assert "about these lines" in texts.table_text(table)
    own = toy_races(tracks=("a",), opponents=("b",))
    apart = replace(own, start_s=own.variants @ [50.0, 5.0] + own.start_s)  # each pair has lines of its own
    assert make_table(apart).rows[0].lines == 600
    assert not make_table(apart).rows[0].lines_drawn


def drives(races, arm):
    return races.agents.codes[:, 0] == races.agents.words.index(arm)


def test_what_does_not_fit_is_named(races):
    for change, message in [
        (lambda races: races.take([]), "there are no races"),
        (lambda races: races.take(~drives(races, "never-switch")), "base is 'never-switch'"),
        (
            lambda races: races.take(~(drives(races, "never-switch") & (races.track.codes == 1))),
            "Brackwater against never-switch: 'never-switch'",
        ),
        (
            lambda races: races.take(~drives(races, "our-best") | (races.race > 0)),
            "Tarnfjord against never-switch, our-best: arm b",
        ),
        (lambda races: races.take(races.variants[:, 0] == 0), "1 ego variant"),
    ]:
        refused(message, make_table, change(races), base="never-switch")


def test_rows_may_lack_an_arm_and_an_open_loop_best_agent_a_gain(races):
    some = races.take([k for k, r in enumerate(races) if r[1:4] != ("our-best", "random-policy", "Tarnfjord")])
    table = make_table(some, best="our-best", open_loop="best-fixed")
    assert [arm.arm for arm in table.rows[1].arms] == ["never-switch", "best-fixed", "cfr-argmax"]
    assert table.rows[1].gain is None
    assert table.rows[2].gain is not None
    assert texts.table_text(table)
    table = make_table(races, best="best-fixed", open_loop="best-fixed")
    assert table.open_loop is None
    assert all(row.gain is None for row in table.rows)
    assert "Adaptivity" not in texts.table_text(table)


def test_text_markdown_and_csv_hold_every_number(table, tmp_path, races):
    for text in (texts.table_text(table), texts.table_markdown(table)):
        for row in table.rows:
            for arm in row.arms:
                assert f"{arm.score:.3f}" in text
            for one in (*row.differences, row.gain):
                assert f"{one.result.difference:+.3f}" in text
                assert f"[{one.result.low:+.3f}, {one.result.high:+.3f}]" in text
        assert "0.515 ± 0.251 non-GT" in text
        assert "chosen on training races" in text
    assert all(line == line.rstrip() for line in texts.table_text(table).splitlines())
    lines = texts.table_markdown(table).splitlines()
    assert sum(line.startswith("| --- ") for line in lines) == 7
    path = texts.write_table(table, tmp_path / "table.csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 6 * (3 + 1)
    assert rows[3]["kind"] == "adaptivity gain"
    assert float(rows[0]["difference"]) == pytest.approx(table.rows[0].differences[0].result.difference, abs=1e-5)
    assert (rows[0]["paper_non_gt"], rows[11]["paper_gt"]) == ("0.515", "")
    again = make_table(races, best="our-best", open_loop="best-fixed", seen={"Tarnfjord"})
    assert texts.write_table(again, tmp_path / "again.csv").read_bytes() == path.read_bytes()


def test_tables_of_a_study_are_told_apart_by_their_seeds():
    races = race_table([
        RaceRow(ego=arm, opponent="b", track="Oval", start_s=float(line), seed=seed, winner=winner, ego_variant=ego,
                opponent_variant=variant)
        for seed, winner in ((7, "ego"), (107, "opponent"))
        for arm in ("a", "c") for ego in range(2) for variant in range(2) for line in range(2)
    ])  # fmt: skip
    refused(r"a raced b .*seeds 7 and 107", make_table, races)
    assert make_table(races.with_seeds(range(7, 9))).rows[0].arms[0].score == 1.0
    assert make_table(races.with_seeds([107])).rows[0].arms[0].score == 0.0


def test_a_verdict_counts_the_rows_whose_interval_leaves_out_zero():
    for shifts, words in [
        ((0.0,), "a and b can't be told apart: in all of 1 row"),
        ((1.0, 2.0), "a scores more in 2 of 2 rows than b"),
        ((1.0, -1.0, 0.0), "a scores more in 1 and less in 1 of 3 rows than b"),
    ]:
        ego, opponent = (axis.ravel() for axis in np.meshgrid(np.arange(10), np.arange(10)))
        noise = 0.1 * (-1.0) ** (ego + opponent)
        results = [compare(noise + shift, np.zeros(100), ego, opponent) for shift in shifts]
        assert texts.verdict_text("a", "b", results).startswith(words)


PAGE = read_page("run_the_study.md")


def test_a_table_is_made_again_from_the_races_with_the_columns_that_are_named(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "out" / "my-study" / "results.csv"
    results.parent.mkdir(parents=True)
    write_results(toy_races(tracks=("Tarnfjord",), egos=3, variants=3), results)
    (code,) = python_blocks(PAGE)
    run_block(code)
    assert capsys.readouterr().out.strip() != ""
    assert (results.parent / "table-again.csv").is_file()
    words = re.findall(r"`([a-z_]+)`", PAGE)
    named = {name for name in words if name in texts.CSV_COLUMNS or name.endswith(("low", "high"))}
    assert named == {"races", "low", "high", "two_way_low", "two_way_high"}
    assert named <= set(texts.CSV_COLUMNS)
