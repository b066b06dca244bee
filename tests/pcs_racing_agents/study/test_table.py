import csv

import numpy as np
import pytest
from pcs_racing_agents.study.cell_races import cell_races, read_races
from pcs_racing_agents.tournament.cells import play_cell
from toy_cells import toy_cells

from pcs_racing import InputError, make_game
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.study.table import PAPER_TABLE, make_table
from pcs_racing_agents.study.table_text import p_text, table_markdown, table_text, write_table
from pcs_racing_agents.tournament.statistics import compare, holm
from pcs_racing_agents.tournament.table import write_rows


@pytest.fixture(scope="module")
def cells():
    return toy_cells()


@pytest.fixture(scope="module")
def table(cells):
    return make_table(cells, best="our-best", blind="best-fixed", seen={"Tarnfjord"})


def test_the_papers_rows_stand_beside_the_rows_they_belong_to(table):
    assert [(row.track, row.opponent) for row in table.rows[:2]] == [
        ("Tarnfjord", "never-switch"),
        ("Tarnfjord", "random-policy"),
    ]
    assert [row.paper for row in table.rows] == [
        PAPER_TABLE["Non-GT", True],
        PAPER_TABLE["Random", True],
        None,
        PAPER_TABLE["Non-GT", False],
        PAPER_TABLE["Random", False],
        None,
    ]


def test_the_papers_own_differences_are_those_of_its_win_rates():
    for row in PAPER_TABLE.values():
        assert row.difference == pytest.approx(row.gt - row.non_gt, abs=1e-9)


def test_a_row_says_what_the_statistics_say(cells, table):
    ours, base = (cells["Brackwater", "random-policy", arm] for arm in ("cfr-argmax", "never-switch"))
    expected = compare(ours.score, base.score, base.ego, base.opponent, start=base.line)
    row = table.rows[4]
    found = next(one for one in row.differences if one.arm == "cfr-argmax")
    assert found.result == expected
    assert found.two_way == compare(ours.score, base.score, base.ego, base.opponent)
    arm = next(arm for arm in row.arms if arm.arm == "cfr-argmax")
    assert arm.score == expected.mean_a == pytest.approx(ours.score.mean())
    assert (arm.crash, arm.own_crash) == (ours.crash.mean(), ours.own_crash.mean())
    assert arm.sd == pytest.approx(ours.score.reshape(12, -1).mean(axis=1).std(ddof=1))
    assert arm.low < arm.score < arm.high
    assert row.gain.result.difference == pytest.approx(
        cells["Brackwater", "random-policy", "our-best"].score.mean()
        - cells["Brackwater", "random-policy", "best-fixed"].score.mean()
    )


def test_p_values_are_adjusted_over_the_rows(table):
    for arm in ("best-fixed", "cfr-argmax", "our-best"):
        found = [next(one for one in row.differences if one.arm == arm) for row in table.rows]
        assert [one.p_holm for one in found] == holm([one.result.p_clustered for one in found]).tolist()
    assert [row.gain.p_holm for row in table.rows] == holm([row.gain.result.p_clustered for row in table.rows]).tolist()


def test_the_order_of_the_races_does_not_matter(cells, table):
    order = np.random.default_rng(1).permutation(len(next(iter(cells.values())).score))
    mixed = {
        key: type(races)(*(column[order] for column in races)) if key[2] == "our-best" else races
        for key, races in cells.items()
    }
    assert make_table(mixed, best="our-best", blind="best-fixed", seen={"Tarnfjord"}) == table


def test_few_start_lines_are_taken_as_given():
    table = make_table(toy_cells(lines=2))
    assert not table.rows[0].lines_drawn
    assert table.rows[0].differences[0].result == table.rows[0].differences[0].two_way
    assert "about these lines" in table_text(table)
    own = toy_cells(tracks=("a",), opponents=("b",))
    pair = {key: races._replace(line=races.ego * 50 + races.opponent * 5 + races.line) for key, races in own.items()}
    assert make_table(pair).rows[0].lines == 600
    assert not make_table(pair).rows[0].lines_drawn


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda cells: {}, "there are no cells"),
        (lambda cells: {k: v for k, v in cells.items() if k[2] != "never-switch"}, "base is 'never-switch', which did"),
        (
            lambda cells: {k: v for k, v in cells.items() if k != ("Brackwater", "somebody", "never-switch")},
            "Brackwater against somebody: 'never-switch' did not race",
        ),
        (
            lambda cells: {k: type(v)(*(c[1:] for c in v)) if k[2] == "our-best" else v for k, v in cells.items()},
            "Tarnfjord against never-switch, our-best: arm b did not race unit",
        ),
        (
            lambda cells: {k: type(v)(*(c[v.ego == 0] for c in v)) for k, v in cells.items()},
            "there is 1 ego variant",
        ),
    ],
)
def test_what_does_not_fit_is_named(cells, change, message):
    with pytest.raises(InputError, match=message):
        make_table(change(cells), base="never-switch")


def test_rows_may_lack_an_arm(cells):
    some = {key: races for key, races in cells.items() if key != ("Tarnfjord", "random-policy", "our-best")}
    table = make_table(some, best="our-best", blind="best-fixed")
    assert [arm.arm for arm in table.rows[1].arms] == ["never-switch", "best-fixed", "cfr-argmax"]
    assert table.rows[1].gain is None
    assert table.rows[2].gain is not None
    assert table_text(table)


def test_a_blind_best_agent_has_no_adaptivity_gain(cells):
    table = make_table(cells, best="best-fixed", blind="best-fixed")
    assert table.blind is None
    assert all(row.gain is None for row in table.rows)
    assert "Adaptivity" not in table_text(table)


def test_text_and_markdown_hold_every_number(table):
    for text in (table_text(table), table_markdown(table)):
        for row in table.rows:
            for arm in row.arms:
                assert f"{arm.score:.3f}" in text
            for one in (*row.differences, row.gain):
                assert f"{one.result.difference:+.3f}" in text
                assert f"[{one.result.low:+.3f}, {one.result.high:+.3f}]" in text
        assert "0.515 ± 0.251 non-GT" in text
        assert "chosen on training races" in text
    assert all(line == line.rstrip() for line in table_text(table).splitlines())
    lines = table_markdown(table).splitlines()
    assert sum(line.startswith("| --- ") for line in lines) == 7


def test_p_values_are_short():
    assert [p_text(p) for p in (0.5, 0.0142, 0.0037, 3e-9, 0.0, np.nan)] == [
        "0.500",
        "0.014",
        "3.7e-03",
        "3.0e-09",
        "< 1e-99",
        "-",
    ]


def test_the_csv_has_a_line_for_every_comparison_and_the_same_bytes(tmp_path, table, cells):
    path = write_table(table, tmp_path / "table.csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 6 * (3 + 1)
    assert rows[3]["kind"] == "adaptivity gain"
    assert float(rows[0]["difference"]) == pytest.approx(table.rows[0].differences[0].result.difference, abs=1e-5)
    assert (rows[0]["paper_non_gt"], rows[11]["paper_gt"]) == ("0.515", "")
    again = make_table(cells, best="our-best", blind="best-fixed", seen={"Tarnfjord"})
    assert write_table(again, tmp_path / "again.csv").read_bytes() == path.read_bytes()


@pytest.fixture(scope="module")
def played(oval, archive):
    game = make_game(oval, archive, "paper", step_seconds=0.8)
    setting = make_setting(archive, game.config)
    rival = build("lane-switcher", setting)
    return [
        play_cell(game, build(arm, setting), rival, egos=3, opponents=2, lines=5, seed=3)
        for arm in ("never-switch", "always-aggressiveness+")
    ]


def test_races_that_were_driven_come_back_from_their_file(tmp_path, played):
    direct = {(cell.track, cell.opponent, cell.ego): cell_races(cell) for cell in played}
    rows = [row for cell in played for row in cell.rows()]
    read = read_races(write_rows(rows, "paper", tmp_path / "results.csv"))
    assert list(read) == list(direct)
    for key, races in direct.items():
        for name in ("score", "crash", "own_crash", "ego", "opponent", "side"):
            assert np.array_equal(getattr(read[key], name), getattr(races, name)), name
    first, second = make_table(direct), make_table(read)
    assert first.rows[0].differences == second.rows[0].differences


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("winner", "victor", "has no column 'winner'"),
        ("wall", "hedge", "line 2: crash is 'hedge'"),
        ("1.0000", "far", "line 2 is no race"),
        ("Oval,0", "Oval,", None),
    ],
)
def test_files_that_hold_no_races_are_refused(tmp_path, old, new, message):
    text = "track,race,ego,opponent,winner,crash,fault,ego_variant,opponent_variant,start_s,side,seed\n"
    text += "Oval,0,a,b,,wall,ego,1,2,1.0000,0,7\n"
    path = tmp_path / "results.csv"
    path.write_text(text.replace(old, new))
    if message is None:
        assert list(read_races(path)) == [("Oval", "b", "a")]
        return
    with pytest.raises(InputError, match=message):
        read_races(path)


def test_tables_of_a_study_are_told_apart_by_their_seeds(tmp_path):
    text = "track,race,ego,opponent,winner,crash,fault,ego_variant,opponent_variant,start_s,side,seed\n"
    path = tmp_path / "results.csv"
    path.write_text(text + "Oval,0,a,b,ego,,,1,2,1.0000,0,7\nOval,0,a,b,opponent,,,1,2,1.0000,0,107\n")
    with pytest.raises(InputError, match="a raced b on Oval with seeds 7 and 107"):
        read_races(path)
    assert read_races(path, seeds=range(7, 9))["Oval", "b", "a"].score.tolist() == [1.0]
    assert read_races(path, seeds=[107])["Oval", "b", "a"].score.tolist() == [0.0]
    assert read_races(path, seeds=[3]) == {}


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"can't read .*nothing\.csv"):
        read_races(tmp_path / "nothing.csv")
