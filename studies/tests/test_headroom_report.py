"""``python -m studies headroom`` on three policies of which the fastest beats the others."""

import csv

import pytest

from studies.__main__ import main

POOL = ["--policies", "lattice:pace=0.2", "lattice:pace=0.5", "lattice:pace=1.0"]
SHORT = ["--duration", "4", "--races", "32", "--track", "Tarnfjord"]


def test_it_prints_the_table_and_draws(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    out = tmp_path / "headroom"
    assert main(["headroom", *POOL, *SHORT, "--lead-plans", "2", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Tarnfjord: the best fixed policy is lattice:pace=1.0" in printed
    assert "lead plan:" in printed
    with open(out / "headroom.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["track"] == "Tarnfjord"
    assert abs(float(row["H"])) < 0.1
    assert abs(float(row["in_slot"])) < 0.1
    assert len((out / "payoffs.csv").read_text(encoding="utf-8").splitlines()) == 1 + 6
    assert (out / "Tarnfjord.png").stat().st_size > 10_000
