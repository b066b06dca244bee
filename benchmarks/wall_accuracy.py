"""How well the wall polylines of a track stand for its cells, for several tolerances and insets.

``python benchmarks/wall_accuracy.py FOLDER ...`` casts beams from random poses, at least half a car's width off the
walls, exactly through the cells and against the segments of `walls.simplify`. The line that tracks are built with is
marked with a star.
"""

import argparse

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.track.building import build as track_building
from pcs_racing.track.building.walls import simplify, trace_outlines
from pcs_racing.track.grid import cast
from pcs_racing.track.loading import load_track


@compiled
def _exact(drivable, poses, angles, reach):  # type: ignore[no-untyped-def]
    out = np.empty((poses.shape[0], angles.shape[0]))
    for p in range(poses.shape[0]):
        for a in range(angles.shape[0]):
            angle = poses[p, 2] + angles[a]
            out[p, a] = cast(drivable, poses[p, 0], poses[p, 1], np.cos(angle), np.sin(angle), reach)[0]
    return out


@compiled
def _segments(walls, poses, angles, reach):  # type: ignore[no-untyped-def]
    out = np.full((poses.shape[0], angles.shape[0]), reach)
    for p in range(poses.shape[0]):
        for a in range(angles.shape[0]):
            c, s = np.cos(poses[p, 2] + angles[a]), np.sin(poses[p, 2] + angles[a])
            for k in range(walls.shape[0]):
                x, y = walls[k, 0] - poses[p, 0], walls[k, 1] - poses[p, 1]
                dx, dy = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
                det = c * dy - s * dx
                if det != 0.0:
                    r = (x * dy - y * dx) / det
                    u = (x * s - y * c) / det
                    if 0.0 < r < out[p, a] and 0.0 <= u <= 1.0:
                        out[p, a] = r
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--poses", type=int, default=100)
    parser.add_argument("--beams", type=int, default=1080)
    settings = parser.parse_args()
    print("track          tolerance  inset  segments  median m   p99 m  >1 m per 1000   mean m")
    for folder in settings.folders:
        track = load_track(folder)
        arrays = track.arrays
        drivable = arrays.distance > 0.0
        rng = np.random.default_rng(0)
        rows, cols = np.nonzero(arrays.distance > 0.155)
        k = rng.integers(len(rows), size=settings.poses)
        turn = rng.uniform(-np.pi, np.pi, settings.poses)
        poses = np.column_stack([cols[k] + rng.random(settings.poses), rows[k] + rng.random(settings.poses), turn])
        angles = np.linspace(-2.35, 2.35, settings.beams)
        reach = 30.0 / arrays.cell
        exact = _exact(drivable, poses, angles, reach)
        outlines = trace_outlines(drivable)
        used = max(track_building.SIMPLIFY_CELLS, track_building.SIMPLIFY / arrays.cell), track_building.INSET
        for tolerance, inset in (used, (used[0], 0.0), (0.3, used[1]), (0.75, used[1]), (1.0, used[1])):
            segments, _, _ = simplify(outlines, tolerance, inset)
            error = (_segments(segments, poses, angles, reach) - exact) * arrays.cell
            print(
                f"{track.name:14s} {tolerance:8.2f} {inset:6.2f}{'*' if (tolerance, inset) == used else ' '} "
                f"{len(segments):8d} {np.median(np.abs(error)):9.4f} {np.quantile(np.abs(error), 0.99):7.3f} "
                f"{1e3 * np.mean(np.abs(error) > 1.0):14.2f} {np.mean(np.clip(error, -0.3, 0.3)):+9.4f}"
            )


if __name__ == "__main__":
    main()
