import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing import RaceConfig, Starts, load_track
from pcs_racing.planners import spiral
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.spiral import (
    BLOCK,
    BROKEN,
    GOAL_HEADING,
    GOAL_KAPPA,
    GOAL_X,
    GOAL_Y,
    KAPPA_RATE,
    LENGTH,
    MAX_KAPPA,
    MEAN_KAPPA,
    POINT_X,
    POINT_Y,
    SEGMENTS,
    SPIRALS,
    W,
    sample_spirals,
    solve_spirals,
    spiral_curvature,
)
from pcs_racing.planners.view import OWN_DELTA, OWN_PSI_DOT, OWN_V, PATH_POINTS, WHEELBASE

GOAL = st.tuples(st.floats(1.5, 4.5), st.floats(-1.0, 1.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
GOALS = st.lists(GOAL, min_size=SPIRALS, max_size=SPIRALS).map(np.array)
START_KAPPA = st.floats(-0.5, 0.5)


def rows(block: np.ndarray, first: int, count: int = 1) -> np.ndarray:
    """Some rows of a block, shape (SPIRALS,) or (count, SPIRALS)."""
    found = block[first : first + count * SPIRALS].reshape(count, SPIRALS)
    return found[0] if count == 1 else found


def solve(goals: np.ndarray, kappa0: float, pose=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Solve and sample the spirals to goals (SPIRALS, 4): x, y, heading, curvature."""
    block = np.full(BLOCK, np.nan)
    for row, column in zip((GOAL_X, GOAL_Y, GOAL_HEADING, GOAL_KAPPA), goals.T, strict=True):
        block[row : row + SPIRALS] = column
    solve_spirals(block, kappa0)
    sample_spirals(block, kappa0, *pose)
    return block


def curvature(block: np.ndarray, kappa0: float, u: np.ndarray) -> np.ndarray:
    """Curvature of the spirals at each u, shape (SPIRALS, len(u)), from the cubic through its four values."""
    length, w = rows(block, LENGTH), rows(block, W)
    p0, p3 = np.full(SPIRALS, kappa0), rows(block, GOAL_KAPPA)
    # Integrating the cubic over the whole length must give the end's heading: length (p0 + 3 p1 + 3 p2 + p3) / 8.
    both = (8.0 * rows(block, GOAL_HEADING) / length - p0 - p3) / 3.0
    values = np.stack([p0, 0.5 * (both + w / length), 0.5 * (both - w / length), p3])
    nodes = np.arange(4) / 3.0
    lagrange = [np.prod([(u - nodes[j]) / (nodes[i] - nodes[j]) for j in range(4) if j != i], axis=0) for i in range(4)]
    return values.T @ np.stack(lagrange)


def integrate(block: np.ndarray, kappa0: float, steps: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and headings at ``steps + 1`` places, found by summing up the curvature step by step."""
    u = np.linspace(0.0, 1.0, steps + 1)
    h = rows(block, LENGTH)[:, None] / steps

    def running(values: np.ndarray) -> np.ndarray:
        means = 0.5 * (values[:, 1:] + values[:, :-1])
        return np.concatenate([np.zeros((SPIRALS, 1)), np.cumsum(means * h, axis=1)], axis=1)

    heading = running(curvature(block, kappa0, u))
    return running(np.cos(heading)), running(np.sin(heading)), heading


@given(GOALS, START_KAPPA)
def test_spirals_end_at_their_goals(goals, kappa0):
    block = solve(goals, kappa0)
    assert not rows(block, BROKEN).any()
    x, y, heading = integrate(block, kappa0)
    end = np.stack([x[:, -1], y[:, -1], heading[:, -1]], axis=1)
    np.testing.assert_allclose(end[:, :2], goals[:, :2], rtol=0, atol=5e-3)
    np.testing.assert_allclose(end[:, 2], goals[:, 2], rtol=0, atol=1e-6)


def test_spirals_of_real_races_end_at_their_goals(views):
    """The lattice's real domain: every spiral that it lays in races with a disturbed steering."""
    track = load_track("Kestrelheim")
    starts = Starts(np.linspace(5.0, track.length - 5.0, 12), np.zeros(12, np.int64))
    config = RaceConfig(duration=20.0, start="staggered", start_gap=2.0, start_spacing=0.3, steering_noise=0.03)
    scratch = np.zeros(LATTICE.scratch_size)
    errors, broken = [], []
    for view in views(track, LATTICE.policy({"pace": 1.0}), config, starts):
        LATTICE.plan(track.arrays, LATTICE.default, view, np.zeros(6), scratch, np.zeros((PATH_POINTS, 4)))
        block = scratch[:BLOCK].copy()
        x, y, _ = integrate(block, start_curvature(view), steps=1000)
        miss = np.hypot(x[:, -1] - rows(block, GOAL_X), y[:, -1] - rows(block, GOAL_Y))
        broken.append(rows(block, BROKEN) != 0.0)
        errors.append(miss)
    errors, broken = np.concatenate(errors), np.concatenate(broken)
    assert len(errors) > 5000
    assert broken.mean() < 0.002
    assert errors[~broken].max() < 1e-2
    assert np.median(errors[~broken]) < 1e-4


def start_curvature(view: np.ndarray) -> float:
    """Curvature with which the lattice planner starts: half the steering's, half that of the yaw rate."""
    v = max(view[OWN_V], 0.5)
    steering = np.tan(view[OWN_DELTA]) / view[WHEELBASE]
    return float(np.clip(0.5 * (view[OWN_PSI_DOT] / v + steering), -1.2, 1.2))


@given(GOALS, START_KAPPA)
def test_curvature_is_matched_at_the_end(goals, kappa0):
    block = solve(goals, kappa0)
    end = [
        kappa0 + sum(spiral_curvature(rows(block, LENGTH)[g], rows(block, W)[g], goals[g, 2], kappa0, goals[g, 3]))
        for g in range(SPIRALS)
    ]
    np.testing.assert_allclose(end, goals[:, 3], rtol=0, atol=1e-9)


@given(GOALS, START_KAPPA)
def test_mirrored_goals_have_mirrored_spirals(goals, kappa0):
    block, mirrored = solve(goals, kappa0), solve(goals * [1.0, -1.0, -1.0, -1.0], -kappa0)
    np.testing.assert_allclose(rows(mirrored, LENGTH), rows(block, LENGTH), rtol=1e-9)
    np.testing.assert_allclose(rows(mirrored, W), -rows(block, W), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        rows(mirrored, POINT_X, SEGMENTS + 1), rows(block, POINT_X, SEGMENTS + 1), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        rows(mirrored, POINT_Y, SEGMENTS + 1), -rows(block, POINT_Y, SEGMENTS + 1), rtol=0, atol=1e-9
    )


@given(GOALS, START_KAPPA, st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.0, 3.0))
def test_points_lie_on_the_spiral_in_the_map(goals, kappa0, x0, y0, course):
    block = solve(goals, kappa0, (x0, y0, course))
    x, y, _ = integrate(block, kappa0)
    every = (x.shape[1] - 1) // SEGMENTS
    x, y = x[:, ::every], y[:, ::every]
    c, s = np.cos(course), np.sin(course)
    expected_x, expected_y = x0 + x * c - y * s, y0 + x * s + y * c
    points_x, points_y = rows(block, POINT_X, SEGMENTS + 1).T, rows(block, POINT_Y, SEGMENTS + 1).T
    np.testing.assert_allclose(points_x, expected_x, rtol=0, atol=2e-3)
    np.testing.assert_allclose(points_y, expected_y, rtol=0, atol=2e-3)


@given(GOALS, START_KAPPA)
def test_curvature_measures(goals, kappa0):
    block = solve(goals, kappa0)
    u = np.arange(SEGMENTS + 1) / SEGMENTS
    kappa = curvature(block, kappa0, u)
    step = rows(block, LENGTH) / SEGMENTS
    np.testing.assert_allclose(rows(block, MAX_KAPPA), np.abs(kappa[:, 1:]).max(axis=1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(rows(block, MEAN_KAPPA), np.abs(kappa[:, 1:]).mean(axis=1), rtol=0, atol=1e-9)
    rate = np.abs(np.diff(kappa, axis=1)).max(axis=1) / step
    np.testing.assert_allclose(rows(block, KAPPA_RATE), rate, rtol=0, atol=1e-9)


@pytest.mark.parametrize("goal", [(-1.0, 0.0, 3.0, 0.0), (-1.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0)])
def test_a_goal_that_no_spiral_reaches_is_marked(goal):
    goals = np.tile([2.0, 0.0, 0.0, 0.0], (SPIRALS, 1))
    goals[3] = goal
    broken = rows(solve(goals, 0.0), BROKEN)
    assert broken[3] == 1.0
    assert not np.delete(broken, 3).any()


def test_a_straight_line_is_the_spiral_to_a_goal_straight_ahead():
    goals = np.tile([2.0, 0.0, 0.0, 0.0], (SPIRALS, 1))
    block = solve(goals, 0.0)
    np.testing.assert_allclose(rows(block, LENGTH), 2.0, rtol=1e-9)
    np.testing.assert_allclose(rows(block, POINT_X, SEGMENTS + 1)[:, 0], np.linspace(0.0, 2.0, SEGMENTS + 1), atol=1e-9)
    assert rows(block, MAX_KAPPA).max() < 1e-9


def test_the_heading_basis_integrates_the_curvature():
    """theta(u) from the basis equals the integral of the cubic, for arbitrary values at its four nodes."""
    p0, p3, length, w, end = 0.3, -0.2, 2.5, 0.4, 0.35
    steps = np.linspace(0.0, 1.0, 20001)
    a1, a2, a3 = spiral_curvature(length, w, end, p0, p3)
    kappa = p0 + steps * (a1 + steps * (a2 + steps * a3))
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1])) * length / (len(steps) - 1)])
    for u in (0.125, 0.5, 0.875, 1.0):
        a, c0, c3, d = spiral.heading_basis(u)
        assert a * end + length * (c0 * p0 + c3 * p3) + d * w == pytest.approx(integral[int(u * 20000)], abs=1e-8)
