"""``python -m studies headroom`` on three policies of which the fastest beats the others."""

import csv

import pytest

from studies.__main__ import main

POOL = ["--policies", "lattice:pace=0.2", "lattice:pace=0.5", "lattice:pace=1.0"]
SHORT = ["--duration", "4", "--races", "32", "--track", "Tarnfjord"]


def test_it_prints_the_table_and_draws(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    out = tmp_path / "headroom"
    assert main(["headroom", *POOL, *SHORT, "--out", str(out)]) == 0
    assert "Tarnfjord: the best fixed policy is lattice:pace=1.0" in capsys.readouterr().out
    with open(out / "headroom.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["track"] == "Tarnfjord"
    assert abs(float(row["H"])) < 0.1
    assert abs(float(row["in_slot"])) < 0.1
    assert len((out / "payoffs.csv").read_text(encoding="utf-8").splitlines()) == 1 + 6
    assert (out / "Tarnfjord.png").stat().st_size > 10_000


def test_lead_plans_are_raced_when_asked_for(tmp_path, capsys):
    out = tmp_path / "plans"
    assert main(["headroom", *POOL, *SHORT, "--lead-plans", "2", "--out", str(out)]) == 0
    assert "lead plan:" in capsys.readouterr().out
    with open(out / "lead_plans.csv", newline="") as file:
        (row,) = list(csv.DictReader(file))
    assert row["track"] == "Tarnfjord"
    assert {row["ahead"], row["behind"]} <= {
        "lattice:pace=0.2",
        "lattice:pace=0.5",
        "lattice:pace=1.0",
    }


@pytest.mark.parametrize("count", ["1", "17"])
def test_impossible_lead_plans_are_refused_before_any_race(count, tmp_path, capsys):
    assert main(["headroom", "--lead-plans", count, "--out", str(tmp_path / "headroom")]) == 2
    assert count in capsys.readouterr().err
    assert not (tmp_path / "headroom").exists()
