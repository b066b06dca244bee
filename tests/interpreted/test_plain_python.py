"""Small pieces of everything that is compiled: `make coverage` runs them once more without compilation.

A compiled function leaves no trace of its lines. With ``NUMBA_DISABLE_JIT=1`` these tests run as plain Python, a
hundred times slower, so the circuit is coarse and the races are short.
"""

import numpy as np
import pytest

from pcs_racing import (
    CONTEST,
    PAPER,
    Lidar,
    PolicyArchive,
    draw_starts,
    get_planner,
    load_race_config,
    make_game,
    parse_policy,
    run_races,
)
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.drive_vector import DriveVectorEnv
from pcs_racing.track import build_track
from pcs_racing_agents.solvers import GameTree, cfr, exploitability, solve_exact
from pcs_racing_agents.solvers.cfr import VARIANTS
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games

STRAIGHT, RADIUS, HALF_WIDTH, CELL = 8.0, 4.0, 1.2, 0.2


@pytest.fixture(scope="module")
def stadium():
    """Two straights of 8 m and two half circles of 4 m radius, in cells of 0.2 m."""
    quarter = np.linspace(0.0, np.pi, 30, endpoint=False)
    along = np.linspace(-STRAIGHT / 2, STRAIGHT / 2, 30, endpoint=False)
    right = np.column_stack([STRAIGHT / 2 + RADIUS * np.sin(quarter), -RADIUS * np.cos(quarter)])
    bottom = np.column_stack([along, np.full_like(along, -RADIUS)])
    xy = np.concatenate([bottom, right, -bottom, -right])
    origin = (-STRAIGHT / 2 - RADIUS - 2.0, -RADIUS - 2.0)
    shape = (round(2 * (RADIUS + 2.0) / CELL), round((STRAIGHT + 2 * RADIUS + 4.0) / CELL))
    y, x = np.meshgrid(*((np.arange(n) + 0.5) * CELL for n in shape), indexing="ij")
    away = np.hypot(np.maximum(np.abs(x + origin[0]) - STRAIGHT / 2, 0.0), y + origin[1])
    occupied = (np.abs(away - RADIUS) > HALF_WIDTH) & (np.abs(away - RADIUS) < HALF_WIDTH + 0.5)
    # A block on the outer wall, so that walls are not all smooth.
    occupied |= (np.abs(away - RADIUS - HALF_WIDTH) < 0.3) & (np.abs(x + origin[0]) < 0.5)
    center = np.column_stack([xy, np.full((len(xy), 2), HALF_WIDTH)])
    return build_track("stadium", occupied, CELL, origin, center, xy)


def test_places_on_the_track_and_back(stadium):
    sd = np.column_stack([np.linspace(0.0, stadium.length - 0.1, 7), np.linspace(-0.5, 0.5, 7)])
    points = stadium.to_cartesian(sd)
    assert np.abs(stadium.to_frenet(points[:, :2]) - sd).max() < 0.02
    assert (stadium.wall_distance(points[:, :2]) > 0.2).all()
    assert stadium.to_frenet([[50.0, 50.0], [0.0, 0.0]]).shape == (2, 2)


@pytest.mark.parametrize(
    "rival", ["lattice:pace=0.6", "lane-switcher:3", "lane-switcher:11", "pure-pursuit", "gap-follower"]
)
def test_a_second_of_racing(stadium, rival):
    config = load_race_config(CONTEST if "lane" in rival else PAPER, duration=1.0, start_lines=1)
    starts = draw_starts(stadium, config, 1, 0)
    ended = run_races(stadium, parse_policy("lattice"), parse_policy(rival), config, starts=starts, seed=0, threads=1)
    assert np.isfinite(ended.lead).all()
    assert ended.time[0] > 0.3


def test_cars_that_hit_the_wall_and_each_other(stadium):
    """Full speed straight on, and into the back of a car that stands."""
    ends = set()
    for action, opponent in (((0.0, 1.0), None), ((0.0, 1.0), "pure-pursuit"), ((1.0, 0.0), None), ((-1.0, 0.5), None)):
        env = DriveEnv(
            stadium, opponent, race=load_race_config("paper", start="staggered", start_gap=0.9), duration=2.4
        )
        env.reset(seed=3)
        over = False
        while not over:
            *_, over, late, info = env.step(np.array(action, np.float32))
            over = over or late
        ends.add(str(info["crash"]))
    assert "wall" in ends


def test_a_lidar_sees_walls_and_the_other_car(stadium):
    lidar = Lidar(stadium, 21)
    x, y, psi = stadium.to_cartesian([[2.0, 0.0]])[0]
    alone = lidar.scan(np.array([x, y, psi]))
    ahead = stadium.to_cartesian([[4.0, 0.0]])[0]
    both = lidar.scan(np.array([x, y, psi]), np.array(ahead))
    assert (both <= alone + 1e-9).all()
    assert both.min() < alone[10]


def test_observations_of_drivers(stadium):
    env = DriveVectorEnv(
        2, track=stadium, opponent="pure-pursuit", beams=5, lidar_noise=0.01, normalize=True, threads=1
    )
    first, _ = env.reset(seed=0)
    for _ in range(3):
        seen, *_ = env.step(np.array([[0.0, 0.2], [0.3, -0.5]], np.float32))
    assert seen.shape == first.shape
    assert np.isfinite(seen).all()
    env.close()


def test_a_game_and_what_it_shows(stadium):
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
    game = make_game(stadium, archive, moves=1, step_seconds=0.3, threads=1)
    state = game.step(game.reset(games=1, seed=2), np.array([[0, 1]]))
    assert game.done(state).all()
    assert np.isfinite(game.observation(state)).all()


def test_small_games_are_solved():
    rng = np.random.default_rng(0)
    tree = GameTree.from_payoffs(rng.normal(size=(2, 2, 2, 2)))
    exact = solve_exact(tree)
    for variant in VARIANTS:
        found = cfr(tree, 60, variant=variant)
        assert exploitability(tree, found.average).nash_conv < 1.0
    assert np.isfinite(exact.value)
    assert np.isfinite(solve_matrix_games(rng.normal(size=(3, 3, 4))).values).all()
