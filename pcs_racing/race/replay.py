"""Recorded race as a value, and the self-contained page that plays it."""

import json
import os
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.packing import COARSE, FINE, join_segments, pack, pack_paths
from pcs_racing.race.config import FULL_SIGHT


@dataclass(frozen=True)
class ReplayEvent:
    """Event at one moment of a race."""

    time: float  #: Seconds since the start.
    car: int  #: Index of the car.
    #: Kind: ``"crash"``, ``"overtake"`` and ``"move"`` have their own signs; any other word is
    #: allowed.
    kind: str
    text: str = ""  #: Text for the viewer, such as ``"aggressiveness +"``.


@dataclass(frozen=True, eq=False)
class Replay:
    """Recorded race."""

    title: str  #: Title, shown in the page's header with the track's name.
    track_name: str
    car_names: tuple[str, ...]  #: Names of the policies of the C cars, 1 to 8.
    #: shape (T, C, 7): States x, y, delta, v, psi, psi_dot, beta of the cars every ``frame_dt`` (m,
    #: rad, s).
    cars: np.ndarray
    #: shape (T, C): Cumulative arc length driven along the line in m; its difference is the lead.
    progress: np.ndarray
    #: shape (S, 4): Wall segments x0, y0, x1, y1 in m. Where they form closed loops, the track is
    #: filled between them.
    walls: np.ndarray
    line: np.ndarray  #: shape (N, 2): Points of the closed race line in m.
    half_sizes: np.ndarray  #: shape (C, 2): Half length and half width of each car in m.
    #: shape (N,): Max speed of the cars along the line in m/s, NaN where none drove; colours the
    #: line.
    line_speed: np.ndarray | None = None
    sight: float = FULL_SIGHT  #: Visible angle around the cars' headings, rad.
    frame_dt: float = 0.05  #: Seconds between two rows of ``cars``.
    #: shape (T, C): Minimum instantaneous time to collision of each car in s.
    ittc: np.ndarray | None = None
    plan_dt: float = 0.1  #: Seconds between two plans; plan k is made at ``k * plan_dt``.
    #: shape (K, C, P, 4): Plan of each car: points x, y (m), speed (m/s) and time (s, from the
    #: moment of the plan); rows after the last point are NaN.
    paths: np.ndarray | None = None
    #: shape (K, C, Q, P', 2): Points x, y of every considered path; rows after the last point are
    #: NaN.
    candidates: np.ndarray | None = None
    #: shape (K, C, Q): Costs of the ``candidates``, given together with them; infinite for a
    #: rejected path.
    costs: np.ndarray | None = None
    events: tuple[ReplayEvent, ...] = ()  #: Events in order of time.
    outcome: str = ""  #: Outcome in words.
    #: shape (T, M, H, 2): Corners x, y of the moving obstacles in m, in order; a corner may repeat.
    moving: np.ndarray | None = None

    @property
    def duration(self) -> float:
        """Time of the last frame in s."""
        return (len(self.cars) - 1) * self.frame_dt

    @property
    def lead(self) -> np.ndarray:
        """Lead of car 0 over the first of the other cars in m, shape (T,); 0 if alone."""
        rivals = self.progress[:, 1:] if len(self.car_names) > 1 else self.progress
        return np.asarray(self.progress[:, 0] - rivals.max(axis=1))


def save_replay(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write a race as a page (``.html``), in one step.

    Numbers are rounded: to 1 mm, 1 mm/s and 1 mrad for cars and line, to 1 cm for paths and walls.
    The page is one file, needs no network, and opens from a disk. A link may name a moment:
    ``race.html#t=12.5&follow=1&candidates=1`` (``follow``: ``0``, ``1``, ``both`` or ``track``;
    also ``play=1``, ``speed=0.5``, ``plans=0``, ``sight=1``, ``zoom=2``, ``theme=dark``).
    """
    path = Path(path)
    if path.suffix != ".html":
        raise InputError(f"a replay is saved as .html, got {path.name!r}")
    write_atomically(path, replay_page(replay))
    return path


def player_page() -> str:
    """Return the page of a replay, without a race."""
    return files("pcs_racing.race").joinpath("replay.html").read_text(encoding="utf-8")


def replay_page(replay: Replay) -> str:
    """Return the page that :func:`save_replay` writes, for use inside another page."""
    return player_page().replace("<!--replay-->", safe_json(page_values(replay)))


def safe_json(values: Any) -> str:
    """Return JSON that is safe in a script element: no ``<``, ``>`` and ``&``, all ASCII."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def page_values(replay: Replay) -> dict[str, Any]:
    """Return a replay as plain values for the JSON of its page; absent parts are left out."""
    walls = join_segments(replay.walls)
    values: dict[str, Any] = {
        "title": replay.title,
        "track_name": replay.track_name,
        "outcome": replay.outcome,
        "frame_dt": replay.frame_dt,
        "plan_dt": replay.plan_dt,
        "car_names": list(replay.car_names),
        "half_sizes": np.asarray(replay.half_sizes).tolist(),
        "events": [
            [round(event.time, 3), event.car, event.kind, event.text] for event in replay.events
        ],
        "walls": {
            "points": pack(np.vstack([np.empty((0, 2)), *walls]), COARSE, [0]),
            "counts": [len(wall) for wall in walls],
        },
        "line": pack(replay.line, FINE, [0, 0]),
        "cars": pack(replay.cars[..., :5], FINE, [0, 0]),
        "progress": pack(replay.progress, FINE, [0, 0]),
    }
    if replay.line_speed is not None:
        values["line_speed"] = pack(np.nan_to_num(replay.line_speed, nan=-1.0), COARSE, [0])
    if replay.sight < FULL_SIGHT and len(replay.car_names) > 1:
        values["sight"] = replay.sight
    if replay.ittc is not None:
        values["ittc"] = pack(replay.ittc, COARSE, [0])
    if replay.moving is not None:
        values["moving"] = pack(replay.moving, FINE, [0, 0])
    if replay.paths is not None:
        values["paths"] = pack_paths(replay.paths[..., [0, 1, 3]])
    if replay.candidates is not None and replay.costs is not None:
        values["candidates"] = pack_paths(replay.candidates)
        values["ranks"] = pack(_ranks(replay.costs), 1)
    return values


def _ranks(costs: np.ndarray) -> np.ndarray:
    """Return the rank of each candidate, 1 for the highest cost; 0 if rejected."""
    # Rejected candidates come first in descending order of cost.
    order = np.argsort(np.argsort(-costs, axis=-1, kind="stable"), axis=-1)
    return np.where(np.isfinite(costs), order + 1.0, 0.0)
