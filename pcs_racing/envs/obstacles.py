"""Random obstacles of each episode: their number, size and places."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.elementary import lengths
from pcs_racing.base.errors import ConfigError, is_whole, say_once
from pcs_racing.base.settings import OneOf, Settings, load_settings, number_range
from pcs_racing.track.frenet import LEFT, RIGHT
from pcs_racing.track.moving import BOX, LANES, MOTION, make_lanes
from pcs_racing.track.obstacles import moving_rows
from pcs_racing.track.track import Track

MAX_COUNT = 20
SHAPES = ("box", "circle", "both", "roboracer")
ROBORACER_BOX = (0.35, 0.32)  # m: box of RoboRacer's test of obstacle avoidance
TRIES = 50  # max number of places tried for an obstacle
BEFORE_START, AFTER_START = 3.0, 8.0  # free distances before and after the start, m
ACROSS = 0.2  # m: max distance between two checked places of a moving obstacle across the line


class _Placed(NamedTuple):
    """An obstacle with its place in Frenet coordinates."""

    row: NDArray[np.float64]  #: Numbers of :data:`pcs_racing.track.moving.BOX` and ``MOTION``.
    s: float
    d: float
    reach: float  #: Half diagonal, m: at any heading, a box stays within it.
    lanes: NDArray[np.float64]  #: shape (2, N): Lanes of a moving obstacle, else (2, 0).
    path: NDArray[np.float64]  #: shape (P, 2): All places between its lanes (m), else (0, 2).


@dataclass(frozen=True)
class Obstacles(Settings):
    """Obstacles on the track during an episode, with uniform random place, heading and sides."""

    count: Annotated[
        tuple[int, int],
        number_range(0, MAX_COUNT, " of obstacles", is_whole),
        "Number of obstacles, or its min and max.",
    ] = (1, 3)
    size: Annotated[
        tuple[float, float],
        number_range(0.05, 2.0, " of obstacles"),
        "Length of a side, or its min and max, m.",
    ] = (0.2, 0.4)
    shape: Annotated[
        str,
        OneOf(SHAPES),
        "Boxes, circles (their diameter is drawn like a side), either, or boxes of .35 x .32 m as"
        " in RoboRacer's test, for any size.",
    ] = "box"
    passage: Annotated[
        float,
        Interval(ge=0.4, le=10.0),
        "Free width between an obstacle and the wall on one of its sides, m.",
    ] = 1.0
    apart: Annotated[
        float, Interval(ge=0.0, le=1000.0), "Distance between two obstacles along the race line, m."
    ] = 5.0
    moving: Annotated[
        tuple[int, int],
        number_range(0, MAX_COUNT, " of obstacles", is_whole),
        "Number of obstacles that move around the track, or its min and max.",
    ] = (0, 0)
    speed: Annotated[
        tuple[float, float],
        number_range(0.0, 4.0, " of obstacles"),
        "Speed of the moving obstacles of an episode along the race line, m/s.",
    ] = (0.5, 1.5)
    sway: Annotated[
        tuple[float, float],
        number_range(0.0, 2.0, " of obstacles"),
        "Amplitude of the motion of a moving one across the race line, in a period of 4 s, m.",
    ] = (0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.moving[0] > self.count[0] or self.moving[1] > self.count[1]:
            raise ConfigError(
                f"moving is {list(self.moving)}, and count is {list(self.count)}: no more obstacles"
                " can move than there are"
            )

    def draw(
        self, track: Track, starts: Sequence[float], generator: np.random.Generator
    ) -> NDArray[np.float64]:
        """Draw the obstacles of an episode, shape (K, 7).

        Obstacles without room are left out, and reported once for each number.

        ``starts`` are the arc lengths of the cars (m). The track is free from 3 m before to 8 m
        after each of them. Moving obstacles come first. They have the same speed, and their lanes
        leave a passage all around the track and lead past walls and standing obstacles at a
        distance of at least a cell of the map.
        """
        placed: list[_Placed] = []
        count = int(generator.integers(self.count[0], self.count[1] + 1))
        moving, speed = 0, 0.0
        if self.moving[1] > 0:  # a seed draws the same standing obstacles as ever
            moving = int(generator.integers(self.moving[0], self.moving[1] + 1))
            speed = float(generator.uniform(*self.speed))
        for nth in range(count):
            # An episode with fewer obstacles is better than an endless search on a narrow track.
            for _ in range(TRIES):
                one = self._try(track, speed, nth < moving, generator)
                if self._fits(track, one, placed, starts):
                    placed.append(one)
                    break
        if len(placed) < count:
            say_once(
                f"there was room for {len(placed)} of {count} obstacles in an episode (size"
                f" {list(self.size)}, passage {self.passage:g}, apart {self.apart:g} m)"
            )
        return np.array([one.row for one in placed]).reshape(-1, len(BOX) + len(MOTION))

    def _try(
        self, track: Track, speed: float, moves: bool, generator: np.random.Generator
    ) -> _Placed:
        """Draw an obstacle anywhere on the track."""
        line, ds = track.arrays.line, track.arrays.ds
        s, across, heading = generator.random(3) * (track.length, 1.0, np.pi)
        sides = self.size[0] + (self.size[1] - self.size[0]) * generator.random(2)
        if self.shape == "roboracer":
            sides = np.array(ROBORACER_BOX)
        if self.shape == "circle" or (self.shape == "both" and generator.random() < 0.5):
            heading, sides[1] = 0.0, 0.0
        sample = line[int(s / ds) % len(line)]
        reach = 0.5 * float(np.hypot(*sides))
        d = -sample[RIGHT] + across * (sample[LEFT] + sample[RIGHT])
        motion = [0.0, 0.0]
        if moves:
            sway = float(generator.uniform(*self.sway) * generator.choice((-1.0, 1.0)))
            motion = [speed, sway]
            lanes = make_lanes(track.arrays, d, sway, reach)
            # The place at the start is in the middle of the lanes, off the walls.
            d = float(lanes[:, int(s / ds) % len(line)].mean())
        x, y, along = track.to_cartesian([s, d])
        row = np.array([x, y, np.mod(along + heading, 2.0 * np.pi), *sides, *motion])
        lanes = (
            moving_rows(track, row[None])[0, LANES:].reshape(2, -1) if moves else np.empty((2, 0))
        )
        return _Placed(row, s, d, reach, lanes, _path(track, lanes))

    def _fits(
        self, track: Track, one: _Placed, placed: Sequence[_Placed], starts: Sequence[float]
    ) -> bool:
        """Return whether an obstacle leaves a passage, and room for cars and other obstacles."""
        line, length = track.arrays.line, track.length
        if one.lanes.size:
            left, right = line[:, LEFT] - one.lanes.max(axis=0), line[:, RIGHT] + one.lanes.min(0)
            free = float(np.maximum(left, right).min()) - one.reach
            if track.wall_distance(one.path).min() < one.reach + track.arrays.cell:
                return False
        else:
            sample = line[int(one.s / track.arrays.ds) % len(line)]
            free = max(sample[LEFT] - one.d, sample[RIGHT] + one.d) - one.reach
        near = min((abs(_around(one.s - other.s, length)) for other in placed), default=np.inf)
        away = all(
            not -BEFORE_START <= _around(one.s - start, length) <= AFTER_START for start in starts
        )
        return (
            free >= self.passage
            and near >= self.apart
            and away
            and not any(_meet(track, other, one) for other in placed)
        )


def _path(track: Track, lanes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places all around the track on two lanes and between them, shape (P, 2), m."""
    if not lanes.size:
        return np.empty((0, 2))
    low, high = lanes
    share = np.linspace(0.0, 1.0, 2 + int(np.ptp(lanes, axis=0).max() / ACROSS))
    d = low + share[:, None] * (high - low)
    s = np.broadcast_to(np.arange(len(low)) * track.arrays.ds, d.shape)
    return track.to_cartesian(np.stack([s, d], axis=-1))[..., :2].reshape(-1, 2)


def _meet(track: Track, moving: _Placed, standing: _Placed) -> bool:
    """Return whether a moving obstacle comes within a cell of a standing one on its way."""
    if standing.lanes.size:
        return False
    gap = moving.reach + standing.reach + track.arrays.cell
    return bool((lengths(moving.path - standing.row[:2]) < gap).any())


def _around(s: float, length: float) -> float:
    """Return an arc length on a closed line as the shorter way, between -length/2 and length/2."""
    return float(np.mod(s + 0.5 * length, length) - 0.5 * length)


def load_obstacles(
    source: Obstacles | Mapping[str, Any] | int | str | Path | None,
) -> Obstacles | None:
    """Return a configuration of obstacles, or None for none.

    The source is the configuration itself, a mapping, a YAML file, or the number of obstacles.

    Examples
    --------
    >>> load_obstacles(3).count
    (3, 3)
    """
    if source is None:
        return None
    if is_whole(source):
        return Obstacles(count=source)  # type: ignore[arg-type]
    return load_settings("obstacles", Obstacles(), source)  # type: ignore[arg-type]
