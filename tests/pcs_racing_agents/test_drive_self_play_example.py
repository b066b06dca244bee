import re

import pytest
from repository import REPOSITORY, run_python

EXAMPLE = REPOSITORY / "examples" / "drive_self_play.py"


def test_it_learns_and_races_in_a_small_setting(tmp_path):
    pytest.importorskip("stable_baselines3")
    size = ("--steps", "512", "--envs", "8", "--rollout", "64", "--races", "2", "--duration", "2")
    out = run_python(EXAMPLE, *size, "--track", "Pipkin", folder=tmp_path)
    assert re.search(
        r"^ +512 steps .* about +0\.0 left .* won against lattice: \d+% .paper., \d+% .contest.$", out, re.M
    )
    rows = re.findall(r"^(\S.*?) +(paper|contest) +([\d.]+)% +\S+ +([\d.]+)%$", out, re.M)
    assert [row[:2] for row in rows] == [
        ("lattice, archive default", "paper"),
        ("ppo-drive", "paper"),
        ("lattice, archive contest", "contest"),
        ("ppo-drive", "contest"),
    ]
    assert all(0.0 <= float(won) <= 100.0 for _, _, won, _ in rows)
