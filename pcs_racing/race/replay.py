"""A recorded race: the value, its JSON, and the one self-contained HTML page that plays it.

The page (``replay.html`` beside this file) needs no network and no server. The race is the JSON inside it, so the page
is also the file that `read_replay` reads back.
"""

import html
import json
import os
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.checks import check_number, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.packing import (
    COARSE,
    FINE,
    pack,
    pack_costs,
    pack_paths,
    pack_segments,
    unpack,
    unpack_costs,
    unpack_paths,
    unpack_segments,
)
from pcs_racing.base.reading import read_limited

__all__ = [
    "Replay",
    "ReplayEvent",
    "plain_parts",
    "read_replay",
    "replay_page",
    "safe_json",
    "save_replay",
    "write_html",
]

FORMAT = "pcs-racing replay 1"

LONGEST_ITTC = 60.0

_LARGEST = 1e9
_LONGEST_TEXT = 500
_LARGEST_FILE = 100_000_000
_DATA = re.compile(r'<script type="application/json" id="replay">(.*?)</script>', re.DOTALL)


@dataclass(frozen=True)
class ReplayEvent:
    """Something that happened at one moment of a race.

    Attributes
    ----------
    time : float
        Seconds since the start.
    car : int
        0 or 1: whose event it is.
    kind : str
        ``"crash"``, ``"overtake"`` and ``"move"`` have signs of their own; any other word is allowed.
    text : str
        What to tell the viewer, such as ``"aggressiveness +"``.
    """

    time: float
    car: int
    kind: str
    text: str = ""


@dataclass(frozen=True, eq=False)
class Replay:
    """A race as it was driven: nothing but values, checked and copied when it is made; the arrays are read-only.

    Attributes
    ----------
    title, track_name : str
        Shown in the page's header.
    car_names : tuple of two str
        Names of the drivers.
    cars : ndarray, shape (T, 2, 7)
        States x, y, delta, v, psi, psi_dot, beta of both cars every ``frame_dt`` (m, rad, s).
    progress : ndarray, shape (T, 2)
        Cumulative arc length driven along the line in m; its difference is the lead.
    walls : ndarray, shape (S, 4)
        Wall segments x0, y0, x1, y1 in m. Where they close to loops, the track is filled between them.
    line : ndarray, shape (N, 2)
        The closed race line in m.
    line_speed : ndarray, shape (N,), optional
        Speed along it in m/s; colours it.
    frame_dt : float
        Seconds between two rows of ``cars``.
    ittc : ndarray, shape (T, 2), optional
        Smallest instantaneous time to collision of each car in s; infinite is allowed (stored as 60 s).
    plan_dt : float
        Seconds between two plans; plan k is made at ``k * plan_dt``.
    paths : ndarray, shape (K, 2, P, 4), optional
        The plan each car follows: points x, y (m), speed (m/s) and time (s, from the moment of the plan); rows after
        its last point are NaN.
    candidate_steps : ndarray of int, shape (J,), optional
        The plans whose candidates are kept, increasing; all of them if left out.
    candidates : ndarray, shape (J, 2, C, P', 2), optional
        Points x, y of every path that was considered; rows after its last point are NaN.
    costs : ndarray, shape (J, 2, C), optional
        Their costs; infinite for a rejected one. Goes with ``candidates``.
    events : tuple of ReplayEvent
        In any order; kept sorted by time.
    outcome : str
        How it ended, in words.
    half_sizes : ndarray, shape (2, 2)
        Half length and half width of each car in m.

    Raises
    ------
    InputError
        If a shape does not fit, a number is not finite where it must be, or a text is too long.
    """

    title: str
    track_name: str
    car_names: tuple[str, str]
    cars: np.ndarray
    progress: np.ndarray
    walls: np.ndarray
    line: np.ndarray
    line_speed: np.ndarray | None = None
    frame_dt: float = 0.05
    ittc: np.ndarray | None = None
    plan_dt: float = 0.1
    paths: np.ndarray | None = None
    candidate_steps: np.ndarray | None = None
    candidates: np.ndarray | None = None
    costs: np.ndarray | None = None
    events: tuple[ReplayEvent, ...] = ()
    outcome: str = ""
    half_sizes: np.ndarray | tuple[tuple[float, float], ...] = ((0.29, 0.155), (0.29, 0.155))

    def __post_init__(self) -> None:
        """Copy and check everything once, so that nothing else has to."""
        for name in ("title", "track_name", "outcome"):
            _check_text(getattr(self, name), name)
        if not isinstance(self.car_names, tuple | list) or len(self.car_names) != 2:
            raise InputError(f"car_names must be two names, got {self.car_names!r:.80}")
        for name in self.car_names:
            _check_text(name, "car_names")
        self._set("car_names", tuple(self.car_names))
        for name in ("frame_dt", "plan_dt"):
            self._set(name, float(check_number(name, getattr(self, name), 1e-4, 60.0)))

        self._set_array("cars", ("T", 2, 7), {})
        if len(self.cars) == 0:
            raise InputError("cars must hold at least one moment, got shape (0, 2, 7)")
        sizes = {"T": len(self.cars)}
        self._set_array("progress", ("T", 2), sizes)
        self._set_array("walls", ("S", 4), sizes)
        self._set_array("line", ("N", 2), sizes)
        if len(self.line) < 3:
            raise InputError(f"line must have at least three points, got shape {self.line.shape}")
        self._set_array("line_speed", ("N",), sizes)
        self._set_array("half_sizes", (2, 2), sizes)
        if not np.all((np.asarray(self.half_sizes) > 0.0) & (np.asarray(self.half_sizes) < 100.0)):
            raise InputError("half_sizes must be positive lengths in m")
        self._set_array("ittc", ("T", 2), sizes, allow="inf")
        self._set_array("paths", ("K", 2, "P", 4), sizes, allow="nan")
        self._set_array("candidates", ("J", 2, "C", "P'", 2), sizes, allow="nan")
        self._set_array("costs", ("J", 2, "C"), sizes, allow="inf")
        self._check_steps(sizes.get("K", 0), sizes.get("J", 0))
        self._set("events", _checked_events(self.events))

    @property
    def duration(self) -> float:
        """Time of the last frame in s."""
        return (len(self.cars) - 1) * self.frame_dt

    @property
    def lead(self) -> np.ndarray:
        """How far car 0 is ahead of car 1 in m, shape (T,)."""
        return np.asarray(self.progress[:, 0] - self.progress[:, 1])

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _set_array(self, name: str, shape: tuple[int | str, ...], sizes: dict[str, int], allow: str = "") -> None:
        """Replace a field by a read-only copy of the expected shape; letters take their sizes from ``sizes``."""
        if getattr(self, name) is None:
            return
        try:
            array = np.array(getattr(self, name), dtype=np.float64, order="C")
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{name} must be an array of numbers") from None
        wanted = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in shape)
        if array.ndim != len(wanted) or any(
            isinstance(w, int) and w != n for w, n in zip(wanted, array.shape, strict=True)
        ):
            raise InputError(f"{name} must have shape ({', '.join(map(str, wanted))}), got {array.shape}")
        sizes.update({letter: n for letter, n in zip(shape, array.shape, strict=True) if isinstance(letter, str)})
        known = array
        if allow == "nan":
            missing = np.asarray(np.isnan(array).any(axis=-1))
            if np.any(missing[..., :-1] & ~missing[..., 1:]):
                raise InputError(f"{name} may be NaN only after the last point of a path")
            known = array[~missing]
        elif allow == "inf":
            known = array[array != np.inf]
        if not np.all(np.abs(known) <= _LARGEST):
            raise InputError(f"{name} must be finite and at most {_LARGEST:.0e} in size")
        array.setflags(write=False)
        self._set(name, array)

    def _check_steps(self, plans: int, kept: int) -> None:
        """Candidates, their costs and their steps come together and belong to plans."""
        if (self.candidates is None) != (self.costs is None):
            raise InputError("candidates and costs go together: give both or neither")
        if self.candidates is None:
            if self.candidate_steps is not None:
                raise InputError("candidate_steps without candidates")
            return
        steps = np.arange(kept) if self.candidate_steps is None else np.array(self.candidate_steps)
        if steps.shape != (kept,) or (kept and not np.issubdtype(steps.dtype, np.integer)):
            raise InputError(f"candidate_steps must be {kept} whole numbers, one for each row of candidates")
        if kept and (steps[0] < 0 or steps[-1] >= plans or np.any(np.diff(steps) <= 0)):
            raise InputError(f"candidate_steps must increase and name plans from 0 to {plans - 1}")
        steps = steps.astype(np.int64)
        steps.setflags(write=False)
        self._set("candidate_steps", steps)


def save_replay(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write a race as a page (``.html``) or as bare JSON (``.json``); `read_replay` reads both.

    Numbers are rounded: to 1 mm, 1 mm/s, 1 mrad and 1 ms for cars, plans and line, to 1 cm for candidates and walls.

    Parameters
    ----------
    replay : Replay
    path : path
        Where to write; an existing file is replaced in one step.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the name ends differently or its folder does not exist.
    """
    path = Path(path)
    if path.suffix == ".html":
        return write_html(replay, path)
    if path.suffix != ".json":
        raise InputError(f"a replay is saved as .html or .json, got {path.name!r}")
    write_atomically(path, lambda file: file.write(safe_json(_to_values(replay)).encode()))
    return path


def write_html(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write the page that plays a race: one file, no network, opens from a disk.

    A link may name a moment: ``race.html#t=12.5&follow=1&candidates=1`` (``follow``: ``0``, ``1``, ``both`` or
    ``track``; also ``play=1``, ``speed=0.5``, ``plans=0``, ``zoom=2``, ``theme=dark``).

    Parameters
    ----------
    replay : Replay
    path : path
        Where to write; an existing file is replaced in one step.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    path = Path(path)
    page = replay_page(replay)
    write_atomically(path, lambda file: file.write(page.encode()))
    return path


def replay_page(replay: Replay) -> str:
    """Return the page that :func:`write_html` writes, to be put into another one."""
    template = files("pcs_racing.race").joinpath("replay.html").read_text(encoding="utf-8")
    parts = {"<!--title-->": html.escape(replay.title), "<!--replay-->": safe_json(_to_values(replay))}
    # In one pass: a title that spells a placeholder is not one.
    return re.sub("|".join(parts), lambda match: parts[match.group()], template)


def read_replay(path: str | os.PathLike[str]) -> Replay:
    """Read a race back from a page or from JSON. Nothing in the file is run, and all of it is checked.

    Parameters
    ----------
    path : path
        A file that `save_replay` wrote.

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        If there is no such file, or it does not hold a race.
    """
    path = Path(path)
    try:
        text = read_limited(path, _LARGEST_FILE, "a replay").decode("utf-8")
    except OSError as error:
        raise InputError(f"can't read the replay {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a replay: it is not UTF-8 text") from None
    if path.suffix != ".json":
        found = _DATA.search(text)
        if found is None:
            raise InputError(f"{path} holds no replay: a page written by save_replay was expected")
        text = found.group(1)
    try:
        return _from_values(json.loads(text))
    except InputError as error:
        raise InputError(f"{path} is not a replay: {error}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not a replay: its JSON is broken") from None


# Writing and reading JSON


def safe_json(values: Any) -> str:
    """Return JSON that may stand in a script element: without ``<``, ``>`` and ``&``, all ASCII."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plain_parts(replay: Replay) -> dict[str, Any]:
    """Return what a replay holds besides its arrays, as plain values."""
    return {
        "format": FORMAT,
        "title": replay.title,
        "track_name": replay.track_name,
        "car_names": list(replay.car_names),
        "outcome": replay.outcome,
        "frame_dt": replay.frame_dt,
        "plan_dt": replay.plan_dt,
        "half_sizes": np.asarray(replay.half_sizes).tolist(),
        "events": [[round(event.time, 3), event.car, event.kind, event.text] for event in replay.events],
    }


def _to_values(replay: Replay) -> dict[str, Any]:
    """Plain values; optional parts that are absent are left out."""
    values: dict[str, Any] = {
        **plain_parts(replay),
        "walls": pack_segments(replay.walls),
        "line": pack(replay.line, FINE, [0, 0]),
        "cars": pack(replay.cars, FINE, [0, 0]),
        "progress": pack(replay.progress, FINE, [0, 0]),
    }
    if replay.line_speed is not None:
        values["line_speed"] = pack(replay.line_speed, COARSE, [0])
    if replay.ittc is not None:
        values["ittc"] = pack(np.minimum(replay.ittc, LONGEST_ITTC), COARSE, [0])
    if replay.paths is not None:
        values["paths"] = pack_paths(replay.paths, FINE)
    if replay.candidates is not None and replay.costs is not None and replay.candidate_steps is not None:
        values["candidate_steps"] = pack(replay.candidate_steps, 1, [0])
        values["candidates"] = pack_paths(replay.candidates, COARSE)
        values["costs"] = pack_costs(replay.costs)
    return values


def _from_values(values: object) -> Replay:
    """The reverse of `_to_values`, for values of any origin."""
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"it must say format {FORMAT!r}")
    needed = {"format", "title", "track_name", "car_names", "outcome", "frame_dt", "plan_dt", "half_sizes", "events"}
    needed |= {"walls", "line", "cars", "progress"}
    optional = {"line_speed", "ittc", "paths", "candidate_steps", "candidates", "costs"}
    if not needed <= values.keys() <= needed | optional:
        missing, unknown = sorted(needed - values.keys()), sorted(values.keys() - needed - optional)
        raise InputError(f"missing parts {missing}, unknown parts {unknown!r:.100}")
    if not isinstance(values["events"], list) or not all(isinstance(e, list) and len(e) == 4 for e in values["events"]):
        raise InputError("events must be a list of [time, car, kind, text]")
    plain = ("title", "track_name", "car_names", "outcome", "frame_dt", "plan_dt", "half_sizes")
    arrays = ("line", "cars", "progress", "line_speed", "ittc")
    fields: dict[str, Any] = {name: values[name] for name in plain}
    fields |= {name: unpack(values[name], name) for name in arrays if name in values}
    fields |= {name: unpack_paths(values[name], name) for name in ("paths", "candidates") if name in values}
    if "candidate_steps" in values:
        fields["candidate_steps"] = unpack(values["candidate_steps"], "candidate_steps").astype(np.int64)
    if "costs" in values:
        fields["costs"] = unpack_costs(values["costs"], "costs")
    fields["walls"] = unpack_segments(values["walls"], "walls")
    fields["events"] = tuple(ReplayEvent(*event) for event in values["events"])
    return Replay(**fields)


# Small checks


def _check_text(value: object, name: str) -> None:
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
        raise InputError(f"{name} must be text of at most {_LONGEST_TEXT} characters, got {value!r:.80}")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(f"{name} must be text that UTF-8 can hold, got {value!a:.80}") from None


def _checked_events(events: object) -> tuple[ReplayEvent, ...]:
    if not isinstance(events, tuple | list) or not all(isinstance(event, ReplayEvent) for event in events):
        raise InputError("events must be a tuple of ReplayEvent")
    for event in events:
        check_number("the time of an event", event.time, 0.0, 1e6)
        check_whole("the car of an event", event.car, 0, 1)
        _check_text(event.kind, "the kind of an event")
        _check_text(event.text, "the text of an event")
    return tuple(sorted(events, key=lambda event: event.time))
