"""Broken inputs out of valid ones: bytes, lines, numbers, names and whole structures."""

import copy
import io
import json
import random
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import yaml

NUMBERS = (
    "0", "-0", "1", "-1", "0.5", "1e9", "1e999", "-1e999", "nan", ".nan", "inf", ".inf", "-.inf", "1e-320", "9" * 30, "9" * 400,
    "0x" + "f" * 40, "1_000", "1:59:59", "2024-02-31", "0o7", "1e5", "65536", "2147483648", "100000000000",
)  # fmt: skip
WORDS = (
    "", "null", "~", "true", "no", "[]", "{}", "[[]]", "{a: {b: c}}", "*a", "&a", "!!binary", "!!set", "? ", "- ", ": ", "#", "\t",
    "\n", "\r\n", "\x00", "\ufeff", "\u2028", "'", '"', "\\", "../", "/dev/zero", "<<: *a", "!!python/object/apply:os.system [ls]",
    "[" * 60, "&a [*a]", ",", ";", "paper", "lattice",
)  # fmt: skip
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 10**9, 10**30, -(2**63), 0.0, 0.5, 1e300, float("nan"), float("inf"), "", "a", "x" * 300,
    "../x", "nan", [], {}, [1, 2], [[]], {"a": 1}, {1: 2}, [None], ["a", "a"], [0.5, 1.0],
)  # fmt: skip


def mutations(rng: random.Random, seeds: list[bytes], kind: str, words: tuple[str, ...] = ()) -> bytes:
    """Return one of the seeds, changed in a few places."""
    data = rng.choice(seeds)
    structured = {"yaml": _yaml, "json": _json, "npz": _npz, "csv": _csv}.get(kind)
    if structured is not None and rng.random() < 0.5:
        try:
            data = structured(rng, data)
        except (ValueError, TypeError, yaml.YAMLError):
            pass
        if rng.random() < 0.7:
            return data
    for _ in range(1 + int(rng.expovariate(0.5))):
        data = (
            _bytes(rng, data, seeds, words) if kind in ("binary", "npz", "values") else _text(rng, data, seeds, words)
        )
    return data


def _bytes(rng: random.Random, data: bytes, seeds: list[bytes], words: tuple[str, ...]) -> bytes:
    what, at = rng.randrange(8), rng.randrange(len(data) + 1)
    size = min(rng.choice((1, 1, 2, 4, 8, 16, 100)), len(data))
    if what == 0:
        return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    if what == 1:
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :] if at < len(data) else data
    if what == 2:
        return data[:at] + data[at + size :]
    if what == 3:
        return data[:at] + data[at : at + size] * rng.randrange(1, 20) + data[at:]
    if what == 4:
        value = rng.choice((0, 1, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 10**5))
        return data[:at] + value.to_bytes(4, rng.choice(("little", "big"))) + data[at + 4 :]
    if what == 5:
        return data[:at] if rng.random() < 0.5 else data[at:]
    if what == 6:
        other = rng.choice(seeds)
        return data[:at] + other[rng.randrange(len(other) + 1) :]
    return data[:at] + rng.randbytes(size) + data[at + size :]


def _text(rng: random.Random, data: bytes, seeds: list[bytes], words: tuple[str, ...]) -> bytes:
    if rng.random() < 0.3:
        return _bytes(rng, data, seeds, words)
    text = data.decode("utf-8", "surrogateescape")
    spots = [i for i, letter in enumerate(text) if letter in " :,;=\n[]{}"] or [0]
    begin = rng.choice(spots) + rng.randrange(2)
    end = next((i for i in spots if i > begin), len(text))
    new = rng.choice((*NUMBERS, *WORDS, *words))
    what = rng.randrange(4)
    if what == 0:
        text = text[:begin] + new + text[begin:]
    elif what == 1:
        text = text[:begin] + new + text[end:]
    elif what == 2:
        lines = text.splitlines(keepends=True) or [""]
        i = rng.randrange(len(lines))
        lines[i : i + 1] = (
            [lines[i]] * rng.choice((0, 2, 2, 30)) if rng.random() < 0.7 else [rng.choice(lines), lines[i]]
        )
        text = "".join(lines)
    else:
        text = text[:begin] + text[begin:end] * rng.randrange(1, 6) + text[end:]
    return text.encode("utf-8", "surrogateescape")


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every place in nested lists and mappings: the container and the key."""
    pairs = (
        list(value.items()) if isinstance(value, dict) else list(enumerate(value)) if isinstance(value, list) else []
    )
    return [(value, key) for key, _ in pairs] + [place for _, item in pairs for place in _places(item)]


def _changed(rng: random.Random, value: Any) -> Any:
    """Change a value of nested lists and mappings in a few places."""
    holder = [value]
    for _ in range(1 + int(rng.expovariate(0.7))):
        container, key = rng.choice(_places(holder))
        what, old = rng.randrange(6), container[key]
        if what < 3:
            container[key] = copy.deepcopy(rng.choice(ODD))
        elif what == 3 and container is not holder:
            del container[key]
        elif what == 4 and isinstance(old, list):
            container[key] = old * rng.choice((0, 2, 20)) + [copy.deepcopy(rng.choice(ODD))]
        elif isinstance(old, dict):
            old[rng.choice(("a", 1, None, "seed", True))] = copy.deepcopy(rng.choice(ODD))
        elif isinstance(old, int | float) and not isinstance(old, bool):
            container[key] = rng.choice((-old, old + 1, old * 1000, old * 0.5, float(old), str(old)))
        else:
            container[key] = [old]
    return holder[0]


def _yaml(rng: random.Random, data: bytes) -> bytes:
    return yaml.safe_dump(_changed(rng, yaml.safe_load(data)), sort_keys=False).encode()


def _json(rng: random.Random, data: bytes) -> bytes:
    return json.dumps(_changed(rng, json.loads(data))).encode()


def _csv(rng: random.Random, data: bytes) -> bytes:
    mark = ";" if data.count(b";") > data.count(b",") else ","
    lines = [line.split(mark) for line in data.decode().splitlines()]
    for _ in range(1 + int(rng.expovariate(0.7))):
        line = rng.choice(lines)
        at = rng.randrange(len(line) + 1)
        line[at : at + rng.randrange(2)] = [rng.choice((*NUMBERS, *WORDS))] * rng.choice((0, 1, 1, 1, 3))
    return "\n".join(mark.join(line) for line in lines).encode()


def _npz(rng: random.Random, data: bytes) -> bytes:
    """Other arrays under the same names, and other names."""
    with np.load(io.BytesIO(data)) as stored:
        arrays = dict(stored)
    warnings.simplefilter("ignore")  # of numbers that do not fit another type
    for _ in range(1 + int(rng.expovariate(0.7))):
        name = rng.choice(list(arrays) or ["a"])
        array = arrays.get(name, np.zeros(2))
        changes: tuple[Callable[[], Any], ...] = (
            lambda: array.astype(rng.choice((np.float32, np.int8, np.int64, np.uint64, np.bool_, np.float64))),
            lambda: array[:-1] if array.ndim else array[None],
            lambda: np.concatenate([array, array]) if array.ndim else array,
            lambda: array.ravel(),
            lambda: array.T,
            lambda: array[..., None],
            lambda: np.zeros(rng.choice(((), (0,), (0, 2), (1, 1, 1), (3, 0, 2))), array.dtype),
            lambda: np.where(rng.random() < 2.0, array, array) * rng.choice((-1, 0, 1000)),
            lambda: _spoiled(rng, array),
            lambda: np.array(rng.choice(("a", 5, 1j, b"x"))),
        )
        what = rng.randrange(len(changes) + 2)
        if what < len(changes):
            try:
                arrays[name] = np.asarray(changes[what]())
            except (TypeError, ValueError, OverflowError):
                continue
        elif what == len(changes):
            arrays.pop(name, None)
        else:
            arrays[rng.choice(("extra", "a/b", "..", ""))] = array
    buffer = io.BytesIO()
    (np.savez if rng.random() < 0.8 else np.savez_compressed)(buffer, **arrays)
    return buffer.getvalue()


def _spoiled(rng: random.Random, array: Any) -> Any:
    """One number replaced."""
    out = np.array(array)
    if out.size:
        value = rng.choice(
            (np.nan, np.inf, -np.inf, -1, 10**6, 2**62) if out.dtype.kind == "f" else (-1, 0, 1, 100, 120)
        )
        out.flat[rng.randrange(out.size)] = value
    return out
