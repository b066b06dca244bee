"""Recorded race as a value, and its files: JSON, or a self-contained HTML page that plays it."""

import html
import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base import packing
from pcs_racing.base.checks import check_number, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import parse_json, read_limited, write_atomically
from pcs_racing.race.state import MAX_CARS

_MAX_NUMBER = 1e9
_MAX_TEXT = 500


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
    """Recorded race: plain values, checked and copied at creation; the arrays are read-only."""

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
    #: shape (N,): Speed along the line in m/s; colours the line.
    line_speed: np.ndarray | None = None
    frame_dt: float = 0.05  #: Seconds between two rows of ``cars``.
    #: shape (T, C): Minimum instantaneous time to collision of each car in s; infinity is allowed
    #: (stored as 60 s).
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
    events: tuple[ReplayEvent, ...] = ()  #: Events in any order; stored in order of time.
    outcome: str = ""  #: Outcome in words.
    #: shape (C, 2): Half length and half width of each car in m; F1TENTH's by default.
    half_sizes: np.ndarray | tuple[tuple[float, float], ...] | None = None
    #: shape (T, M, H, 2): Corners x, y of the moving obstacles in m, in order; a corner may repeat.
    moving: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Copy and check all fields once, so that no other code has to check them."""
        for name in ("title", "track_name", "outcome"):
            _check_text(getattr(self, name), name)
        if not isinstance(self.car_names, tuple | list) or not 1 <= len(self.car_names) <= MAX_CARS:
            raise InputError(f"car_names must be 1 to {MAX_CARS} names, got {self.car_names!r:.80}")
        count = len(self.car_names)
        for name in self.car_names:
            _check_text(name, "car_names")
        self._set("car_names", tuple(self.car_names))
        for name in ("frame_dt", "plan_dt"):
            self._set(name, float(check_number(name, getattr(self, name), 1e-4, 60.0)))

        sizes: dict[str, int] = {}
        self._set_array("cars", ("T", count, 7), sizes)
        if len(self.cars) == 0:
            raise InputError("cars must hold at least one moment, got none")
        self._set_array("progress", ("T", count), sizes)
        self._set_array("walls", ("S", 4), sizes)
        self._set_array("line", ("N", 2), sizes)
        if len(self.line) < 3:
            raise InputError(f"line must have at least three points, got shape {self.line.shape}")
        self._set_array("line_speed", ("N",), sizes)
        if self.half_sizes is None:
            self._set("half_sizes", ((0.29, 0.155),) * count)
        self._set_array("half_sizes", (count, 2), sizes)
        if not np.all((np.asarray(self.half_sizes) > 0.0) & (np.asarray(self.half_sizes) < 100.0)):
            raise InputError("half_sizes must be positive lengths in m")
        self._set_array("moving", ("T", "M", "H", 2), sizes)
        self._set_array("ittc", ("T", count), sizes, allow="inf")
        self._set_array("paths", ("K", count, "P", 4), sizes, allow="nan")
        self._set_array("candidates", ("K", count, "Q", "P'", 2), sizes, allow="nan")
        self._set_array("costs", ("K", count, "Q"), sizes, allow="inf")
        if (self.candidates is None) != (self.costs is None):
            raise InputError("candidates and costs go together: give both or neither")
        self._set("events", _checked_events(self.events, count))

    @property
    def duration(self) -> float:
        """Time of the last frame in s."""
        return (len(self.cars) - 1) * self.frame_dt

    @property
    def lead(self) -> np.ndarray:
        """Lead of car 0 over the first of the other cars in m, shape (T,); 0 if alone."""
        rivals = self.progress[:, 1:] if len(self.car_names) > 1 else self.progress
        return np.asarray(self.progress[:, 0] - rivals.max(axis=1))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _set_array(
        self, name: str, shape: tuple[int | str, ...], sizes: dict[str, int], allow: str = ""
    ) -> None:
        """Replace a field by a read-only copy of the expected shape; letters take their sizes from
        ``sizes``.
        """
        if getattr(self, name) is None:
            return
        try:
            array = np.array(getattr(self, name), dtype=np.float64, order="C")
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{name} must be an array of numbers") from None
        # The first array with a letter decides its size; all later arrays must agree.
        wanted = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in shape)
        if array.ndim != len(wanted) or any(
            isinstance(w, int) and w != n for w, n in zip(wanted, array.shape, strict=True)
        ):
            raise InputError(
                f"{name} must have shape ({', '.join(map(str, wanted))}), got {array.shape}"
            )
        sizes |= {key: n for key, n in zip(shape, array.shape, strict=True) if type(key) is str}
        known = array
        if allow == "nan":
            missing = np.asarray(np.isnan(array).any(axis=-1))
            if np.any(missing[..., :-1] & ~missing[..., 1:]):
                raise InputError(f"{name} may be NaN only after the last point of a path")
            known = array[~missing]
        elif allow == "inf":
            known = array[array != np.inf]
        if not np.all(np.abs(known) <= _MAX_NUMBER):
            raise InputError(f"{name} must be finite and at most {_MAX_NUMBER:.0e} in size")
        array.setflags(write=False)
        self._set(name, array)


def _check_text(value: object, name: str) -> None:
    if not isinstance(value, str) or len(value) > _MAX_TEXT:
        raise InputError(
            f"{name} must be text of at most {_MAX_TEXT} characters, got {value!r:.80}"
        )
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(f"{name} must be text that UTF-8 can hold, got {value!a:.80}") from None


def _checked_events(events: object, cars: int) -> tuple[ReplayEvent, ...]:
    if not isinstance(events, tuple | list) or not all(
        isinstance(event, ReplayEvent) for event in events
    ):
        raise InputError("events must be a tuple of ReplayEvent")
    for event in events:
        check_number("the time of an event", event.time, 0.0, 1e6)
        check_whole("the car of an event", event.car, 0, cars - 1)
        _check_text(event.kind, "the kind of an event")
        _check_text(event.text, "the text of an event")
    return tuple(sorted(events, key=lambda event: event.time))


FORMAT = "pcs-racing replay 2"

MAX_ITTC = 60.0
"""Maximum stored time to collision, s."""

_MAX_BYTES = 100_000_000
_PLAIN = ("title", "track_name", "outcome", "frame_dt", "plan_dt")
_OPTIONAL = {"line_speed", "ittc", "paths", "candidates", "costs", "moving"}
_DATA = re.compile(r'<script type="application/json" id="replay">(.*?)</script>', re.DOTALL)


def save_replay(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write a race as a page (``.html``) or as bare JSON (``.json``), in one step; `read_replay`
    reads both.

    Numbers are rounded: to 1 mm, 1 mm/s, 1 mrad and 1 ms for cars, plans and line, to 1 cm for
    candidates and walls. The page is one file, needs no network, and opens from a disk. A link may
    name a moment: ``race.html#t=12.5&follow=1&candidates=1`` (``follow``: ``0``, ``1``, ``both`` or
    ``track``; also ``play=1``, ``speed=0.5``, ``plans=0``, ``zoom=2``, ``theme=dark``).
    """
    path = Path(path)
    if path.suffix not in (".html", ".json"):
        raise InputError(f"a replay is saved as .html or .json, got {path.name!r}")
    content = replay_page(replay) if path.suffix == ".html" else safe_json(_to_values(replay))
    write_atomically(path, content)
    return path


def replay_page(replay: Replay) -> str:
    """Return the page that :func:`save_replay` writes, for use inside another page."""
    template = files("pcs_racing.race").joinpath("replay.html").read_text(encoding="utf-8")
    parts = {
        "<!--title-->": html.escape(replay.title),
        "<!--replay-->": safe_json(_to_values(replay)),
    }
    # In one pass: a title that looks like a placeholder is not replaced.
    return re.sub("|".join(parts), lambda match: parts[match.group()], template)


def read_replay(path: str | os.PathLike[str]) -> Replay:
    """Read a race from a file of `save_replay`. Nothing in the file is run, all is checked."""
    path = Path(path)
    try:
        text = read_limited(path, _MAX_BYTES, "a replay", InputError).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a replay: it is not UTF-8 text") from None
    if path.suffix != ".json":
        found = _DATA.search(text)
        if found is None:
            raise InputError(f"{path} holds no replay: a page written by save_replay was expected")
        text = found.group(1)
    try:
        return _from_values(parse_json(path, text))
    except InputError as error:
        raise InputError(f"{path} is not a replay: {error}") from None


# Writing and reading JSON


def safe_json(values: Any) -> str:
    """Return JSON that is safe in a script element: no ``<``, ``>`` and ``&``, all ASCII."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plain_parts(replay: Replay) -> dict[str, Any]:
    """Return the contents of a replay except its arrays, as plain values."""
    return {
        "format": FORMAT,
        **{name: getattr(replay, name) for name in _PLAIN},
        "car_names": list(replay.car_names),
        "half_sizes": np.asarray(replay.half_sizes).tolist(),
        "events": [
            [round(event.time, 3), event.car, event.kind, event.text] for event in replay.events
        ],
    }


def _pack_smooth(values: np.ndarray) -> dict[str, Any]:
    return packing.pack(values, packing.FINE, [0, 0])


def _pack_drawn(values: np.ndarray) -> dict[str, Any]:
    return packing.pack(values, packing.COARSE, [0])


# For each array: how it is packed and unpacked.
_ARRAYS: dict[str, tuple[Callable[..., Any], Callable[..., np.ndarray]]] = {
    "walls": (packing.pack_segments, packing.unpack_segments),
    "line": (_pack_smooth, packing.unpack),
    "cars": (_pack_smooth, packing.unpack),
    "progress": (_pack_smooth, packing.unpack),
    "line_speed": (_pack_drawn, packing.unpack),
    "moving": (_pack_smooth, packing.unpack),
    "ittc": (lambda ittc: _pack_drawn(np.minimum(ittc, MAX_ITTC)), packing.unpack),
    "paths": (lambda paths: packing.pack_paths(paths, packing.FINE), packing.unpack_paths),
    "candidates": (lambda paths: packing.pack_paths(paths, packing.COARSE), packing.unpack_paths),
    "costs": (packing.pack_costs, packing.unpack_costs),
}


def _to_values(replay: Replay) -> dict[str, Any]:
    """Return a replay as plain values; absent optional parts are left out."""
    arrays = {name: getattr(replay, name) for name in _ARRAYS}
    packed = {name: _ARRAYS[name][0](array) for name, array in arrays.items() if array is not None}
    return plain_parts(replay) | packed


def _from_values(values: object) -> Replay:
    """Return the replay of values as of `_to_values`; the values may have any origin."""
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"it must say format {FORMAT!r}")
    known = {"format", *(field.name for field in fields(Replay))}
    odd = (values.keys() ^ known) - (_OPTIONAL - values.keys())
    if odd:
        raise InputError(f"missing or unknown parts {sorted(odd)!r:.100}")
    parts = {name: value for name, value in values.items() if name != "format"}
    for name in parts.keys() & _ARRAYS.keys():
        parts[name] = _ARRAYS[name][1](parts[name], name)
    try:
        parts["events"] = tuple(ReplayEvent(*event) for event in parts["events"])
    except TypeError:
        raise InputError("events must be a list of [time, car, kind, text]") from None
    return Replay(**parts)
