"""The overtaking protocol: its scenarios, lines and counts."""

import numpy as np
import pytest
from placed_cars import view_of
from refusal import refused

from pcs_racing import load_track, racer
from pcs_racing.base.errors import MapError
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.pursuit import hold_command
from pcs_racing.planners.view import OWN_WIDTH, PATH_POINTS, PATH_SPEED
from pcs_racing.race.config import Rules
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.frenet import LEFT
from studies.__main__ import main
from studies.overtaking.overtaken import overtaken
from studies.overtaking.scenarios import (
    AHEAD,
    Lines,
    joined,
    made_lines,
    race_scenarios,
    read_lines,
    summary,
)


@pytest.fixture(scope="module")
def lines() -> Lines:
    return made_lines(load_track("Brackwater"))


def test_lanes_lie_beside_the_race_line_between_the_walls(lines):
    left, race, right = lines.d
    assert (race == 0.0).all()
    assert left.max() == pytest.approx(0.57)
    assert -0.57 <= right.min() < -0.3
    s = np.arange(len(left)) / len(left) * lines.track.length
    off_line = np.abs(left) > 0.05
    assert (
        lines.track.wall_distance(
            lines.track.to_cartesian(np.stack([s, left], axis=-1))[off_line, :2]
        )
        > 0.3
    ).all()
    assert (np.abs(np.diff(lines.d, axis=1)) < 0.1).all()


def test_an_opponent_passes_nobody_who_stands_and_drives_its_lines_without_a_crash(lines):
    found = race_scenarios(
        lines, Planner("parked", (), control=hold_command, memory_size=2).policy()
    )
    assert len(found.start) == 600
    assert len(set(found.start)) == 50
    assert len(set(zip(found.line.tolist(), found.factor.tolist(), strict=True))) == 3 * 4
    assert not found.overtakes.any()
    assert found.safe.mean() > 0.98
    assert set(found.fault[~found.safe]) <= {2}


def test_the_opponent_reads_speeds_between_samples_and_leaves_5_cm_to_the_wall():
    track = load_track("Brackwater")
    planner = overtaken(samples := int(track.length))
    setup = RaceSetup(track, Rules(start_gap=20.0), (planner, planner))
    state = start_races(setup, Starts(np.zeros(1), np.zeros(1, np.int64)), np.zeros(1, np.uint64))
    x, y, psi = track.to_cartesian([0.0, d := track.line[0, LEFT] - 0.4])
    state.cars[0, 0], state.frenet[0, 0] = [x, y, 0.0, 4.0, psi, 0.0, 0.0], [0.0, d]
    view = view_of(setup, state, 0, 0)
    speeds = np.random.default_rng(0).uniform(5.0, 10.0, samples)
    paths = np.zeros((2, PATH_POINTS, 4))
    for line_d, path in zip((d, 9.0), paths, strict=True):  # 9 m: beyond the wall
        theta = np.concatenate([[0.5, samples], np.full(samples, line_d), speeds])
        planner.plan(track.arrays, theta, view, np.zeros(0), np.zeros(planner.scratch_size), path)
    (s, _), (end, aside) = (track.to_frenet(path[-1, :2]) for path in paths)
    places = np.arange(samples + 1) * track.length / samples
    expected = 0.5 * np.interp(s, places, np.append(speeds, speeds[0]))
    assert paths[0, -1, PATH_SPEED] == pytest.approx(expected, rel=1e-3)
    wall = np.interp(end, np.arange(len(track.line)) * track.arrays.ds, track.line[:, LEFT])
    assert wall - aside - 0.5 * view[OWN_WIDTH] == pytest.approx(0.05, abs=0.02)


def test_a_faster_car_overtakes_slow_ones_more_often_and_one_seed_has_one_result(lines):
    one, again = (race_scenarios(lines, racer("predictive-spliner"), threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.overtakes, again.overtakes)
    assert not (one.overtakes & ~one.safe).any()
    slow, fast = (one.overtakes[one.factor == factor].mean() for factor in (0.5, 0.8))
    assert slow > fast > 0.1
    table = summary({"twice": joined([one, one])})
    assert f"{one.overtakes.mean():.1%}" in table[1]
    assert "59.2%" in table[2]


def write_line(folder, lines, k, change=lambda table: None, backwards=False):
    """Write a line of a track as a file, changed or in the other direction."""
    track, count = lines.track, lines.d.shape[1]
    s = np.arange(count) * track.length / count
    xy = track.to_cartesian(np.stack([s, lines.d[k]], axis=-1))[:, :2]
    step = -1 if backwards else 1
    table = np.column_stack([s, xy[::step], s * 0.0, s * 0.0, lines.speed[k][::step], s * 0.0])
    change(table)
    file, head = folder / f"Brackwater_line{k}.csv", "s; x; y; psi; kappa; v; a"
    np.savetxt(file, table, delimiter=";", header=head)


def test_lines_are_read_in_their_own_direction(lines, tmp_path):
    track = lines.track
    for k in range(3):
        write_line(tmp_path, lines, k, backwards=True)
    read = read_lines(track, tmp_path)
    assert read.track.length == pytest.approx(track.length, rel=0.01)
    ahead = track.to_frenet(read.track.to_cartesian([[0.0, 0.0], [AHEAD, 0.0]])[:, :2])[:, 0]
    assert np.mod(ahead[0] - ahead[1], track.length) == pytest.approx(AHEAD, abs=0.1)
    # The left is on the right in the other direction.
    assert read.d[0].mean() == pytest.approx(-lines.d[0].mean(), abs=0.02)
    assert read.speed[1].mean() == pytest.approx(lines.speed[1].mean(), rel=0.02)
    refused("can't read .*Pipkin_line0.csv: No such", read_lines, load_track("Pipkin"), tmp_path)
    (tmp_path / "Brackwater_line1.csv").write_text("0.123456789; 1; 2; 3; 4; 5e-9; nan\n" * 10)
    refused(r"row 1 is \[0.123456789, .*7 finite numbers", read_lines, track, tmp_path)


def _shuffled(line):
    line[:, 1:] = np.random.default_rng(0).permutation(line[:, 1:])


WRONG = {
    "point 1: the speed must be above 0 and at most 20 m/s": lambda line: line[:, 5].fill(0.0),
    "point 4: the speed must be above 0": lambda line: line[3:, 5].fill(1e300),
    "point 3: the speed must be above 0": lambda line: line[2:, 5].fill(-5.0),
    "point 1: s must rise": lambda line: line[:, 0].fill(0.0),
    "point 1: it must lie between the walls": lambda line: np.add(
        line[:, 1:3], 100.0, out=line[:, 1:3]
    ),
    "the next point must be within 2 m": _shuffled,
    # 200 times the same point
    "must go round Brackwater once": lambda line: np.copyto(line[:, 1:3], line[0, 1:3]),
}


@pytest.mark.parametrize("message", WRONG)
def test_lines_that_no_car_can_drive_are_refused(lines, tmp_path, message):
    for wrong in range(3):
        for k in range(3):
            write_line(tmp_path, lines, k, WRONG[message] if k == wrong else lambda table: None)
        refused(f"Brackwater_line{wrong}.csv.*{message}", read_lines, lines.track, tmp_path)


def test_a_link_to_a_line_elsewhere_is_not_followed(lines, tmp_path):
    (tmp_path / "secret").write_text("the password\n")
    (tmp_path / "lines").mkdir()
    (tmp_path / "lines" / "Brackwater_line0.csv").symlink_to(tmp_path / "secret")
    with pytest.raises(MapError, match=r"is a link out of its folder") as caught:
        read_lines(lines.track, tmp_path / "lines")
    assert "password" not in str(caught.value)


def test_the_command_prints_the_tables(capsys):
    assert main(["overtaking", "--policies", "stanley", "--track", "Pipkin"]) == 0
    summary_lines = capsys.readouterr().out.splitlines()
    assert summary_lines[0] == "600 scenarios"
    assert summary_lines[2].startswith("planner")
    assert "Pipkin" in summary_lines[6]
