"""Random outlines of circuits: polygons in three styles, and a function to round their corners.

The polygons, shape (K, 2), run counterclockwise and are about one unit wide; ``circuits`` scales
and checks them.
"""

import math
from collections.abc import Callable

import numpy as np

from pcs_racing.base.elementary import headings, lengths, sine_cosine, sines_cosines


def hull_polygon(rng: np.random.Generator) -> np.ndarray:
    """Return a convex hull of random points with bent long sides: natural, flowing circuits.

    The long sides are bent in or out in the middle. The polygon may cross itself.
    """
    points = rng.uniform(-0.5, 0.5, size=(int(rng.integers(9, 16)), 2)) * (
        1.0,
        rng.uniform(0.5, 0.9),
    )
    hull = _convex_hull(points)
    corners = []
    for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        corners.append(a)
        side = b - a
        length = float(lengths(side))
        if length > 0.25:
            # Inwards is to the left of a side; dents go deeper than bulges.
            depth = length * rng.triangular(-0.15, 0.25, 0.55)
            corners.append(
                a + rng.uniform(0.35, 0.65) * side + depth * np.array([-side[1], side[0]]) / length
            )
    return np.array(corners)


def voronoi_polygon(rng: np.random.Generator) -> np.ndarray:
    """Return the outline of a few Voronoi cells: angular circuits with the most braking zones.

    The cells are neighbours, from random points. The outline may be empty if they surround a hole.
    """
    from scipy.spatial import Voronoi

    across = 7
    columns, rows = np.meshgrid(np.arange(across), np.arange(across))
    sites = np.column_stack([columns.ravel(), rows.ravel()]) + rng.uniform(
        -0.42, 0.42, size=(across**2, 2)
    )
    diagram = Voronoi(sites)
    inner = {
        k for k in range(across**2) if 0 < k % across < across - 1 and 0 < k // across < across - 1
    }
    neighbours: dict[int, set[int]] = {k: set() for k in inner}
    for a, b in diagram.ridge_points.tolist():
        if a in inner and b in inner:
            neighbours[a].add(b)
            neighbours[b].add(a)
    selected = [int(rng.choice(sorted(inner)))]
    for _ in range(int(rng.integers(4, 9))):
        # Cells that touch few chosen cells make long, winding unions.
        around = {
            k: len(neighbours[k] & set(selected))
            for c in selected
            for k in neighbours[c]
            if k not in selected
        }
        names = sorted(around)
        weights = np.array([math.prod([0.3] * around[k]) for k in names])
        selected.append(int(rng.choice(names, p=weights / weights.sum())))
    # A side of the union belongs to one chosen cell, with the cell on the left.
    after: dict[int, int] = {}
    for (a, b), (p, q) in zip(diagram.ridge_points.tolist(), diagram.ridge_vertices, strict=True):
        if (a in selected) == (b in selected):
            continue
        site = sites[a if a in selected else b]
        (px, py), (qx, qy) = diagram.vertices[p] - site, diagram.vertices[q] - site
        first, second = (p, q) if px * qy - py * qx > 0.0 else (q, p)
        if first in after:
            return np.empty((0, 2))
        after[first] = second
    loop = [min(after)]
    while after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    if len(loop) != len(after):
        return np.empty((0, 2))
    return _without_short_sides(diagram.vertices[loop], 0.35) / across


def hairpin_polygon(rng: np.random.Generator) -> np.ndarray:
    """Return a star of two to four slim arms with blunt tips: long straights into hairpins."""
    arms = int(rng.integers(2, 5))
    angles = 2.0 * np.pi * (np.arange(arms) + rng.uniform(-0.22, 0.22, size=arms)) / arms
    lengths = rng.uniform(0.55, 1.0, size=arms)
    corners = []
    for k in range(arms):
        along = _direction(angles[k])
        left = np.array([-along[1], along[0]])
        half = rng.uniform(0.06, 0.09)
        skew = rng.uniform(-0.05, 0.05)
        tip = lengths[k] * along
        corners += [tip - half * left - skew * along, tip + half * left + skew * along]
        gap = (angles[(k + 1) % arms] - angles[k]) % (2.0 * np.pi)
        middle = angles[k] + gap * rng.uniform(0.4, 0.6)
        crotch = rng.uniform(0.1, 0.18) / max(_direction(0.5 * min(gap, np.pi))[1], 0.5)
        corners.append(crotch * _direction(middle))
    return np.array(corners)


STYLES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "hull": hull_polygon,
    "voronoi": voronoi_polygon,
    "hairpin": hairpin_polygon,
}
"""Name of each style, and the function to draw its polygon."""


def rounded(corners: np.ndarray, radii: np.ndarray, step: float) -> np.ndarray:
    """Return a polygon (K, 2) with an arc at every corner, as points ``step`` metres apart.

    A radius (m), one per corner, shrinks if the arc would need more than half of a side.
    """
    before = corners - np.roll(corners, 1, axis=0)
    after = np.roll(corners, -1, axis=0) - corners
    length_before, length_after = lengths(before), lengths(after)
    before /= length_before[:, None]
    after /= length_after[:, None]
    across = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = headings(np.column_stack([np.sum(before * after, axis=1), across]))
    sines, cosines = sines_cosines(0.5 * np.abs(turn))
    half_turn = sines / cosines
    room = 0.49 * np.minimum(length_before, length_after)
    tangent = np.minimum(radii * half_turn, room)
    points = []
    for k in range(len(corners)):
        begin = corners[k] - tangent[k] * before[k]
        if half_turn[k] < 1e-6:
            arc = begin[None]
        else:
            radius = tangent[k] / half_turn[k]
            n = max(int(np.ceil(radius * abs(turn[k]) / step)), 1)
            angle = np.linspace(0.0, turn[k], n + 1)
            side = np.sign(turn[k]) * radius
            normal = np.array([-before[k, 1], before[k, 0]])
            sines, cosines = sines_cosines(np.abs(angle))
            arc = begin + radius * sines[:, None] * before[k]
            arc = arc + side * (1.0 - cosines)[:, None] * normal
        points.append(arc)
        end = corners[k] + tangent[k] * after[k]
        nxt = (k + 1) % len(corners)
        target = corners[nxt] - tangent[nxt] * before[nxt]
        n = max(int(lengths(target - end) / step), 1)
        points.append(end + (target - end) * (np.arange(1, n) / n)[:, None])
    return np.vstack(points)


def _direction(angle: float) -> np.ndarray:
    """Return the unit vector of an angle in rad."""
    sine, cosine = sine_cosine(angle)
    return np.array([cosine, sine])


def _convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the counterclockwise convex hull, leftmost corner first."""
    from scipy.spatial import ConvexHull

    hull = points[ConvexHull(points).vertices]
    # A circuit's bits depend on the order of the corners; scipy does not define the first corner.
    return np.roll(hull, -np.lexsort((hull[:, 1], hull[:, 0]))[0], axis=0)


def _without_short_sides(corners: np.ndarray, shortest: float) -> np.ndarray:
    """Return a polygon with sides below a length replaced by their middle, shortest first."""
    while len(corners) > 4:
        sides = lengths(np.roll(corners, -1, axis=0) - corners)
        k = int(np.argmin(sides))
        if sides[k] >= shortest:
            break
        nxt = (k + 1) % len(corners)
        corners = corners.copy()
        corners[k] = 0.5 * (corners[k] + corners[nxt])
        corners = np.delete(corners, nxt, axis=0)
    return corners
