"""The minimum iTTC against dense scans, dense samples of walls, and cases that can be worked out by
hand.
"""

import numpy as np
import pytest
from hypothesis import strategies as st

from pcs_racing.car.collision import Rectangle
from pcs_racing.car.ittc import Motion, minimum_ittc, segment_ittc

HALF = (0.29, 0.155)
HORIZON = 10.0
ANGLES = np.linspace(-np.pi, np.pi, 20_000, endpoint=False)

coordinate = st.floats(-20.0, 20.0)


def sides(x, y, psi):
    """The four sides (4, 4) of a car's rectangle."""
    c, s = np.cos(psi), np.sin(psi)
    box = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * HALF @ np.array([[c, s], [-s, c]]) + [
        x,
        y,
    ]
    return np.hstack([box, np.roll(box, -1, axis=0)])


def cast(segments, x, y):
    """Exact range of 20,000 beams to the nearest of some segments."""
    ranges = np.full(len(ANGLES), np.inf)
    cos, sin = np.cos(ANGLES), np.sin(ANGLES)
    for ax, ay, bx, by in segments - [x, y, x, y]:
        across = cos * (by - ay) - sin * (bx - ax)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = (ax * by - ay * bx) / across
            along = (ax * sin - ay * cos) / across
        hit[~((hit > 0) & (along >= 0) & (along <= 1))] = np.inf
        ranges = np.minimum(ranges, hit)
    return ranges


def times(ranges, vx, vy):
    """iTTC of each beam: its range over its closing speed."""
    closing = vx * np.cos(ANGLES) + vy * np.sin(ANGLES)
    return np.where(closing > 0.0, ranges / np.where(closing > 0.0, closing, 1.0), np.inf)


def situations(track, count, seed):
    """Random lidars and opponents on a track: x, y, vx, vy, s, opponent's x, y, psi, vx, vy."""
    rng = np.random.default_rng(seed)
    s = rng.uniform(0.0, track.length, count)
    x, y, psi = track.to_cartesian(np.column_stack([s, rng.uniform(-0.9, 0.9, count)])).T
    course = psi + rng.normal(0.0, 0.5, count) + np.pi * (rng.random(count) < 0.1)
    v = rng.uniform(0.1, 8.0, count)
    gap = rng.uniform(0.7, 6.0, count) * rng.choice([-1, 1], count)
    ox, oy, opsi = track.to_cartesian(np.column_stack([s + gap, rng.uniform(-0.8, 0.8, count)])).T
    opsi = opsi + rng.normal(0.0, 0.5, count)
    ov = rng.uniform(0.0, 8.0, count)
    at = track.to_frenet(np.column_stack([x, y]))[:, 0]
    motion = [v * np.cos(course), v * np.sin(course)]
    return np.column_stack([x, y, *motion, at, ox, oy, opsi, ov * np.cos(opsi), ov * np.sin(opsi)])


def measure(track, row, use_opponent=True, horizon=HORIZON):
    x, y, vx, vy, s, ox, oy, opsi, ovx, ovy = row
    lidar, other = Motion(x, y, vx, vy), Rectangle(ox, oy, opsi, *HALF)
    return minimum_ittc(track.arrays, lidar, s, other, ovx, ovy, use_opponent, horizon)


def test_agrees_with_a_dense_scan_of_walls_and_opponent(oval):
    nearer = 0
    for row in situations(oval, 150, seed=0):
        x, y, vx, vy, _, ox, oy, opsi, ovx, ovy = row
        walls = min(times(cast(oval.arrays.walls, x, y), vx, vy).min(), HORIZON)
        opponent = times(cast(sides(ox, oy, opsi), x, y), vx - ovx, vy - ovy).min()
        assert measure(oval, row, use_opponent=False) == pytest.approx(walls, rel=1e-3)
        assert measure(oval, row) == pytest.approx(min(walls, opponent), rel=1e-3)
        assert measure(oval, row) <= min(walls, opponent) + 1e-12
        nearer += opponent < walls
    assert 10 < nearer < 140


def test_hand_cases_of_a_single_wall():
    wall = (3.0, -50.0, 3.0, 50.0)
    assert segment_ittc(*wall, 2.0, 0.0, 2.0, 99.0) == pytest.approx(1.5)  # straight at it: h / v
    assert segment_ittc(*wall, 0.0, 2.0, 2.0, 99.0) == pytest.approx(3.0)  # alongside: 2 h / v
    assert segment_ittc(*wall, -2.0, 0.0, 2.0, 99.0) == 99.0  # away from it
    # a point
    assert segment_ittc(3.0, 4.0, 3.0, 4.0, 1.0, 0.0, 1.0, 99.0) == pytest.approx(25.0 / 3.0)
    assert segment_ittc(-1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 99.0) == 0.0  # on the wall


def straight(oval, vx=4.0, ox=2.0, ovx=0.0):
    """A lidar in the middle of the oval's lower straight at 4 m/s, an opponent at rest 2 m on."""
    return measure(oval, (0.0, -4.0, vx, 0.0, 6.0, ox, -4.0, 0.0, ovx, 0.0))


def test_the_opponents_motion_counts_and_the_result_is_capped_at_the_horizon(oval):
    walls = straight(oval, ox=1e3)
    # twice the side clearance over the speed
    assert walls == pytest.approx(2.0 * 1.1 / 4.0, rel=0.05)
    assert straight(oval) == pytest.approx((2.0 - HALF[0]) / 4.0)
    assert straight(oval, ovx=-4.0) == pytest.approx((2.0 - HALF[0]) / 8.0)
    assert straight(oval, ovx=4.0) == walls  # keeps its distance
    assert straight(oval, ovx=6.0) == walls  # pulls away
    # run into from behind
    assert straight(oval, vx=0.0, ox=-2.0, ovx=4.0) == pytest.approx((2.0 - HALF[0]) / 4.0)
    row = situations(oval, 1, seed=2)[0]
    row[2:4] = 0.0
    assert measure(oval, row, use_opponent=False) == HORIZON
    row[2] = 1e-6
    assert measure(oval, row, use_opponent=False, horizon=3.0) == 3.0
