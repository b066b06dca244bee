"""Drivers of others race unchanged: small ones of the forms in use, and others' where there is a checkout."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, RaceConfig, Starts, drivers_from, load_track, parse_policy, run_races
from pcs_racing.planners import registry
from pcs_racing_agents.cli.main import main

FILE = """
import numpy as np
from beside import FAST

class Helper:
    pass

class Farthest:
    def process_lidar(self, ranges):
        assert ranges.shape == (1080,) and ranges.max() <= 30.0
        return FAST, 0.5 * (np.argmax(ranges[270:-270]) - 270) * 4.7 / 1079

class Counts(Farthest):
    calls = 0
    def process_observation(self, ranges, ego_odom):
        self.calls += 1
        self.x = getattr(self, "x", ego_odom["pose_x"])
        assert self.calls > 1 or abs(ego_odom["pose_x"] - self.x) == 0.0, "two races share a driver"
        return 1.0 + 0.01 * self.calls, self.process_lidar(ranges)[1]

class Plans:
    def plan(self, obs):
        assert obs["vehicle_state"][3] == obs["vehicle_speed"] == obs["linear_vel_x"]
        return np.array([0.5 * (np.argmax(obs["scan"][270:-270]) - 270) * 4.7 / 1079, 2.5])

class Fails:
    def __init__(self, needs):
        pass
    def process_lidar(self, ranges):
        return 1.0, 0.0
"""


@pytest.fixture
def file(tmp_path, monkeypatch) -> Path:
    """A file with drivers, which are forgotten after the test."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    (tmp_path / "beside.py").write_text("FAST = 3.0\n")
    (tmp_path / "theirs.py").write_text(FILE)
    return tmp_path / "theirs.py"


def test_all_forms_drive_and_every_race_has_its_own_driver(file):
    drivers = drivers_from(file)
    assert list(drivers) == ["Farthest", "Counts", "Plans", "Fails"]
    track = load_track("Tarnfjord")
    egos = [drivers["Farthest"], drivers["Counts"], drivers["Counts"], drivers["Plans"]]
    config = RaceConfig(duration=4.0, start="rolling", start_gap=20.0, start_spacing=0.0)
    starts = Starts(np.full(4, 20.0), np.ones(4, np.int64))
    result, again = (run_races(track, egos, parse_policy("pure-pursuit"), config, starts=starts) for _ in range(2))
    assert (result.state.progress[:, 0] > -20.0 + 0.9 * 4.0).all()
    assert not result.crashed.any()
    np.testing.assert_array_equal(again.state.cars, result.state.cars)


def test_a_driver_has_a_name_and_reaches_other_processes(file):
    policy = drivers_from(file)["Plans"]
    assert policy.name == f"{file.as_posix()}:Plans"
    assert parse_policy(policy.name).planner is policy.planner
    assert [cls.__name__ for cls in pickle.loads(pickle.dumps(policy.planner)).drive.classes][2] == "Plans"


def test_the_command_line_takes_files(file, capsys):
    assert main(["race", "--ego", f"{file}:Counts", "--opponent", "pure-pursuit", "--duration", "1"]) == 0
    assert f"car 0: {file.as_posix()}:Counts" in capsys.readouterr().out


def test_what_is_no_driver_is_one_line(file):
    refused("there is no Python file", drivers_from, file.parent / "none.py")
    refused("has no driver: a class with a method", drivers_from, file.parent / "beside.py")
    (file.parent / "broken.py").write_text("import nothing_of_the_kind\n")
    refused("can't be loaded: ModuleNotFoundError", drivers_from, file.parent / "broken.py")
    fails = drivers_from(file)["Fails"]
    refused("Fails: TypeError", run_races, load_track("Pipkin"), [fails], fails, CONTEST)


def test_others_drivers_race_unchanged(monkeypatch):
    """``PCS_RACING_DRIVERS`` is a folder of checkouts, or a file."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    given = Path(os.environ.get("PCS_RACING_DRIVERS", "nowhere"))
    files = [given] if given.is_file() else [*given.rglob("drivers.py"), *given.rglob("drivers/*.py")]
    if not files:
        pytest.skip("PCS_RACING_DRIVERS holds no drivers")
    for theirs in files:
        for policy in drivers_from(theirs).values():
            result = run_races(load_track("Tarnfjord"), [policy], parse_policy("pure-pursuit"), CONTEST, seed=1)
            assert result.state.progress[0, 0] > 2.0
