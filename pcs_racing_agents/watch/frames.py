"""Frames of a recorded race in sequence, animated GIFs of them, and pictures of tracks."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pcs_racing.base.errors import InputError, check_number, require
from pcs_racing.base.files import write_atomically
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.replay import Replay
from pcs_racing.track.frenet import PSI, X, Y
from pcs_racing.track.track import Track

_TRAIL = 2.0  # s


def replay_frames(
    replay: Replay,
    renderer: Renderer | None = None,
    *,
    fps: float = 20.0,
    speed: float = 1.0,
    candidates: bool = False,
) -> Iterator[np.ndarray]:
    """Yield frames of a recorded race, uint8 of shape (height, width, 3), for any video writer.

    The renderer must be in mode ``"rgb_array"``; by default it shows the whole track. ``fps`` is
    the frame rate of the video, ``speed`` the number of race seconds per video second. With
    ``candidates`` the considered paths are drawn, if they were recorded.
    """
    check_number("fps", fps, maximum=1000.0, above=0.0)
    check_number("speed", speed, maximum=1000.0, above=0.0)
    renderer = renderer or Renderer(replay)
    if renderer.mode != "rgb_array":
        raise InputError("frames of a replay need a renderer in mode 'rgb_array'")
    return _frames(replay, renderer, speed / fps, candidates)


def _frames(
    replay: Replay, renderer: Renderer, step: float, candidates: bool
) -> Iterator[np.ndarray]:
    for k in range(int(replay.duration / step + 1e-9) + 1):
        # A product, not a sum of steps: rounding errors would shift the last frames.
        time = k * step
        i = min(round(time / replay.frame_dt), len(replay.cars) - 1)
        since = max(0, i - round(_TRAIL / replay.frame_dt))
        order = np.argsort(-replay.progress[i], kind="stable")
        lead = replay.progress[i, order[0]] - replay.progress[i, order[min(1, len(order) - 1)]]
        shown: dict[str, Any] = {}
        plan = int(time / replay.plan_dt + 1e-6)
        if replay.paths is not None and len(replay.paths):
            shown["plans"] = replay.paths[min(plan, len(replay.paths) - 1)]
        if (
            candidates
            and replay.candidates is not None
            and replay.costs is not None
            and len(replay.costs)
        ):
            row = min(plan, len(replay.costs) - 1)
            shown |= {"candidates": replay.candidates[row], "costs": replay.costs[row]}
        frame = renderer.render(
            replay.cars[i],
            trails=replay.cars[since : i + 1, :, :2],
            names=replay.car_names,
            text=f"{time:.1f} s    {replay.car_names[order[0]]:.60} leads by {lead:.1f} m",
            **shown,
        )
        if frame is not None:
            yield frame


def write_gif(
    replay: Replay,
    path: str | os.PathLike[str],
    *,
    renderer: Renderer | None = None,
    fps: float = 10.0,
    speed: float = 2.0,
    candidates: bool = False,
) -> Path:
    """Write a recorded race as an animated GIF; an existing file is replaced in one step.

    Arguments are as for :func:`replay_frames`, but the default renderer has 640 x 420 pixels, and
    the maximum of ``fps`` is 50 (a GIF counts in hundredths of a second).
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise InputError(f"write_gif writes .gif files, got {path.name!r}")
    check_number("fps", fps, maximum=50.0, above=0.0)
    frames = replay_frames(
        replay, renderer or Renderer(replay, 640, 420), fps=fps, speed=speed, candidates=candidates
    )
    first = Image.fromarray(next(frames)).quantize(128)
    # One palette for all frames: a smaller file, faster, no flicker.
    rest = (
        Image.fromarray(frame).quantize(palette=first, dither=Image.Dither.NONE) for frame in frames
    )
    write_atomically(
        path,
        lambda file: first.save(
            file,
            "GIF",
            save_all=True,
            append_images=rest,
            duration=round(100 / fps) * 10,
            loop=0,
            optimize=False,
        ),
    )
    return path


def write_video(
    replay: Replay, path: str | os.PathLike[str], *, fps: float = 25.0, speed: float = 1.0
) -> Path:
    """Write a recorded race as an MP4 of 960 x 640 pixels; needs imageio-ffmpeg (the extra video).

    ``fps`` and ``speed`` are as for :func:`replay_frames`.
    """
    path = Path(path)
    if path.suffix != ".mp4":
        raise InputError(f"write_video writes .mp4 files, got {path.name!r}")
    require("imageio_ffmpeg", extra="video")
    from imageio_ffmpeg import write_frames

    frames = replay_frames(replay, Renderer(replay, 960, 640), fps=fps, speed=speed)
    partial = path.with_name(f".{path.name[:100]}.part.mp4")
    try:
        writer = write_frames(str(partial), (960, 640), fps=fps, macro_block_size=None)
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def write_track_picture(track: Track, path: str | os.PathLike[str]) -> Path:
    """Write a PNG of a track: road, walls, race line coloured by speed, and a car at the start.

    The car points in the driving direction.
    """
    path = Path(path)
    if path.suffix != ".png":
        raise InputError(f"write_track_picture writes .png files, got {path.name!r}")
    low, high = (of(track.arrays.walls.reshape(-1, 2), axis=0) for of in (np.min, np.max))
    width, height = (
        np.clip(960.0 * (high - low + 2.0) / (high - low + 2.0).max(), 320.0, 960.0)
        .astype(int)
        .tolist()
    )
    car = np.zeros((1, _vehicle.STATE_SIZE))
    car[0, [_vehicle.X, _vehicle.Y, _vehicle.PSI]] = track.line[0, [X, Y, PSI]]
    frame = Renderer(track, width, height).render(car, text=f"{track.name}: {track.length:.0f} m")
    # A palette makes the file three times smaller.
    image = Image.fromarray(np.asarray(frame)).quantize(128, dither=Image.Dither.NONE)
    write_atomically(path, lambda file: image.save(file, "PNG", optimize=True))
    return path
