"""Random obstacles of each episode: their number, size and places."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.checks import is_whole
from pcs_racing.base.settings import OneOf, Settings, load_settings, number_range
from pcs_racing.envs.batch import read_numbers
from pcs_racing.track.frenet import LEFT, RIGHT
from pcs_racing.track.obstacles import BOX
from pcs_racing.track.track import Track

MAX_COUNT = 20
SHAPES = ("box", "circle", "both")
TRIES = 50  # max number of places tried for an obstacle
BEFORE_START, AFTER_START = 3.0, 8.0  # free distances before and after the start, m


@dataclass(frozen=True)
class Obstacles(Settings):
    """Obstacles on the track during an episode, with uniform random place, heading and sides."""

    count: Annotated[
        tuple[int, int],
        number_range(0, MAX_COUNT, " of obstacles", is_whole),
        "How many there are: a number, or the smallest and the largest.",
    ] = (1, 3)
    size: Annotated[
        tuple[float, float],
        number_range(0.05, 2.0, " of obstacles"),
        "Length of a side, or the shortest and the longest, m.",
    ] = (0.2, 0.4)
    shape: Annotated[
        str,
        OneOf(SHAPES),
        "What they are: boxes, circles (their diameter is drawn as a side is), or either.",
    ] = "box"
    passage: Annotated[
        float,
        Interval(ge=0.4, le=10.0),
        "Width that stays free between an obstacle and the wall on one of its sides, m.",
    ] = 1.0
    apart: Annotated[
        float, Interval(ge=0.0, le=1000.0), "Distance between two of them along the race line, m."
    ] = 5.0

    def draw(
        self, track: Track, starts: Sequence[float], generator: np.random.Generator
    ) -> NDArray[np.float64]:
        """Draw the obstacles of an episode, shape (K, 5); obstacles without room are left out.

        ``starts`` are the arc lengths of the cars (m). The track is free from 3 m before to 8 m
        after each of them.
        """
        line, length = track.arrays.line, track.length
        boxes: list[list[float]] = []
        places: list[float] = []
        for _ in range(int(generator.integers(self.count[0], self.count[1] + 1))):
            # An episode with fewer obstacles is better than an endless search on a narrow track.
            for _ in range(TRIES):
                s, across, heading = generator.random(3) * (length, 1.0, np.pi)
                sides = self.size[0] + (self.size[1] - self.size[0]) * generator.random(2)
                if self.shape == "circle" or (self.shape == "both" and generator.random() < 0.5):
                    heading, sides[1] = 0.0, 0.0
                sample = line[int(s / track.arrays.ds) % len(line)]
                # At any heading, a box stays within half of its diagonal.
                reach = 0.5 * float(np.hypot(*sides))
                d = -sample[RIGHT] + across * (sample[LEFT] + sample[RIGHT])
                free = max(sample[LEFT] - d, sample[RIGHT] + d) - reach
                near = min((abs(_around(s - other, length)) for other in places), default=np.inf)
                away = all(
                    not -BEFORE_START <= _around(s - start, length) <= AFTER_START
                    for start in starts
                )
                if free >= self.passage and near >= self.apart and away:
                    x, y, along = track.to_cartesian([s, d])
                    boxes.append([x, y, float(np.mod(along + heading, 2.0 * np.pi)), *sides])
                    places.append(s)
                    break
        return np.array(boxes).reshape(-1, len(BOX))


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


def obstacles_option(
    options: Mapping[str, Any], episodes: int
) -> Sequence[NDArray[np.float64]] | None:
    """Read the option "obstacles" of a reset, for all episodes or for each.

    It holds boxes (x, y, heading, length, width). A width of 0 means a circle
    (:data:`pcs_racing.track.obstacles.BOX`).
    """
    given = options.get("obstacles")
    if isinstance(given, list | tuple) and len(given) == 0:  # no second axis
        return [np.empty((0, len(BOX)))] * episodes
    shapes = ((None, len(BOX)), (episodes, None, len(BOX)))
    meaning = f"boxes ({', '.join(BOX)}) of shape (K, {len(BOX)}) or ({episodes}, K, {len(BOX)})"
    boxes = read_numbers(options, "obstacles", shapes, meaning)
    return None if boxes is None else list(np.broadcast_to(boxes, (episodes, *boxes.shape[-2:])))
