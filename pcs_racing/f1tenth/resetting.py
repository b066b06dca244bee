"""Start poses of generation B: on a grid or anywhere, along the centre line or the race line."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_number
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.f1tenth.lines import Track

_LENGTHS = {"min_dist": 1.5, "max_dist": 2.5, "start_width": 1.0}  # m


def starting_poses(track: Track, cars: int, config: Any, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw start poses, shape (N, 3), as a ``reset_config`` says."""
    if not isinstance(config, Mapping) or config.keys() - {"type", *_LENGTHS}:
        raise ConfigError(f"reset_config is {config!r:.200}; its keys are type, {', '.join(_LENGTHS)}")
    kind = config.get("type") or "rl_grid_static"
    words = kind.split("_") if isinstance(kind, str) else []
    choices = (("cl", "rl"), ("grid", "random"), ("static", "random"))
    if len(words) != 3 or any(word not in known for word, known in zip(words, choices, strict=True)):
        raise ConfigError(
            f"reset_config: type is {kind!r:.80}; it must be 'cl' or 'rl', 'grid' or 'random', 'static' or 'random', "
            "joined by '_'"
        )
    low, high, width = (
        check_number(f"reset_config: {name}", config.get(name, default), 0.01, 100.0, error=ConfigError)
        for name, default in _LENGTHS.items()
    )
    if high < low:
        raise ConfigError(f"reset_config: max_dist is {high:g} m; it must not be below min_dist, {low:g} m")
    line = track.centerline if words[0] == "cl" else track.raceline
    if line is None:
        raise InputError("this map has no centre line and no race line: give poses, reset(options={'poses': ...})")
    # From a point of the line onwards, each a drawn distance ahead of the one before, on both sides in turn.
    at = int(rng.integers(line.n if words[1] == "random" else max(int(width / (line.length / line.n)), 1)))
    points = np.stack([line.xs, line.ys], axis=1).astype(np.float64)
    ways = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    side = float(rng.choice([-1.0, 1.0])) / cars if words[0] == "cl" and cars > 1 else 0.0
    poses = np.empty((cars, 3))
    for i in range(cars):
        ahead = points[(at + 1) % line.n] - points[at]
        theta = np.arctan2(ahead[1], ahead[0])
        poses[i] = (*points[at] + side * np.array([-np.sin(theta), np.cos(theta)]), theta)
        side = -side
        gone = np.cumsum(np.roll(ways, -at))
        near, far = np.searchsorted(gone, low), np.searchsorted(gone, high, "right")
        at = (at + 1 + int(rng.integers(near, max(far, near + 1)))) % line.n
    if words[2] == "random":
        rng.shuffle(poses)
    return poses
