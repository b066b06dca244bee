"""Small pieces of everything that is compiled: `make coverage` runs them once more without compilation.

A compiled function leaves no trace of its lines. With ``NUMBA_DISABLE_JIT=1`` these tests run as plain Python, many
times slower, so the circuit is coarse and the races are short.
"""

import numpy as np
import pytest

from pcs_racing import (
    CONTEST,
    PAPER,
    Lidar,
    MapError,
    PolicyArchive,
    Starts,
    draw_starts,
    get_planner,
    load_race_config,
    make_game,
    parse_policy,
    run_races,
)
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
from pcs_racing.envs.infos import Crash
from pcs_racing.race.state import CAR_CRASH, NO_CRASH
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import first_crossing, resample
from pcs_racing.track.mapping.circuits import generate_circuit
from pcs_racing.track.track import build_track


def test_places_on_the_track_and_back(coarse_oval):
    sd = np.column_stack([np.linspace(0.0, coarse_oval.length - 0.1, 7), np.linspace(-0.5, 0.5, 7)])
    points = coarse_oval.to_cartesian(sd)
    assert np.abs(coarse_oval.to_frenet(points[:, :2]) - sd).max() < 0.02
    assert (coarse_oval.wall_distance(points[:, :2]) > 0.2).all()
    assert coarse_oval.to_frenet([[50.0, 50.0], [0.0, 0.0]]).shape == (2, 2)


@pytest.mark.parametrize(
    "rival", ["lattice:pace=0.6", "lane-switcher:3", "lane-switcher:11", "pure-pursuit", "gap-follower"]
)
def test_a_second_of_racing(coarse_oval, rival):
    config = load_race_config(CONTEST if "lane" in rival else PAPER, duration=1.0, start_lines=1)
    starts = draw_starts(coarse_oval, config, 1, 0)
    ended = run_races(
        coarse_oval, parse_policy("lattice"), parse_policy(rival), config, starts=starts, seed=0, threads=1
    )
    assert np.isfinite(ended.lead).all()
    assert ended.time[0] > 0.3


@pytest.mark.parametrize(
    ("rival", "action"),
    [(None, (0.0, 1.0)), (None, (1.0, 0.0)), ("pure-pursuit", (0.0, 1.0)), ("lattice", (-1.0, 0.5))],
)
def test_a_car_that_is_not_steered_around_the_bend_hits_the_wall(coarse_oval, rival, action):
    """Full speed straight on, and the steering held to either side; noise on the steering saves nobody."""
    race = load_race_config("contest", speed_range=(0.3, 1.0))
    env = DriveEnv(coarse_oval, rival, race=race, duration=4.0)
    env.reset(seed=3)
    over = False
    while not over:
        *_, over, late, info = env.step(np.array(action, np.float32))
        assert not late
    assert info["crash"] == Crash.WALL
    assert info["opponent_crash"] == Crash.NONE
    assert info["fault"]


def test_a_lap_alone(coarse_oval):
    """By the observation's documented order: back to the race line, at 4 m/s."""
    env = DriveEnv(coarse_oval, None, duration=15.0)
    seen, info = env.reset(seed=1)
    over = late = False
    while not (over or late):
        steer = 0.6 * -seen[7] - 0.35 * seen[6] + 0.33 * seen[12]
        seen, _, over, late, info = env.step(np.array([steer / 0.4189, 0.0], np.float32))
    assert late
    assert info["progress"] > coarse_oval.length


def pure_pursuit(**parameters):
    return get_planner("pure-pursuit").policy(parameters)


def test_who_drives_into_the_car_ahead_is_to_blame(coarse_oval):
    """A fast car that ignores the other starts before a slow one, and then behind it."""
    config = load_race_config(
        PAPER, start="staggered", start_gap=0.9, start_spacing=0.2, duration=1.0, speed_range=(0.3, 1.2)
    )
    starts = Starts(np.full(2, 3.0), np.array([0, 1]))
    blind, slow = pure_pursuit(pace=1.0, follow_distance=0.0), pure_pursuit(pace=0.0)
    ended = run_races(coarse_oval, blind, slow, config, starts=starts, threads=1)
    assert ended.lead[0] > 0.0
    np.testing.assert_array_equal(ended.state.crash, [[NO_CRASH, NO_CRASH], [CAR_CRASH, CAR_CRASH]])
    np.testing.assert_array_equal(ended.state.fault, [[0, 0], [1, 0]])


def test_a_pass_over_the_start_line(coarse_oval):
    """From behind and beside; then arc length begins anew, and progress does not."""
    config = load_race_config(
        PAPER, start="staggered", start_gap=0.9, start_spacing=1.0, duration=2.0, speed_range=(0.3, 1.2)
    )
    starts = Starts(np.array([coarse_oval.length - 0.5]), np.array([1]))
    ended = run_races(coarse_oval, pure_pursuit(pace=1.0), pure_pursuit(pace=0.0), config, starts=starts, threads=1)
    assert not ended.crashed.any()
    np.testing.assert_array_equal(ended.state.overtakes, [[1, 0]])
    (s, ahead), (progress, _) = ended.state.frenet[0, :, 0], ended.state.progress[0]
    np.testing.assert_allclose(progress, 0.5 + s, atol=1e-6)
    assert ahead < s < 15.0


def test_a_lidar_sees_walls_and_the_other_car(coarse_oval):
    lidar = Lidar(coarse_oval, 21)
    x, y, psi = coarse_oval.to_cartesian([[2.0, 0.0]])[0]
    alone = lidar.scan(np.array([x, y, psi]))
    ahead = coarse_oval.to_cartesian([[4.0, 0.0]])[0]
    both = lidar.scan(np.array([x, y, psi]), np.array(ahead))
    assert (both <= alone + 1e-9).all()
    assert both.min() < alone[10]


def test_a_lidar_sees_nothing_from_within_a_wall_or_off_the_map(coarse_oval):
    lidar = Lidar(coarse_oval, 5)
    wall = coarse_oval.to_cartesian([[2.0, 1.25]])[0]  # the track is free for 1.1 m to either side
    np.testing.assert_array_equal(lidar.scan([wall, [60.0, 0.0, 0.0]]), np.zeros((2, 5)))


def test_observations_of_drivers(coarse_oval):
    env = DriveVectorEnv(
        2, track=coarse_oval, opponent="pure-pursuit", beams=5, lidar_noise=0.01, normalize=True, threads=1
    )
    first, _ = env.reset(seed=0)
    for _ in range(3):
        seen, *_ = env.step(np.array([[0.0, 0.2], [0.3, -0.5]], np.float32))
    assert seen.shape == first.shape
    assert np.isfinite(seen).all()
    env.close()


def test_a_game_and_what_it_shows(coarse_oval):
    lattice = get_planner("lattice")
    parameters = np.array([lattice.policy({"pace": pace}).parameters for pace in (0.3, 0.6, 0.9)])
    archive = PolicyArchive(
        "three",
        "lattice",
        lattice.parameter_names,
        parameters,
        ("aggressiveness", "restraint"),
        [[0, 2], [1, 1.5], [2, 1]],
    )
    game = make_game(coarse_oval, archive, moves=1, step_seconds=0.3, threads=1)
    state = game.step(game.reset(games=1, seed=2), np.array([[0, 1]]))
    assert game.done(state).all()
    assert np.isfinite(game.observation(state)).all()


def test_a_generated_circuit_is_as_wide_as_it_says_and_its_race_line_keeps_clear():
    circuit = generate_circuit(1, width=3.0, length_range=(60.0, 70.0), resolution=0.2)
    assert 60.0 <= circuit.length <= 70.0
    assert first_crossing(circuit.raceline) == (-1, -1)
    middle, race = (resample(line[:, :2], 0.5) for line in (circuit.centerline, circuit.raceline))
    air = wall_clearance(middle, circuit.occupied, 0.2, circuit.origin, 3.0)
    np.testing.assert_allclose(air, 1.5, atol=0.3)
    assert wall_clearance(race, circuit.occupied, 0.2, circuit.origin, 1.0).min() >= 0.3


def test_a_circuit_must_not_cross_itself():
    t = np.linspace(0.0, 2.0 * np.pi, 101)[:-1]
    eight = 8.0 * np.column_stack([np.sin(t), np.sin(2.0 * t)])
    line = np.column_stack([eight, np.full((100, 2), 0.5)])
    with pytest.raises(MapError, match="crosses itself"):
        build_track("eight", np.zeros((100, 100), np.bool_), 0.2, (-10.0, -10.0), line, eight)
