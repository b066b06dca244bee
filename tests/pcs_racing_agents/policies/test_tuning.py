"""Tuning of a planner by races: a search, a choice and a check, as a resumable run."""

import csv
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from long_jobs import files
from refusal import refused

from pcs_racing import PAPER, load_track, racer
from pcs_racing.base.seeds import signed_seed
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.policies import TuningConfig, tune, tuning as module
from pcs_racing_agents.policies.tuning import beats_start, fitness

pytest.importorskip("cma")

TINY = TuningConfig(
    planner="pure-pursuit",
    start="pure-pursuit:pace=0",
    against=("pure-pursuit:pace=0.6", "gap-follower"),
    rules="paper",
    tracks=("Pipkin",),
    held_out=("Tarnfjord",),
    duration=6.0,
    generations=5,
    population=8,
    starts=2,
    check_starts=4,
    crash_limit=0.2,
)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """A result, its folder, and the calls of the callback."""
    folder, calls = tmp_path_factory.mktemp("tuning") / "made", []
    found = tune(TINY, folder, callback=lambda *call: calls.append(call))
    return found, folder, calls


def test_a_tuned_policy_is_better_than_the_start_and_stands_in_the_folder(tuned):
    found, folder, calls = tuned
    score = {
        policy: np.mean([line.score for line in found.check if line.policy == policy])
        for policy in ("start", "tuned")
    }
    assert score["tuned"] > score["start"] + 0.1
    settings = module.yaml.safe_load((folder / "tuned.yaml").read_text(encoding="utf-8"))
    assert settings["policy"] == found.policy.name
    assert settings["start"] == TINY.start
    assert settings["kept"] == found.kept
    assert found.kept.startswith("kept: the finalist; scores in the check: start 0.")
    with (folder / "progress.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["score"]) for line in lines] == pytest.approx(
        [step.score for step in found.course], abs=1e-4
    )
    assert [call[:3] for call in calls] == [
        *(("search", k, 5) for k in range(1, 6)),
        ("choice", 1, 1),
        ("check", 1, 1),
    ]


def test_a_line_of_the_check_counts_the_races_of_one_opponent_on_one_circuit(tuned):
    found, _, _ = tuned
    names = [(line.policy, line.track, line.held_out, line.opponent) for line in found.check]
    circuits = (("Pipkin", "no"), ("Tarnfjord", "yes"))
    assert names == [
        (policy, *circuit, opponent)
        for policy in ("start", "tuned")
        for circuit in circuits
        for opponent in TINY.against
    ]
    scenarios = module.draw_scenarios(
        TINY.planner,
        ("Pipkin", "Tarnfjord"),
        TINY.race_rules,
        rivals=TINY.against,
        starts=4,
        seed=signed_seed(np.random.SeedSequence(TINY.seed, spawn_key=(3,))),
    )
    races = np.flatnonzero((scenarios.track == 1) & (scenarios.opponent == 0))
    rival = racer(TINY.against[0])
    track, rules = load_track("Tarnfjord"), replace(PAPER, duration=6.0)
    setup = RaceSetup(track, rules, (rival.planner, rival.planner))
    starts = Starts(scenarios.start_s[races], scenarios.side[races])
    state = start_races(setup, starts, scenarios.seed[races])
    theta = np.array([[found.policy.parameters, rival.parameters]] * len(races))
    advance(setup, state, theta, 600)
    line = next(
        one
        for one in found.check
        if (one.policy, one.track, one.opponent) == ("tuned", "Tarnfjord", TINY.against[0])
    )
    assert line.races == len(races) == 8
    won = winners(rules, state)
    assert line.own_crash == (state.fault[:, 0] == 1).mean()
    assert line.score == pytest.approx(np.mean((won == 0) + 0.5 * ((won < 0) & ~state.crashed)))
    assert 0.0 <= line.low <= line.score <= line.high <= 1.0


def test_a_stopped_run_goes_on_with_the_same_result_on_any_workers(tuned, tmp_path):
    def stop(stage, done, total, state):
        if (stage, done) == ("search", 3):
            raise KeyboardInterrupt

    with ThreadPoolExecutor(2) as executor:
        with pytest.raises(KeyboardInterrupt):
            tune(TINY, tmp_path / "a", executor=executor, callback=stop)
        tune(TINY, tmp_path / "a", executor=executor)
    assert files(tmp_path / "a") == files(tuned[1])


def test_crashes_beyond_the_limit_cost_more_than_the_races_that_they_lose():
    found = SimpleNamespace(score=np.array([0.6, 0.6, 0.5]), own_crash=np.array([0.1, 0.3, 0.2]))
    assert fitness(found, 0.2) == pytest.approx([0.6, 0.3, 0.5])
    assert fitness(found, 0.2, 0.5) == pytest.approx([0.6, 0.45, 0.5])
    assert fitness(found, 0.2, 0.0) == pytest.approx(found.score)
    better = SimpleNamespace(
        score=np.array([0.5, 0.5, 0.6, 0.6]), own_crash=np.array([0.1, 0.0, 0.3, 0.2])
    )
    assert beats_start(better, 0.2).tolist() == [False, False, False, True]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"planner": "latice"}, "planner 'latice' is unknown; did you mean 'lattice'"),
        (
            {"planner": "lidar-ppo", "start": None, "fixed": ("speed_share",)},
            "planner 'lidar-ppo' has nothing to tune",
        ),
        ({"fixed": ("charm",)}, "planner 'pure-pursuit' has no parameter 'charm'"),
        (
            {"fixed": ("pace", "lookahead", "lookahead_time")},
            "has follow_distance to tune; the search needs 2 parameters",
        ),
        ({"start": "lattice"}, "start is 'lattice'; it must be a policy of planner"),
        ({"start": "pure-pursuit:pace=7"}, "parameter 'pace' is 7; it must lie in"),
        ({"held_out": ("Pipkin",)}, "held_out names 'Pipkin', a circuit of the search"),
        ({"against": ()}, "against is"),
        ({"against": ("nobody",)}, "'nobody' is no planner"),
        ({"step_size": float("nan")}, "step_size is nan"),
        ({"population": 3}, "population is 3"),
        ({"rules": "nothing.yaml"}, "rules 'nothing.yaml' are unknown"),
    ],
)
def test_impossible_settings_are_refused(changes, message):
    refused(message, replace, TINY, **changes)


def test_the_command(tmp_path, run):
    given = ["pure-pursuit", "--against", "gap-follower", "--track", "Pipkin"]
    small = ["--generations", 1, "--population", 4, "--starts", 1, "--duration", 2.0]
    small += ["--held-out", "Tarnfjord"]
    code, out, err = run("tune", *given, *small, "--out", tmp_path / "a")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()[:2]] == ["opponent", "gap-follower"]
    # A start that the search does not beat is kept, and wins ties.
    assert re.search(r"\nkept: the start; scores in the check: start 0\.\d+ \(own crashes \d", out)
    assert "\npure-pursuit\n" in out
    lines = (tmp_path / "a" / "check.csv").read_text().splitlines()
    start, tuned = (
        [line.partition(",")[2] for line in lines if line.startswith(policy)]
        for policy in ("start", "tuned")
    )
    assert start == tuned
    assert "1/1 generations" in err
    (row,) = [line for line in out.splitlines() if "held out" in line]
    assert row.split()[0] == "gap-follower"
    for wrong in (["nobody"], ["lattice", "--fixed", "charm"], ["lattice", "--start", "spliner"]):
        code, _, err = run("tune", *wrong, "--out", tmp_path / "b")
        assert code == 2
        assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "b").exists()
