"""Contacts of cars with cars and walls, and the blame for them."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from pcs_racing.car.collision import (
    Rectangle,
    car_hits_wall,
    contact_fault as fault_of_bodies,
    inside_wall,
    rectangles_overlap,
)
from pcs_racing.track.loading import load_track

LENGTH, WIDTH = 0.58, 0.31
HALF = (0.5 * LENGTH, 0.5 * WIDTH)

angles = st.floats(-10.0, 10.0)


def corners(x, y, psi, half_length=HALF[0], half_width=HALF[1]):
    c, s = np.cos(psi), np.sin(psi)
    box = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [half_length, half_width]
    return box @ np.array([[c, s], [-s, c]]) + [x, y]


def overlap(first, second):
    """Corners of the intersection of two convex polygons, by cutting one along the sides of the
    other.
    """
    polygon = list(first)
    for a, b in zip(second, np.roll(second, -1, axis=0), strict=True):
        inside = [(b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) for p in polygon]
        kept = []
        for k, p in enumerate(polygon):
            q, here, there = polygon[k - 1], inside[k], inside[k - 1]
            if (here > 0) != (there > 0):
                kept.append(q + (p - q) * there / (there - here))
            if here > 0:
                kept.append(p)
        polygon = kept
    return np.array(polygon).reshape(-1, 2)


def area_of(polygon):
    x, y = polygon.T
    return (
        0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
        if len(polygon) > 2
        else 0.0
    )


def hits_segment(walls, x, y, psi, half=HALF):
    """Whether any of the segments (S, 4) passes through the inside of the car, by clipping them to
    it.
    """
    c, s = np.cos(psi), np.sin(psi)
    low, high = np.zeros(len(walls)), np.ones(len(walls))
    start = (walls[:, :2] - [x, y]) @ np.array([[c, -s], [s, c]])
    end = (walls[:, 2:] - [x, y]) @ np.array([[c, -s], [s, c]])
    for axis in range(2):
        way = end[:, axis] - start[:, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.sort(
                np.stack([(side * half[axis] - start[:, axis]) / way for side in (-1, 1)]), axis=0
            )
        outside = (way == 0.0) & (abs(start[:, axis]) >= half[axis])
        low = np.where(way == 0.0, np.where(outside, 2.0, low), np.maximum(low, t[0]))
        high = np.where(way == 0.0, high, np.minimum(high, t[1]))
    return bool((low < high).any())


def state(x=0.0, y=0.0, psi=0.0, v=0.0, rate=0.0, beta=0.0):
    return np.array([x, y, 0.0, v, psi, rate, beta])


def contact_fault(first, second, sizes=(HALF, HALF)):
    """Cars at fault when two cars of these sizes touch."""
    bodies = (
        Rectangle(*car[[0, 1, 4]], *size) for car, size in zip((first, second), sizes, strict=True)
    )
    return fault_of_bodies(first, second, *bodies)


@settings(deadline=None, max_examples=300)
@given(
    st.floats(-1.2, 1.2),
    st.floats(-1.2, 1.2),
    angles,
    angles,
    st.floats(0.05, 0.6),
    st.floats(0.05, 0.6),
)
def test_rectangles_overlap_where_they_share_an_area(x, y, psi0, psi1, half_length, half_width):
    area = area_of(overlap(corners(0.0, 0.0, psi0), corners(x, y, psi1, half_length, half_width)))
    assume(area == 0.0 or area > 1e-9)
    own, other = Rectangle(0.0, 0.0, psi0, *HALF), Rectangle(x, y, psi1, half_length, half_width)
    assert rectangles_overlap(own, other) == rectangles_overlap(other, own) == (area > 0.0)


def test_touching_is_no_overlap():
    for x, overlaps in ((1.0, False), (0.999, True)):
        assert (
            rectangles_overlap(
                Rectangle(0.0, 0.0, 0.0, 0.5, 0.25), Rectangle(x, 0.0, 0.0, 0.5, 0.25)
            )
            == overlaps
        )


def poses_around(track, count, rng):
    """Random poses on and off the track, (count, 4): x, y, psi, s."""
    s = rng.uniform(0.0, track.length, count)
    d = rng.uniform(-1.5, 1.5, count)
    x, y, psi = track.to_cartesian(np.column_stack([s, d])).T
    psi = psi + rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([x, y, psi, track.to_frenet(np.column_stack([x, y]))[:, 0]])


def check_walls(track, count):
    """Compare with all walls of the track; returns the share of hits."""
    hits = []
    for x, y, psi, s in poses_around(track, count, np.random.default_rng(1)):
        if track.wall_distance([x, y]) < 1.5 * track.arrays.cell:
            continue  # a centre in the wall may have no wall within the car
        for half in (HALF, (0.6, 0.1), (0.15, 0.4)):
            hit = car_hits_wall(track.arrays, x, y, psi, *half, s)
            assert hit == hits_segment(track.arrays.walls, x, y, psi, half), (x, y, psi)
            hits.append(hit)
    return np.mean(hits)


def test_walls_are_hit_where_one_is_inside_the_car(oval):
    assert 0.05 < check_walls(oval, 1000) < 0.95


def test_walls_of_a_real_circuit_are_hit_where_one_is_inside_the_car(real_maps):
    assert 0.05 < check_walls(load_track(real_maps / "Spielberg"), 1000) < 0.95


def test_outside_the_map_and_inside_walls_is_wall_even_for_a_speck_and_a_point(oval):
    for x, y in [(1e3, 0.0), (-1e6, 1e6), (np.nan, 0.0), (0.0, 0.0), (0.0, -5.6)]:
        assert car_hits_wall(oval.arrays, x, y, 0.3, *HALF, 1.0)
    assert not car_hits_wall(oval.arrays, 0.0, -4.0, 0.3, *HALF, 6.0)
    wall, cell = -5.1, oval.arrays.cell
    for y in np.linspace(-6.0, -4.0, 101):
        if abs(y - wall) > cell:
            assert car_hits_wall(oval.arrays, 0.0, y, 0.3, 0.002, 0.001, 6.0) == (y < wall)
    arrays = oval.arrays
    rows, cols = arrays.distance.shape
    rng = np.random.default_rng(5)
    for u, v in rng.uniform([-3.0, -3.0], [cols + 3.0, rows + 3.0], (2000, 2)):
        x, y = arrays.origin_x + u * arrays.cell, arrays.origin_y + v * arrays.cell
        on_the_map = 0.0 <= u < cols and 0.0 <= v < rows
        free = on_the_map and arrays.distance[int(v), int(u)] > 0.0
        assert inside_wall(arrays, x, y) == (not free)


NEITHER_MORE, FIRST, SECOND = (True, True), (True, False), (False, True)


def test_who_is_at_fault_whatever_the_order_of_the_cars():
    for first, second, faults in [
        # Into the rear of a car, also of a braking one or one on one side.
        *(
            (state(v=5.0), state(x=0.55, y=y, v=v), FIRST)
            for v in (3.0, 0.5, 0.0)
            for y in (-0.2, 0.0, 0.2)
        ),
        # A leader that reverses shares the fault by its speed.
        (state(v=2.0), state(x=0.55, v=-4.0), SECOND),
        (state(v=2.0), state(x=0.55, v=-2.0), NEITHER_MORE),
        # Side by side, the car that moves over, or moves over faster.
        *(
            (state(v=6.0), state(x=0.1, y=y, v=5.0, beta=-0.05 * np.sign(y)), SECOND)
            for y in (0.3, -0.3)
        ),
        (state(v=6.0, beta=0.01), state(y=0.3, v=6.0, beta=-0.03), SECOND),
        # A car that spins counterclockwise hits with its tail to the right, and with its nose to
        # the left.
        (state(v=5.0, rate=1.0), state(x=-0.4, y=-0.3, v=5.0), FIRST),
        (state(v=5.0, rate=1.0), state(x=0.4, y=0.3, v=5.0), FIRST),
        # Head on.
        (state(v=3.0), state(x=0.5, psi=np.pi, v=3.0), NEITHER_MORE),
        (state(v=4.0), state(x=0.5, psi=np.pi, v=3.0), FIRST),
        # At one place at rest, alike or turned.
        (state(), state(), NEITHER_MORE),
        (state(), state(psi=0.7), NEITHER_MORE),
    ]:
        assert contact_fault(first, second) == faults
        assert contact_fault(second, first) == faults[::-1]
    for own, other, faults in [
        (4.0, 3.85, (True, True)),  # within five percent of the larger one
        (4.0, 3.75, (True, False)),
        (3.75, 4.0, (False, True)),
        (0.0005, 0.0, (True, True)),  # within a millimetre a second
        (0.0015, 0.0, (True, False)),
        (0.0, 0.0015, (False, True)),
    ]:
        assert contact_fault(state(v=own), state(x=0.5, psi=np.pi, v=other)) == faults
    first, second = state(v=3.0, psi=0.2), state(y=0.32, v=3.0, psi=-0.2)
    assert contact_fault(first, second) == contact_fault(second, first)[::-1]


def centroid(polygon):
    """Centre of the area of a convex polygon, by the triangles around its first corner."""
    a, b, c = polygon[0], polygon[1:-1], polygon[2:]
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return (areas[:, None] * (a + b + c) / 3.0).sum(axis=0) / areas.sum()


def closing_speeds(first, second, sizes):
    """Speed of each car's body into the other one, at the middle of their overlap and along the
    contact.
    """
    boxes = [
        corners(car[0], car[1], car[4], *size)
        for car, size in zip((first, second), sizes, strict=True)
    ]
    way = second[:2] - first[:2]
    axes = []
    for angle in (first[4], first[4] + 0.5 * np.pi, second[4], second[4] + 0.5 * np.pi):
        axis = np.array([np.cos(angle), np.sin(angle)])
        axis = -axis if axis @ way < 0.0 else axis
        axes.append(((boxes[0] @ axis).max() - (boxes[1] @ axis).min(), axis))
    least = min(depth for depth, _ in axes)
    normal = sum(axis for depth, axis in axes if depth <= least + 1e-3)
    normal = normal / np.linalg.norm(normal)
    shared = overlap(*boxes)
    middle = centroid(shared) if area_of(shared) > 0.0 else 0.5 * (first[:2] + second[:2])
    speeds = []
    for car, sign in ((first, 1.0), (second, -1.0)):
        course, arm = car[4] + car[6], middle - car[:2]
        velocity = car[3] * np.array([np.cos(course), np.sin(course)]) + car[5] * np.array(
            [-arm[1], arm[0]]
        )
        speeds.append(max(sign * (velocity @ normal), 0.0))
    return speeds


@pytest.mark.parametrize(
    "sizes", [(HALF, HALF), ((0.35, 0.12), (0.22, 0.18))], ids=["alike", "different"]
)
def test_the_car_that_moves_into_the_other_one_faster_is_at_fault(sizes):
    """Against polygons: the axis of least overlap, the middle of the shared area, the velocity of
    the bodies there.
    """
    rng = np.random.default_rng(3)
    seen = []
    for _ in range(600):
        first = state(
            *rng.uniform(-3.0, 3.0, 3),
            rng.uniform(-2.0, 8.0),
            rng.uniform(-3.0, 3.0),
            rng.uniform(-0.5, 0.5),
        )
        bearing, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.15, 0.7)
        at = first[:2] + away * np.array([np.cos(bearing), np.sin(bearing)])
        turn = first[4] + (rng.normal(0.0, 0.3) if rng.random() < 0.5 else rng.uniform(-3.0, 3.0))
        second = state(
            *at, turn, rng.uniform(-2.0, 8.0), rng.uniform(-3.0, 3.0), rng.uniform(-0.5, 0.5)
        )
        own, other = closing_speeds(first, second, sizes)
        margin = max(0.05 * max(own, other), 1e-3)
        if abs(abs(own - other) - margin) < 1e-6:
            continue  # a matter of rounding
        expected = (not other - own > margin, not own - other > margin)
        assert contact_fault(first, second, sizes) == expected
        seen.append(expected)
    assert {(True, False), (False, True), (True, True)} == set(seen)
