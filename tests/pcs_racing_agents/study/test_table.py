import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused
from repository import python_blocks, read_page, run_block
from toy_races import STRENGTHS, of, toy_races, toy_table

from pcs_racing_agents.base.statistics import compare, holm
from pcs_racing_agents.study import table as texts
from pcs_racing_agents.study.table import (
    GAIN,
    NO_FIGURES,
    PAPER_TABLE,
    TableLine,
    by_progress,
    make_table,
)
from pcs_racing_agents.tournament.race_files import read_results, write_results

OPTIONS = {"best": "our-best", "open_loop": "best-fixed", "train": {"Tarnfjord"}, "paper": True}


@pytest.fixture(scope="module")
def races():
    return toy_races()


@pytest.fixture(scope="module")
def table(races):
    return make_table(races, **OPTIONS)


def test_every_line_says_what_the_statistics_say(races, table):
    """All of a table from the races of each cell: shares, differences, p by Holm."""
    lines = []
    pairs = [("score", "never-switch", "never-switch")]
    pairs += [("difference", arm, "never-switch") for arm in list(STRENGTHS)[1:]]
    pairs += [(GAIN, "our-best", "best-fixed")]
    for track in ("Tarnfjord", "Brackwater"):
        for rival in ("never-switch", "random-policy", "somebody"):
            cells = {arm: of(races, track, rival, arm) for arm in STRENGTHS}
            labels, start = cells["our-best"].variants.T, cells["our-best"].start_s
            for kind, arm, base in pairs:
                cell, train = cells[arm], track == "Tarnfjord"
                sd = cell.score.reshape(12, -1).mean(axis=1).std(ddof=1)
                lines.append(
                    TableLine(
                        *(kind, track, train, rival, arm, base, 5, pytest.approx(sd)),
                        crash=cell.crashed.mean(),
                        own_crash=(cell.fault[:, 0] > 0).mean(),
                        result=compare(cell.score, cells[base].score, *labels, start=start),
                        paper=PAPER_TABLE.get((rival, train), NO_FIGURES),
                    )
                )
    for kind, arm, _ in pairs:
        own = [k for k, line in enumerate(lines) if (line.kind, line.arm) == (kind, arm)]
        for k, p in zip(own, holm([lines[k].result.p_clustered for k in own]), strict=True):
            lines[k] = lines[k]._replace(p_holm=p)
    assert table == lines


@pytest.mark.parametrize(
    ("egos", "variants", "lines", "shared"),
    [(3, 2, 5, True), (3, 2, 4, False), (3, 2, 6, False), (5, 1, 5, False)],
)
def test_start_lines_are_clusters_where_pairs_share_enough_of_them(egos, variants, lines, shared):
    races = toy_races(("a",), ("b",), {"one": -9.0, "two": 9.0}, egos, variants, lines)
    _, line = make_table(races)
    one, two = (of(races, "a", "b", arm) for arm in ("one", "two"))
    start = one.start_s if shared else None
    assert line.result == compare(two.score, one.score, *one.variants.T, start=start)
    assert (line.lines, line.result.opponents) == (lines, variants)


def test_the_papers_statistic_counts_who_is_ahead_whatever_happened(races):
    assert by_progress(races).score.tolist() == (np.sign(races.lead) / 2 + 0.5).tolist()


def test_the_order_of_the_races_and_a_file_between_do_not_matter(races, table, tmp_path):
    """Within an agent: it is compared race by race in any order."""
    ours = np.flatnonzero(races.agents.codes[:, 0] == races.agents.words.index("our-best"))
    order = np.arange(len(races))
    order[ours] = np.concatenate(
        [np.random.default_rng(1).permutation(piece) for piece in np.split(ours, 6)]
    )
    assert make_table(races.take(order), **OPTIONS) == table
    some = races.take(np.arange(0, len(races), 5))  # of each start line both sides or none
    rounded = replace(some, start_s=some.start_s + 1e-7)
    assert make_table(read_results(write_results(rounded, tmp_path / "results.csv"))) == make_table(
        rounded
    )


def test_two_start_lines_of_a_pair_may_share_a_place(races, table):
    """Lines repeat on a track with few places; a race that was raced twice is refused."""
    shared = replace(races, start_s=np.full(len(races), 94.0))
    for line, other in zip(make_table(shared, **OPTIONS), table, strict=True):
        assert (line.lines, line.result.difference) == (1, other.result.difference)
    refused("more than once", make_table, shared.take([*range(len(shared)), 0]))


def drives(races, arm):
    return races.agents.codes[:, 0] == races.agents.words.index(arm)


@pytest.mark.parametrize(
    ("change", "message"),
    [
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
        (
            lambda races: replace(
                races, seed=races.seed._replace(words=("7", "107"), codes=races.side)
            ),
            "never-switch raced never-switch .*seeds 7 and 107",
        ),
    ],
)
def test_what_does_not_fit_is_named(races, change, message):
    refused(message, make_table, change(races))


def test_rows_may_lack_an_agent_and_an_open_loop_best_agent_a_gain(races):
    some = races.take(
        [k for k, r in enumerate(races) if r[1:4] != ("our-best", "random-policy", "Tarnfjord")]
    )
    table = make_table(some, best="our-best", open_loop="best-fixed")
    second = [
        line.arm for line in table if (line.track, line.opponent) == ("Tarnfjord", "random-policy")
    ]
    assert second == ["never-switch", "best-fixed", "cfr-argmax"]
    assert sum(line.kind == GAIN for line in table) == 5
    assert texts.table_text(table)
    table = make_table(races, best="best-fixed", open_loop="best-fixed")
    assert all(line.kind != GAIN for line in table)


TEXT = """\
circuit opponent still ours cfr-argmax ours - cfr-argmax paper: GT
Tarnfjord (train) never-switch 0.500 +0.250* +0.125 +0.125 +0.054
Hut (test) somebody 0.500 -0.250*

circuit opponent agent score sd crash own fault difference 95 % interval p p (Holm) paired t
Tarnfjord (train) never-switch still 0.500 0.125 25.0% 12.5% +0.000 [+0.000, +0.000] 1 1 0.1
Tarnfjord (train) never-switch ours 0.750 0.000 25.0% 12.5% +0.250 [+0.125, +0.375] \
0.0025 0.005 0.00025
Tarnfjord (train) never-switch cfr-argmax 0.625 0.000 25.0% 12.5% +0.125 [-0.125, +0.375] \
0.5 0.5 0.05
Tarnfjord (train) never-switch ours - cfr-argmax 0.750 0.000 25.0% 12.5% \
+0.125 [-0.125, +0.375] 0.12 0.05 0.013
Hut (test) somebody still 0.500 0.000 25.0% 12.5% +0.000 [+0.000, +0.000] 1 1 0.1
Hut (test) somebody ours 0.250 0.000 25.0% 12.5% -0.250 [-0.312, -0.188] 1e-120 1e-06 1e-121

All agents of a row drove the same races."""

CSV = """\
kind,track,train,opponent,arm,base,races,egos,opponents,lines,score,score_base,score_sd,crash,own_crash,difference,\
low,high,p,p_holm,paired_t_p,cohen_d,paper_non_gt,paper_gt,paper_difference,paper_p
score,Tarnfjord,1,never-switch,still,still,8,2,4,5,0.5,0.5,0.125,0.25,0.125,0,0,0,1,1,0.1,0,0.515,0.569,0.054,0.0142
difference,Tarnfjord,1,never-switch,ours,still,8,2,4,5,0.75,0.5,0,0.25,0.125,0.25,0.125,0.375,0.0025,0.005,\
0.00025,2,0.515,0.569,0.054,0.0142
difference,Tarnfjord,1,never-switch,cfr-argmax,still,8,2,4,5,0.625,0.5,0,0.25,0.125,0.125,\
-0.125,0.375,0.5,0.5,0.05,1,0.515,0.569,0.054,0.0142
adaptivity gain,Tarnfjord,1,never-switch,ours,cfr-argmax,8,2,4,5,0.75,0.625,0,0.25,0.125,0.125,\
-0.125,0.375,0.125,0.05,0.0125,1,0.515,0.569,0.054,0.0142
score,Hut,0,somebody,still,still,8,2,4,5,0.5,0.5,0,0.25,0.125,0,0,0,1,1,0.1,0,,,,
difference,Hut,0,somebody,ours,still,8,2,4,5,0.25,0.5,0,0.25,0.125,-0.25,-0.3125,-0.1875,1e-120,1e-06,\
1e-121,-2,,,,
"""


def test_text_and_csv_hold_every_number(tmp_path):
    toy = toy_table()
    text = re.sub(r" +\n", "\n", re.sub(" +", " ", texts.table_text(toy)))
    assert text[: len(TEXT)] == TEXT
    assert text.endswith("ours - cfr-argmax: gain over the best baseline in training.\n")
    assert texts.write_table(toy, tmp_path / "toy.csv").read_text() == CSV
    few = texts.notes([line._replace(lines=2) for line in toy[:1]])
    assert "clusters of egos and opponents;" in few
    assert "clusters of egos, opponents and start lines;" in texts.notes(toy)
    assert "baseline" not in few


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
    lines = csv.DictReader((results.parent / "table-again.csv").read_text().splitlines())
    assert {"low", "high"} <= set(re.findall(r"`([a-z_]+)`", PAGE)) & set(lines.fieldnames)
