"""Files of recorded races: JSON, and the one self-contained HTML page that plays a race.

The page (``replay.html`` beside this file) needs no network and no server. The race is the JSON inside it, so the page
is also the file that `read_replay` reads back.
"""

import html
import json
import os
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base import packing
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import parse_json, read_limited, write_atomically
from pcs_racing.race.replay import Replay, ReplayEvent

FORMAT = "pcs-racing replay 1"

LONGEST_ITTC = 60.0
"""Times to collision are stored up to this one, s."""

_LARGEST_FILE = 100_000_000
_PLAIN = ("title", "track_name", "outcome", "frame_dt", "plan_dt")
_DATA = re.compile(r'<script type="application/json" id="replay">(.*?)</script>', re.DOTALL)


def save_replay(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write a race as a page (``.html``) or as bare JSON (``.json``), in one step; `read_replay` reads both.

    Numbers are rounded: to 1 mm, 1 mm/s, 1 mrad and 1 ms for cars, plans and line, to 1 cm for candidates and walls.
    The page is one file, needs no network, and opens from a disk. A link may name a moment:
    ``race.html#t=12.5&follow=1&candidates=1`` (``follow``: ``0``, ``1``, ``both`` or ``track``; also ``play=1``,
    ``speed=0.5``, ``plans=0``, ``zoom=2``, ``theme=dark``).
    """
    path = Path(path)
    if path.suffix not in (".html", ".json"):
        raise InputError(f"a replay is saved as .html or .json, got {path.name!r}")
    content = replay_page(replay) if path.suffix == ".html" else safe_json(_to_values(replay))
    write_atomically(path, lambda file: file.write(content.encode()))
    return path


def replay_page(replay: Replay) -> str:
    """Return the page that :func:`save_replay` writes, to be put into another one."""
    template = files("pcs_racing.race").joinpath("replay.html").read_text(encoding="utf-8")
    parts = {"<!--title-->": html.escape(replay.title), "<!--replay-->": safe_json(_to_values(replay))}
    # In one pass: a title that spells a placeholder is not one.
    return re.sub("|".join(parts), lambda match: parts[match.group()], template)


def read_replay(path: str | os.PathLike[str]) -> Replay:
    """Read a race back from what `save_replay` wrote. Nothing in the file is run, and all of it is checked."""
    path = Path(path)
    try:
        text = read_limited(path, _LARGEST_FILE, "a replay", InputError).decode("utf-8")
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
    """Return JSON that may stand in a script element: without ``<``, ``>`` and ``&``, all ASCII."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plain_parts(replay: Replay) -> dict[str, Any]:
    """Return what a replay holds besides its arrays, as plain values."""
    return {
        "format": FORMAT,
        **{name: getattr(replay, name) for name in _PLAIN},
        "car_names": list(replay.car_names),
        "half_sizes": np.asarray(replay.half_sizes).tolist(),
        "events": [[round(event.time, 3), event.car, event.kind, event.text] for event in replay.events],
    }


def _to_values(replay: Replay) -> dict[str, Any]:
    """Plain values; optional parts that are absent are left out."""
    values: dict[str, Any] = {
        **plain_parts(replay),
        "walls": packing.pack_segments(replay.walls),
        "line": packing.pack(replay.line, packing.FINE, [0, 0]),
        "cars": packing.pack(replay.cars, packing.FINE, [0, 0]),
        "progress": packing.pack(replay.progress, packing.FINE, [0, 0]),
    }
    if replay.line_speed is not None:
        values["line_speed"] = packing.pack(replay.line_speed, packing.COARSE, [0])
    if replay.ittc is not None:
        values["ittc"] = packing.pack(np.minimum(replay.ittc, LONGEST_ITTC), packing.COARSE, [0])
    if replay.paths is not None:
        values["paths"] = packing.pack_paths(replay.paths, packing.FINE)
    if replay.candidates is not None and replay.costs is not None:
        values["candidates"] = packing.pack_paths(replay.candidates, packing.COARSE)
        values["costs"] = packing.pack_costs(replay.costs)
    return values


def _from_values(values: object) -> Replay:
    """The reverse of `_to_values`, for values of any origin."""
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"it must say format {FORMAT!r}")
    needed = {*_PLAIN, "format", "car_names", "half_sizes", "events", "walls", "line", "cars", "progress"}
    optional = {"line_speed", "ittc", "paths", "candidates", "costs"}
    if not needed <= values.keys() <= needed | optional:
        missing, unknown = sorted(needed - values.keys()), sorted(values.keys() - needed - optional)
        raise InputError(f"missing parts {missing}, unknown parts {unknown!r:.100}")
    if not isinstance(values["events"], list) or not all(isinstance(e, list) and len(e) == 4 for e in values["events"]):
        raise InputError("events must be a list of [time, car, kind, text]")
    if values["half_sizes"] is None:  # a replay that is made, not read, may leave it out
        raise InputError("half_sizes must be positive lengths in m")
    arrays = ("line", "cars", "progress", "line_speed", "ittc")
    fields: dict[str, Any] = {name: values[name] for name in (*_PLAIN, "car_names", "half_sizes")}
    fields |= {name: packing.unpack(values[name], name) for name in arrays if name in values}
    fields |= {name: packing.unpack_paths(values[name], name) for name in ("paths", "candidates") if name in values}
    if "costs" in values:
        fields["costs"] = packing.unpack_costs(values["costs"], "costs")
    fields["walls"] = packing.unpack_segments(values["walls"], "walls")
    fields["events"] = tuple(ReplayEvent(*event) for event in values["events"])
    return Replay(**fields)
