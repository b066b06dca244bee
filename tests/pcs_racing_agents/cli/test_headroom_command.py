"""``pcs-racing headroom`` on three policies of which the fastest beats the others."""

import csv

import pytest

from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.cli.main import main

POOL = ["--policies", "lattice:pace=0.2", "lattice:pace=0.5", "lattice:pace=1.0"]
SHORT = ["--duration", "4", "--races", "32", "--track", "Tarnfjord"]


def test_it_prints_the_table_and_writes_files(tmp_path, capsys):
    out = tmp_path / "headroom"
    assert main(["headroom", *POOL, *SHORT, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Tarnfjord: the best fixed policy is lattice:pace=1.0" in printed
    with open(out / "headroom.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["track"] == "Tarnfjord"
    assert abs(float(row["H"])) < 0.1
    with open(out / "payoffs.csv", newline="") as file:
        payoffs = {(line["policy"], line["opponent"]): float(line["payoff"]) for line in csv.DictReader(file)}
    assert len(payoffs) == 6
    assert payoffs["lattice:pace=1.0", "lattice:pace=0.2"] == -payoffs["lattice:pace=0.2", "lattice:pace=1.0"] > 0.0


def test_without_a_size_a_small_archive_races_as_a_whole(archive, tmp_path):
    folder = save_archive(archive, tmp_path / "toy")
    assert main(["headroom", "--archive", str(folder), *SHORT, "--out", str(tmp_path / "headroom")]) == 0
    with open(tmp_path / "headroom" / "payoffs.csv", newline="") as file:
        assert len({line["policy"] for line in csv.DictReader(file)}) == len(archive)


@pytest.mark.parametrize(
    ("wrong", "value"),
    [
        (["--size", "2"], "2"),
        (["--size", "1000"], "1000"),
        (["--races", "33"], "33"),
        (["--archive", "nobody's"], "nobody's"),
    ],
)
def test_impossible_pools_are_refused_before_any_race(tmp_path, capsys, wrong, value):
    assert main(["headroom", *wrong, "--out", str(tmp_path / "headroom")]) == 2
    assert value in capsys.readouterr().err
    assert not (tmp_path / "headroom").exists()
