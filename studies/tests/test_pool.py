"""Gains pooled over studies of several archives, on tables with known scores."""

from refusal import refused

from pcs_racing_agents.base.tables import write_csv
from studies.__main__ import main
from studies.pool import gain_rows, pool, read_table, won_in_front

HEAD = ("kind", "track", "train", "opponent", "arm", "base", "score", "score_base", "own_crash")

FRONT = (("0", "ego"), ("1", "ego"), ("0", "none"), ("1", "opponent"))
"""Start side of the ego (0 is in front) and winner; the car in front wins the first and last."""


def study(folder, gain):
    """Tables where the response wins ``gain`` more than the baseline, and 0.1 more on Monza."""
    folder.mkdir()
    for name, opponent in (("table", "random-moves"), ("table_further", "stanley")):
        rows = [HEAD]
        for track, train, more in (("Pipkin", 1, 0.0), ("Monza", 0, 0.1)):
            for arm, score in (("best-fixed", 0.6), ("response", 0.6 + gain + more)):
                cell = track, train, opponent
                rows.append(("difference", *cell, arm, "never-switch", score, 0.4, 0.05))
            rows.append(("adaptivity gain", *cell, "response", "best-fixed", score, 0.6, 0.05))
        write_csv(rows, folder / f"{name}.csv")
    return folder


def test_gains_are_over_the_baseline_of_each_study(tmp_path):
    folders = [study(tmp_path / name, gain) for name, gain in (("a", 0.0), ("b", 0.02))]
    rows = gain_rows(pool([read_table(folder) for folder in folders]))
    assert rows[0] == (
        "agent",
        "random-moves, training",
        "held-out planners, training",
        "random-moves, test",
        "held-out planners, test",
        "all",
        "own crashes",
    )
    lines = {row[0]: row[1:] for row in rows[1:]}
    # Student's t with 1 degree of freedom: 12.7 standard errors of 0.01.
    assert lines["`response`"][0] == "+0.010 [-0.117, +0.137]"
    assert lines["`response`"][2] == "+0.110 [-0.017, +0.237]"
    assert lines["`response`"][-1] == "0.050"
    assert lines["`best-fixed`"][0] == "+0.000 [+0.000, +0.000]"
    assert lines["`never-switch`"][0] == "-0.200 [-0.200, -0.200]"
    assert lines["`never-switch`"][-1] == ""


def test_unfinished_studies_and_a_single_one_are_refused(tmp_path, capsys):
    one = study(tmp_path / "a", 0.0)
    refused("there is no .*table.csv; give folders of finished studies", read_table, tmp_path)
    assert main(["pool", str(one), "--out", str(tmp_path / "out")]) == 2
    assert "at least two studies" in capsys.readouterr().err


def test_races_won_by_the_car_in_front(tmp_path):
    assert won_in_front(tmp_path) is None
    races = [("never-switch", "never-switch", side, winner) for side, winner in FRONT]
    other = ("never-switch", "stanley", "0", "opponent")
    write_csv([("ego", "opponent", "side", "winner"), *races, other], tmp_path / "results.csv")
    assert won_in_front(tmp_path) == 0.5


def test_a_study_counts_once(tmp_path, capsys):
    folders = [study(tmp_path / name, 0.0) for name in "ab"]
    assert main(["pool", *map(str, folders), "--out", str(tmp_path / "out")]) == 2
    assert "give each study once" in capsys.readouterr().err
