import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from repository import python_blocks, read_page, run_block
from scipy import stats
from toy_races import STRENGTHS, of, toy_difference, toy_races, toy_table

from pcs_racing_agents.base.statistics import clustered_mean, compare, holm
from pcs_racing_agents.study import table_output as texts
from pcs_racing_agents.study.table import (
    PAPER_TABLE,
    ArmResult,
    Difference,
    TableRow,
    by_progress,
    make_table,
)
from pcs_racing_agents.tournament.race_files import race_table, read_results, write_results
from pcs_racing_agents.tournament.races import RaceRow


@pytest.fixture(scope="module")
def races():
    return toy_races()


@pytest.fixture(scope="module")
def table(races):
    return make_table(races, best="our-best", open_loop="best-fixed", train={"Tarnfjord"})


def test_every_row_says_what_the_statistics_say(races, table):
    """All of a table from the races of each cell: means, intervals within 0 to 1, shares,
    differences, p by Holm.
    """
    rows = []
    for track in ("Tarnfjord", "Brackwater"):
        for rival in ("never-switch", "random-policy", "somebody"):
            cells = {arm: of(races, track, rival, arm) for arm in STRENGTHS}
            (first, *others), start = cells, cells["never-switch"].start_s
            labels = cells[first].variants.T
            arms, differences = [], []
            for arm, cell in cells.items():
                mean = clustered_mean(cell.score, *labels, start)
                sd = cell.score.reshape(12, -1).mean(axis=1).std(ddof=1)
                shares = cell.crashed.mean(), (cell.fault[:, 0] > 0).mean()
                ends = max(mean.low, 0.0), min(mean.high, 1.0)
                arms.append(
                    ArmResult(arm, 1200, cell.score.mean(), *ends, pytest.approx(sd), *shares)
                )
            for arm, base in (*((arm, first) for arm in others), ("our-best", "best-fixed")):
                result = compare(cells[arm].score, cells[base].score, *labels, start=start)
                differences.append(Difference(arm, base, result))
            paper = PAPER_TABLE.get((rival, len(rows) < 3))
            rows.append(
                TableRow(
                    track,
                    rival,
                    len(rows) < 3,
                    paper,
                    5,
                    True,
                    tuple(arms),
                    tuple(differences[:-1]),
                    differences[-1],
                )
            )
    adjusted = [
        holm([one.result.p_clustered for one in column]).tolist()
        for column in zip(*((*row.differences, row.gain) for row in rows), strict=True)
    ]
    for row, expected, p_values in zip(table.rows, rows, zip(*adjusted, strict=True), strict=True):
        every = [
            replace(one, p_holm=p)
            for one, p in zip((*expected.differences, expected.gain), p_values, strict=True)
        ]
        assert row == replace(expected, differences=tuple(every[:-1]), gain=every[-1])
    assert (table.base, table.best, table.open_loop, table.arms) == (
        "never-switch",
        "our-best",
        "best-fixed",
        tuple(STRENGTHS),
    )


@pytest.mark.parametrize(
    ("egos", "variants", "lines", "drawn"),
    [(3, 2, 5, True), (3, 2, 4, False), (3, 2, 6, False), (5, 1, 5, False)],
)
def test_start_lines_are_clusters_where_pairs_share_enough_of_them(egos, variants, lines, drawn):
    row = make_table(
        toy_races(("a",), ("b",), {"one": -9.0, "two": 9.0}, egos, variants, lines)
    ).rows[0]
    assert (row.lines, row.lines_drawn, row.paper) == (lines, drawn, None)
    assert (row.arms[0].low, row.arms[1].high) == (0.0, 1.0)
    assert row.differences[0].result.opponents == variants
    races = of(toy_races(("a",), ("b",), {"one": 0.0}, egos, variants, lines), "a", "b", "one")
    kinds = [*races.variants.T[: 1 + (variants > 1)], *([races.start_s] if drawn else [])]
    (arm,) = make_table(races).rows[0].arms
    assert (arm.low, arm.high) == (
        pytest.approx(max(clustered_mean(races.score, *kinds).low, 0.0)),
        pytest.approx(min(clustered_mean(races.score, *kinds).high, 1.0)),
    )


def test_the_papers_statistic_counts_who_is_ahead_whatever_happened(races):
    ahead = by_progress(races)
    assert ahead.score.tolist() == (np.sign(races.lead) / 2 + 0.5).tolist()
    head, *rows = texts.paper_rows(make_table(ahead), "cfr-argmax")
    assert [row[:2] for row in rows] == [
        (row.track, row.opponent) for row in make_table(races).rows if row.paper
    ]
    ours, base = (of(ahead, *rows[0][:2], arm).score for arm in ("cfr-argmax", "never-switch"))
    egos = np.unique(of(ahead, *rows[0][:2], "cfr-argmax").variants[:, 0], return_inverse=True)[1]
    means = [np.bincount(egos, score) / np.bincount(egos) for score in (base, ours)]
    assert rows[0][2:4] == tuple(f"{mean.mean():.3f} ± {mean.std(ddof=1):.3f}" for mean in means)
    assert rows[0][head.index("p")] == texts.p_text(stats.ttest_rel(*means).pvalue)


def test_the_order_of_the_races_and_a_file_between_do_not_matter(races, tmp_path):
    """Within an arm: it is compared race by race whatever stands where."""
    ours = np.flatnonzero(races.agents.codes[:, 0] == races.agents.words.index("our-best"))
    order = np.arange(len(races))
    order[ours] = np.concatenate(
        [np.random.default_rng(1).permutation(piece) for piece in np.split(ours, 6)]
    )
    options = {"best": "our-best", "open_loop": "best-fixed", "train": {"Tarnfjord"}}
    assert make_table(races.take(order), **options) == make_table(races, **options)
    some = races.take(np.arange(0, len(races), 5))  # of each start line both sides or none
    rounded = replace(some, start_s=some.start_s + 1e-7)
    assert make_table(read_results(write_results(rounded, tmp_path / "results.csv"))) == make_table(
        rounded
    )


def test_two_start_lines_of_a_pair_may_share_a_place(races):
    """Lines repeat on a track with few places; a race that was raced twice is refused."""
    shared = replace(races, start_s=np.full(len(races), 94.0))
    for row, other in zip(make_table(shared).rows, make_table(races).rows, strict=True):
        assert (row.lines, row.lines_drawn) == (1, False)
        assert [one.result.difference for one in row.differences] == [
            one.result.difference for one in other.differences
        ]
    twice = shared.take([*range(len(shared)), 0])
    refused("more than once", make_table, twice)


def drives(races, arm):
    return races.agents.codes[:, 0] == races.agents.words.index(arm)


def test_what_does_not_fit_is_named(races):
    for change, message in [
        (lambda races: races.take([]), "there are no races"),
        (
            lambda races: races.take(~(drives(races, "never-switch") & (races.track.codes == 1))),
            "Brackwater against never-switch: 'never-switch'",
        ),
        (
            lambda races: races.take(~drives(races, "our-best") | (races.race > 0)),
            "Tarnfjord against never-switch, our-best: arm b",
        ),
        (lambda races: races.take(races.variants[:, 0] == 0), "ego labels are"),
    ]:
        refused(message, make_table, change(races))


def test_rows_may_lack_an_arm_and_an_open_loop_best_agent_a_gain(races):
    some = races.take(
        [k for k, r in enumerate(races) if r[1:4] != ("our-best", "random-policy", "Tarnfjord")]
    )
    table = make_table(some, best="our-best", open_loop="best-fixed")
    assert [arm.arm for arm in table.rows[1].arms] == ["never-switch", "best-fixed", "cfr-argmax"]
    assert table.rows[1].gain is None
    assert table.rows[2].gain is not None
    assert texts.table_text(table)
    table = make_table(races, best="best-fixed", open_loop="best-fixed")
    assert table.open_loop is None
    assert all(row.gain is None for row in table.rows)
    assert "Adaptivity" not in texts.table_text(table)


TEXT = """\
circuit opponent paper: GT still ours cfr-argmax ours - cfr-argmax
Tarnfjord (train) never-switch +0.054 0.500 +0.250* +0.125 +0.125
Hut (test) somebody 0.500 -0.250*
*: p (Holm) below 0.05

Tarnfjord (train) against never-switch
paper: 0.515 ± 0.251 non-GT, 0.569 ± 0.213 GT, difference +0.054, p 0.0142
agent score sd crash own fault difference 95 % interval p p (Holm) paired t
still 0.500 0.125 25.0% 12.5%
ours 0.750 0.062 50.0% 0.0% +0.250 [+0.125, +0.375] 2.5e-03 5.0e-03 2.5e-04
cfr-argmax 0.625 0.000 0.0% 0.0% +0.125 [-0.125, +0.375] 0.500 0.500 0.050
ours minus cfr-argmax +0.125 [-0.125, +0.375] 0.125 0.050 0.013

Hut (test) against somebody
agent score sd crash own fault difference 95 % interval p p (Holm) paired t
still 0.500 0.125 25.0% 12.5%
ours 0.750 0.062 50.0% 0.0% -0.250 [-0.312, -0.188] < 1e-99 1.0e-06 < 1e-99

Each agent drove 8 to 16 races in each row, the same ones"""

CSV = """\
kind,track,train,opponent,arm,base,races,egos,opponents,lines,score,score_base,score_sd,crash,own_crash,difference,\
low,high,p,p_holm,paired_t_p,cohen_d,paper_non_gt,paper_gt,paper_difference,paper_p
difference,Tarnfjord,1,never-switch,ours,still,8,2,4,5,0.75,0.5,0.0625,0.5,0,0.25,0.125,0.375,0.0025,0.005,\
0.00025,2,0.515,0.569,0.054,0.0142
difference,Tarnfjord,1,never-switch,cfr-argmax,still,8,2,4,5,0.625,0.5,0,0,0,0.125,\
-0.125,0.375,0.5,0.5,0.05,1,0.515,0.569,0.054,0.0142
adaptivity gain,Tarnfjord,1,never-switch,ours,cfr-argmax,8,2,4,5,0.75,0.625,0.0625,0.5,0,0.125,\
-0.125,0.375,0.125,0.05,0.0125,1,0.515,0.569,0.054,0.0142
difference,Hut,0,somebody,ours,still,8,2,4,2,0.25,0.5,0.0625,0.5,0,-0.25,-0.3125,-0.1875,1e-120,1e-06,\
1e-121,-2,,,,
"""


def test_text_and_csv_hold_every_number(table, tmp_path, races):
    toy = toy_table()
    text = re.sub(r" +\n", "\n", re.sub(" +", " ", texts.table_text(toy)))
    assert text[: len(TEXT)] == TEXT
    assert texts.write_table(toy, tmp_path / "toy.csv").read_text() == CSV
    assert texts.paper_rows(toy, "ours")[1:] == [
        (
            "Tarnfjord",
            "never-switch",
            "0.500 ± 0.125",
            "0.750 ± 0.062",
            "+0.250",
            "2.5e-04",
            "0.515 ± 0.251",
            "0.569 ± 0.213",
            "+0.054",
            "0.014",
        ),
    ]
    few, drawn = (
        "\n".join(texts.notes(replace(toy, rows=rows))) for rows in (toy.rows, toy.rows[:1])
    )
    assert "clusters of egos and opponents. Holm" in few
    assert "about these lines" in few
    assert "Each agent drove 8 races" in drawn
    assert "clusters of egos, opponents and start lines. Holm" in drawn
    assert "about these lines" not in drawn
    assert "Adaptivity gain: ours minus cfr-argmax" in few
    assert not any(
        "Adaptivity" in "".join(texts.notes(replace(toy, **{name: None})))
        for name in ("best", "open_loop")
    )
    p_values = (0.5, 0.0142, 0.01, 0.0099, 3e-9, 1e-99, 0.0, np.nan)
    words = ["0.500", "0.014", "0.010", "9.9e-03", "3.0e-09", "1.0e-99", "< 1e-99", "-"]
    assert [texts.p_text(p) for p in p_values] == words
    again = make_table(races, best="our-best", open_loop="best-fixed", train={"Tarnfjord"})
    one, two = (
        texts.write_table(made, tmp_path / name)
        for made, name in ((table, "a.csv"), (again, "b.csv"))
    )
    assert one.read_bytes() == two.read_bytes()
    assert len(list(csv.DictReader(one.read_text().splitlines()))) == 6 * (3 + 1)


def test_tables_of_a_study_are_told_apart_by_their_seeds():
    races = race_table(
        [
            RaceRow(
                ego=arm,
                opponent="b",
                track="Oval",
                start_s=float(line),
                seed=seed,
                winner=winner,
                ego_variant=ego,
                opponent_variant=variant,
            )
            for seed, winner in ((7, "ego"), (107, "opponent"))
            for arm in ("a", "c")
            for ego in range(2)
            for variant in range(2)
            for line in range(2)
        ]
    )
    refused(r"a raced b .*seeds 7 and 107", make_table, races)
    assert make_table(races.with_seeds(range(7, 9))).rows[0].arms[0].score == 1.0
    assert make_table(races.with_seeds([107])).rows[0].arms[0].score == 0.0


@pytest.mark.parametrize(
    ("differences", "words"),
    [
        (
            [0.0],
            (
                "no difference between a and b is certain: in all of 1 row (+0.000) the 95 %"
                " interval contains 0."
            ),
        ),
        ([0.2, 0.3], "a scores more in 2 of 2 rows than b (+0.200 to +0.300)."),
        (
            [0.2, 0.1, -0.2],
            (
                "a scores more in 1 and less in 1 of 3 rows than b (-0.200 to +0.200); "
                "in 1 the 95 % interval contains 0."
            ),
        ),
        ([-0.3], "a scores less in 1 of 1 row than b (-0.300)."),
    ],
)
def test_a_verdict_counts_the_rows_whose_interval_leaves_out_zero(differences, words):
    results = [toy_difference("a", "b", one, 0.0, 0.15, 0.5, 0.5).result for one in differences]
    assert texts.verdict_text("a", "b", results) == words


PAGE = read_page("run_the_study.md")


def test_a_table_is_made_again_from_the_races_with_the_columns_that_are_named(
    capsys, tmp_path, monkeypatch
):
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
    assert named == {"races", "low", "high"}
    assert named <= set(texts.CSV_COLUMNS)
