"""Obstacles (boxes, circles) on a track: standing ones in walls and distance field, moving ones."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sines_cosines
from pcs_racing.base.errors import InputError, check_array
from pcs_racing.base.typing import Floats
from pcs_racing.track.frenet import corners_along
from pcs_racing.track.moving import BOX, MOTION, make_lanes
from pcs_racing.track.track import Track

MAX_BOXES = 100
MIN_SIDE, MAX_SIDE = 0.05, 10.0  # m: limits of box sides and diameters
MAX_SPEED, MAX_SWAY = 20.0, 10.0  # m/s, m
CORNERS = 16  # corners of a circle: the sides are at most 2 % of the radius inside it


def with_obstacles(track: Track, boxes: ArrayLike) -> Track:
    """Return a track with obstacles as walls, for lidar, crashes and planners.

    Race line, free widths, calibration and ``content_hash`` are unchanged: obstacles belong to an
    episode. Each of at most 100 boxes is a row of :data:`BOX`, with sides from 0.05 to 10 m. A
    circle is a polygon of 16 corners for walls and lidar. Without boxes the result is the track
    itself.

    Rows may also hold the numbers of :data:`MOTION`. An obstacle with a speed or a sway is no wall:
    it keeps its distance from the race line, or the distance of its half diagonal and about two
    cells from the walls, and moves through everything in its way. Cars touch it as they touch a
    wall, the lidars of a race see it, and a planner sees the nearest along the track of moving
    obstacles and opponents. It is left out of times to collision.
    """
    given = obstacle_rows(boxes)
    if len(given) == 0:
        return track
    moves = given[:, len(BOX) :].any(axis=1)
    standing = given[~moves, : len(BOX)]
    if len(standing):
        track = _with_walls(track, standing)
    if not moves.any():
        return track
    moving = [one for one in (track.arrays.moving, moving_rows(track, given[moves])) if len(one)]
    return replace(track, arrays=track.arrays._replace(moving=np.concatenate(moving)))


def obstacle_rows(boxes: ArrayLike) -> Floats:
    """Return obstacles as rows of :data:`BOX` and :data:`MOTION`, shape (K, 7); refuse bad ones."""
    whole = len(BOX) + len(MOTION)
    try:
        shape = np.shape(boxes)
    except ValueError:  # rows of several lengths, refused below
        shape = ()
    columns = whole if shape[1:] == (whole,) else len(BOX)
    given = check_array(
        "obstacles", np.empty((0, columns)) if 0 in shape else boxes, (None, columns)
    )
    given = np.concatenate([given, np.zeros((len(given), whole - columns))], axis=1)
    if len(given) > MAX_BOXES:
        raise InputError(f"there are {len(given)} obstacles; {MAX_BOXES} are the limit")
    sides, motion = given[:, 3:5], np.abs(given[:, 5:])
    fine = (sides >= MIN_SIDE) & (sides <= MAX_SIDE)
    wrong = np.flatnonzero(~(fine[:, 0] & (fine[:, 1] | (sides[:, 1] == 0.0))))
    if len(wrong):
        raise InputError(
            f"obstacle {wrong[0]} measures {sides[wrong[0]].tolist()} m; its sides must be from"
            f" {MIN_SIDE:g} to {MAX_SIDE:g} m, or its width 0 for a round one"
        )
    wrong = np.flatnonzero((motion > (MAX_SPEED, MAX_SWAY)).any(axis=1))
    if len(wrong):
        raise InputError(
            f"obstacle {wrong[0]} has speed and sway {given[wrong[0], 5:].tolist()}; they must be"
            f" within {MAX_SPEED:g} m/s and {MAX_SWAY:g} m"
        )
    return given


def moving_rows(track: Track, given: Floats) -> Floats:
    """Return moving obstacles, rows of :data:`BOX` and :data:`MOTION`, as `TrackArrays.moving`."""
    frenet = track.to_frenet(given[:, :2])
    turn = given[:, 2] - track.to_cartesian(frenet)[:, 2]
    rows = []
    for (*_, length, width, speed, sway), (s, d), angle in zip(given, frenet, turn, strict=True):
        lanes = make_lanes(track.arrays, d, sway, 0.5 * float(np.hypot(length, width)))
        rows.append([s, speed, angle, 0.5 * length, 0.5 * width, *lanes.ravel()])
    return np.array(rows)


def _with_walls(track: Track, given: Floats) -> Track:
    """Return a track with standing obstacles, rows of :data:`BOX`."""
    arrays = track.arrays
    sine, cosine = sines_cosines(given[:, 2])
    # An obstacle changes no cell nearer to a wall, so its reach is at most the widest place.
    distance = arrays.distance.copy()
    reach = float(distance.max())
    for (x, y, _, length, width), s, c in zip(given, sine, cosine, strict=True):
        half = np.hypot(length, width) / 2.0 + reach + arrays.cell
        columns = _window(x - arrays.origin_x, half, arrays.cell, distance.shape[1])
        rows = _window(y - arrays.origin_y, half, arrays.cell, distance.shape[0])
        dx = (np.arange(columns.start, columns.stop) + 0.5) * arrays.cell + (arrays.origin_x - x)
        dy = ((np.arange(rows.start, rows.stop) + 0.5) * arrays.cell + (arrays.origin_y - y))[
            :, None
        ]
        if width > 0.0:
            along = np.maximum(np.abs(dx * c + dy * s) - 0.5 * length, 0.0)
            across = np.maximum(np.abs(dy * c - dx * s) - 0.5 * width, 0.0)
            away = np.sqrt(along * along + across * across)
        else:
            away = np.maximum(np.sqrt(dx * dx + dy * dy) - 0.5 * length, 0.0)
        part = distance[rows, columns]
        np.minimum(part, away, out=part, casting="same_kind")
    square = given[:, 4] > 0.0
    sides = np.concatenate(
        [_sides(given[square], sine[square], cosine[square]), _round_sides(given[~square])]
    )
    walls = np.concatenate([arrays.walls, sides])
    start, seen, far = _list_sides(
        arrays.seen_start,
        arrays.seen,
        arrays.seen_distance,
        arrays.seen_middle,
        sides,
        len(arrays.walls),
    )
    return replace(
        track,
        arrays=arrays._replace(
            distance=distance,
            walls=walls,
            seen_start=start,
            seen=seen,
            seen_distance=far,
            corners=np.concatenate([arrays.corners, corners_along(sides).T], axis=1),
        ),
    )


def _window(middle: float, half: float, cell: float, cells: int) -> slice:
    first, last = np.floor((middle - half) / cell), np.ceil((middle + half) / cell)
    return slice(int(np.clip(first, 0, cells)), int(np.clip(last, 0, cells)))


def _sides(boxes: Floats, sine: Floats, cosine: Floats) -> Floats:
    """Return the four sides of each box, shape (4 K, 4), clockwise: the track is on the left."""
    u = 0.5 * boxes[:, 3:4] * np.array([1.0, 1.0, -1.0, -1.0])
    v = 0.5 * boxes[:, 4:5] * np.array([1.0, -1.0, -1.0, 1.0])
    s, c = sine[:, None], cosine[:, None]
    return _closed(
        np.stack([boxes[:, 0:1] + u * c - v * s, boxes[:, 1:2] + u * s + v * c], axis=-1)
    )


def _round_sides(circles: Floats) -> Floats:
    """Return the sides of each circle's polygon as segments, shape (16 K, 4), clockwise."""
    sine, cosine = sines_cosines(np.arange(CORNERS) * (-2.0 * np.pi / CORNERS))
    radius = 0.5 * circles[:, 3:4]
    return _closed(
        np.stack([circles[:, 0:1] + radius * cosine, circles[:, 1:2] + radius * sine], axis=-1)
    )


def _closed(corners: Floats) -> Floats:
    """Return the segments between successive corners of polygons, shape (K, C, 2)."""
    return np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 4)


@compiled
def _list_sides(start, seen, far, middle, sides, first):
    """Insert every side into the list of every stretch by distance; walls hide invisible sides."""
    count = sides.shape[0]
    stretches = middle.shape[0]
    new_start = np.empty(stretches + 1, np.int32)
    new_seen = np.empty(seen.shape[0] + count * stretches, np.int32)
    new_far = np.empty(seen.shape[0] + count * stretches, np.float32)
    away = np.empty(count, np.float32)
    at = 0
    for m in range(stretches):
        new_start[m] = at
        for k in range(count):
            ax, ay = sides[k, 0] - middle[m, 0], sides[k, 1] - middle[m, 1]
            ex, ey = sides[k, 2] - sides[k, 0], sides[k, 3] - sides[k, 1]
            share = min(max(-(ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            x, y = ax + share * ex, ay + share * ey
            away[k] = np.float32(np.sqrt(x * x + y * y) * (1.0 - 1e-6))  # rounded down like ``far``
        # Merge two sorted lists.
        order = np.argsort(away)
        k = 0
        for i in range(start[m], start[m + 1]):
            while k < count and away[order[k]] < far[i]:
                new_seen[at], new_far[at] = first + order[k], away[order[k]]
                at += 1
                k += 1
            new_seen[at], new_far[at] = seen[i], far[i]
            at += 1
        while k < count:
            new_seen[at], new_far[at] = first + order[k], away[order[k]]
            at += 1
            k += 1
    new_start[stretches] = at
    return new_start, new_seen, new_far
