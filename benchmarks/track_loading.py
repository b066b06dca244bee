"""Time to load a track: fresh, from the cache on disk, and again in the same process; and the memory it takes.

``python benchmarks/track_loading.py [NAME_OR_FOLDER ...]`` (default: every shipped track). Compiles everything first,
so the figures hold for the second run on a machine. The cache on disk is a temporary one. The last two columns are the
time of `frenet.project` with the hint of the point before, and of `frenet.to_cartesian`.
"""

import argparse
import os
import tempfile
import time

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.track import frenet, loading
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track


@compiled
def _lap(arrays, points):  # type: ignore[no-untyped-def]
    s = 0.0
    total = 0.0
    for k in range(points.shape[0]):
        s, d = frenet.project(arrays, points[k, 0], points[k, 1], s)
        total += d
    return total


@compiled
def _there(arrays, sd):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(sd.shape[0]):
        x, y, _ = frenet.to_cartesian(arrays, sd[k, 0], sd[k, 1])
        total += x + y
    return total


def timed(name: str) -> tuple[float, Track]:
    start = time.perf_counter()
    loaded = load_track(name)
    return 1e3 * (time.perf_counter() - start), loaded


def nanoseconds(function, *arguments) -> float:
    function(*arguments)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        function(*arguments)
        best = min(best, time.perf_counter() - start)
    return 1e9 * best / len(arguments[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tracks", nargs="*", default=list_tracks())
    names = parser.parse_args().tracks
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PCS_RACING_CACHE"] = folder + "/compile"
        for name in names[:1]:
            load_track(name)
        os.environ["PCS_RACING_CACHE"] = folder + "/cache"
        print("track              m   fresh ms   disk ms  again ms   memory MB   walls  seen/stretch  project  back ns")
        for name in names:
            loading._loaded.clear()
            fresh, _ = timed(name)
            loading._loaded.clear()
            disk, loaded = timed(name)
            again, _ = timed(name)
            arrays = loaded.arrays
            memory = sum(value.nbytes for value in arrays if isinstance(value, np.ndarray)) / 1e6
            s = np.arange(0.0, loaded.length, 0.02)
            sd = np.column_stack([s, 0.2 * np.sin(s)])
            points = loaded.to_cartesian(sd)[:, :2].copy()
            print(
                f"{loaded.name:13s} {loaded.length:6.1f} {fresh:9.0f} {disk:9.1f} {again:9.3f} {memory:11.1f} "
                f"{len(arrays.walls):7d} {len(arrays.seen) / (len(arrays.seen_start) - 1):13.0f} "
                f"{nanoseconds(_lap, arrays, points):11.0f} {nanoseconds(_there, arrays, sd):8.0f}"
            )


if __name__ == "__main__":
    main()
