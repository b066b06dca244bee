"""Holes in walls: stretches of a wall through which lidar beams pass and cars do not."""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.elementary import lengths
from pcs_racing.base.errors import InputError
from pcs_racing.track.building.walls import corners_along
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.map_files import check_holes
from pcs_racing.track.track import Track

PIECE = 0.05  # m: walls are cut into pieces of at most this length, each whole or in a hole

Floats = NDArray[np.float64]


def with_holes(track: Track, holes: Iterable[Any]) -> Track:
    """Return a track with holes in its walls, in place of the holes that it had.

    A hole ``(side, first, last)`` is a stretch of the wall on the ``"left"`` or ``"right"`` of the
    race line, from one arc length forward to another (m, in [0, length)); it may lead over the
    start line. A beam of a lidar passes through a hole, and ends at the next wall, seen from either
    side, or at the lidar's range. For cars, Frenet coordinates and times to collision the wall has
    no hole. The ``content_hash`` changes with the holes.

    Examples
    --------
    >>> import pcs_racing
    >>> track = with_holes(pcs_racing.load_track("Pipkin"), [("left", 10.0, 12.5)])
    """
    given, arrays = check_holes(holes, track.length), track.arrays
    stretches = len(arrays.seen_middle)
    if arrays.corners_start[-1] < arrays.corners.shape[1] or len(arrays.moving):
        raise InputError("the track has obstacles; make holes before obstacles")
    if not given and len(arrays.corners_start) == stretches + 1:
        return track
    start = arrays.corners_start[: stretches + 1]
    parts = [arrays.corners[:, : start[-1]]]
    if given:
        pieces, open_ = _pieces(track, given)
        solid = pieces[~open_]
        back = solid[::-1][:, [2, 3, 0, 1]]
        parts += [corners_along(pieces[open_]).T]
        parts += [np.concatenate([corners_along(solid), corners_along(back)]).T]
        start = np.cumsum([0, *np.diff(start), *(part.shape[1] for part in parts[1:])])
    solid_hash = track.solid_hash or track.content_hash
    digest = hashlib.sha256(f"{solid_hash} {given}".encode()).hexdigest()
    return replace(
        track,
        content_hash=digest if given else solid_hash,
        solid_hash=solid_hash if given else "",
        arrays=arrays._replace(
            corners_start=start.astype(np.int32),
            corners=np.ascontiguousarray(np.concatenate(parts, axis=1)),
        ),
    )


def hole_segments(arrays: TrackArrays) -> Floats:
    """Return the wall segments in holes, shape (S, 4), m."""
    stretches = len(arrays.seen_middle)
    if len(arrays.corners_start) == stretches + 1:
        return np.empty((0, 4))
    first, last = arrays.corners_start[stretches : stretches + 2]
    corners = arrays.corners[:, first:last].T
    segments = np.concatenate([corners[:-1], corners[1:]], axis=1)
    return segments[np.isfinite(segments).all(axis=1)]


def _pieces(track: Track, holes: list[tuple[str, float, float]]) -> tuple[Floats, NDArray[Any]]:
    """Return the walls as segments in order, each whole or in a hole, and a flag for the holes."""
    walls, cell = track.arrays.walls, track.arrays.cell
    along = walls[:, 2:] - walls[:, :2]
    far = lengths(along)
    counts = np.maximum(np.ceil(far / PIECE), 1.0).astype(int)
    of = np.repeat(np.arange(len(walls)), counts)
    nth = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    begin = walls[of, :2] + along[of] * (nth / counts[of])[:, None]
    middle = walls[of, :2] + along[of] * ((nth + 0.5) / counts[of])[:, None]
    # A point on the track, next to the wall: the track lies on the left of a segment.
    inwards = along[of][:, ::-1] * (-1.0, 1.0) * (cell / far[of])[:, None]
    s, d = track.to_frenet(middle + inwards).T
    open_ = np.zeros(len(of), np.bool_)
    for side, first, last in holes:
        between = (s >= first) & (s <= last)
        if first > last:  # over the start line
            between = (s >= first) | (s <= last)
        open_ |= between & ((d > 0.0) == (side == "left"))
    # Neighbouring pieces of a segment of one kind are a single segment.
    new = np.append(True, (of[1:] != of[:-1]) | (open_[1:] != open_[:-1]))
    of, begin, open_, nth = of[new], begin[new], open_[new], nth[new]
    end = np.roll(begin, -1, axis=0)
    last_one = np.append(of[1:] != of[:-1], True)
    end[last_one] = walls[of[last_one], 2:]
    return np.concatenate([begin, end], axis=1), open_
