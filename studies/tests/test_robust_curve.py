"""The curve of gain against loss, in games of two moves."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.learning.responses.best_reply import race_on_circuits
from pcs_racing_agents.learning.robust import load_robust_settings
from studies.__main__ import main
from studies.robust_curve.curve import gain_over, robust_curve


@pytest.fixture(autouse=True)
def _with_torch():
    pytest.importorskip("torch", reason="torch is not installed")


def test_the_curve_is_measured_in_the_same_races(lesson, learner, tmp_path):
    games, pool, setting = lesson
    reply = load_response_settings(learner)
    settings = load_robust_settings(rounds=1, learner=learner)
    with open_job(tmp_path / "curve", "curve", {}) as job:
        points = robust_curve(games, pool, pool[0], setting, settings, reply, job, pool_shares=(0.5, 1.0), races=40)
        assert [point.pool_share for point in points] == [0.5, 1.0]
        assert all(point.gain.units == 80 and point.loss.units == 40 for point in points)
        own, other = (
            race_on_circuits(games, agent, pool[1], 40, 0, job, name=f"x-{i}") for i, agent in enumerate(pool)
        )
        assert gain_over([own], [own]).mean == 0.0
        assert gain_over([own], [other]).mean == pytest.approx(np.mean(own.score - other.score))
        with pytest.raises(InputError, match="side"):
            gain_over([own], [replace(other, side=1 - other.side)])
        for shares in ((), (0.5, 0.5), (1.5,)):
            with pytest.raises(InputError):
                robust_curve(games, pool, pool[0], setting, settings, reply, job, pool_shares=shares)


GAME = ["--track", "Tarnfjord", "--duration", "2.5"]


def test_the_curve_command_prints_the_table_and_draws(learner, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    config = tmp_path / "settings.yaml"
    config.write_text(f"rounds: 1\nlearner: {learner}\n", encoding="utf-8")
    out = tmp_path / "curve"
    command = ["robust-curve", *GAME, "--config", str(config), "--reply", learner, "--out", str(out)]
    assert main([*command, "--shares", "0.5", "1", "--races", "40", "--pool", "never-switch"]) == 0
    printed = capsys.readouterr().out
    with open(out / "curve.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["pool_share"] for row in rows] == ["0.5", "1"]
    for row in rows:
        assert f"{float(row['loss']):+.3f}" in printed
    assert (out / "curve.png").stat().st_size > 10_000
    assert (out / "p-0.5" / "set.yaml").is_file()


@pytest.mark.parametrize(("shares", "message"), [(["0.5", "2"], "is 2.0"), (["0.5", "0.5"], "each once")])
def test_impossible_shares_are_refused_before_anything_begins(shares, message, tmp_path, capsys):
    assert main(["robust-curve", *GAME, "--shares", *shares, "--out", str(tmp_path / "curve")]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "this takes" not in err
    assert not (tmp_path / "curve").exists()
