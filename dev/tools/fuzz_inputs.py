"""Broken inputs out of valid ones: changed bytes, words and structures; and values that are drawn
from bytes.
"""

import copy
import io
import json
import random
import struct
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
import yaml

MOST = 1_000_000  # bytes
WORDS = (
    *("0", "-0", "1", "-1", "0.5", "1e9", "1e999", "-1e999", "nan", ".nan", "inf", "-.inf"),
    *(
        "1e-320",
        "9" * 30,
        "9" * 400,
        "0x" + "f" * 40,
        "1_000",
        "1:59:59",
        "2024-02-31",
        "0o7",
        "65536",
    ),
    *("2147483648", "100000000000"),
    *(
        "",
        "null",
        "~",
        "true",
        "no",
        "[]",
        "{}",
        "[[]]",
        "{a: {b: c}}",
        "*a",
        "&a",
        "<<: *a",
        "&a [*a]",
        "!!binary",
    ),
    *(
        "!!set",
        "!!python/object/apply:os.system [ls]",
        "? ",
        "- ",
        ": ",
        "#",
        "\t",
        "\n",
        "\r\n",
        "\x00",
    ),
    *("\ufeff", "\u2028"),
    *(
        "'",
        '"',
        "\\",
        "../",
        "/dev/zero",
        "/etc/passwd",
        "[" * 60,
        ",",
        ";",
        "=",
        "paper",
        "lattice",
        "pace=",
        "../x",
    ),
)
ODD: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        2,
        3,
        255,
        10**9,
        -(10**9),
        2**31,
        2**63,
        2**64,
        -(2**63),
        10**30,
    ),
    *(0.0, 0.5, 1.0, -0.0, 1e-300, 1e300, float("nan"), float("inf"), -float("inf"), 0.1, 2.5),
    *(
        "",
        "a",
        "paper",
        "lattice",
        "nan",
        "0",
        "\x00",
        "../x",
        "/",
        "x" * 300,
        [],
        {},
        [1, 2],
        [[]],
        {"a": 1},
        {1: 2},
    ),
    *([None], ["a", "a"], [0.5, 1.0]),
)
# What a call in Python may be given beside what a file can hold.
OBJECTS = (
    *(
        b"",
        b"abc",
        (),
        (0.5, 1.0),
        1j,
        range(3),
        object,
        "\ud800",
        np.float32(0.5),
        np.int64(3),
        np.array(1.0),
    ),
    *(np.array([1, 2]), np.array([], np.float32), np.array(["x"]), np.array([None], object)),
)


def broken(rng: random.Random, seeds: list[bytes], kind: str) -> bytes:
    """Return one of the seeds, changed in a few places."""
    data = rng.choice(seeds)
    # Changed structures get past the parser, changed bytes test the parser itself.
    if kind in STRUCTURES and rng.random() < 0.5:
        load, dump = STRUCTURES[kind]
        # a structure that the format can't hold, or a seed that is broken already
        with suppress(Exception):
            data = dump(_changed(rng, load(data)))
        if rng.random() < 0.7:
            return data
    change = _bytes if kind in ("binary", "npz", "values") else _text
    for _ in range(_few(rng)):
        data = change(rng, data, seeds)[:MOST]  # lines that are repeated may be repeated again
    return data


def _few(rng: random.Random) -> int:
    return 1 + int(rng.expovariate(0.6))


def _bytes(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    at, size = rng.randrange(len(data) + 1), min(rng.choice((1, 1, 2, 4, 8, 16, 100)), len(data))
    number = rng.choice(
        (0, 1, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 10**5)
    )
    other = rng.choice(seeds)
    news = (
        data[:at] + rng.randbytes(size) + data[at + size :],
        data[:at] + data[at + size :],
        data[:at] + data[at : at + size] * rng.randrange(1, 20) + data[at:],
        data[:at] + number.to_bytes(4, rng.choice(("little", "big"))) + data[at + 4 :],
        data[:at] + other[rng.randrange(len(other) + 1) :],
        data[:at],
    )
    return rng.choice(news)


def _text(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    if rng.random() < 0.3:
        return _bytes(rng, data, seeds)
    # Bytes that are no UTF-8 must survive: they are among what is to be refused.
    text = data.decode("utf-8", "surrogateescape")
    spots = [i for i, letter in enumerate(text) if letter in " :,;=\n[]{}"] or [0]
    begin = rng.choice(spots) + rng.randrange(2)
    end = next((i for i in spots if i > begin), len(text))
    new = rng.choice((rng.choice(WORDS), text[begin:end] * rng.randrange(1, 6)))
    lines = text.splitlines(keepends=True) or [""]
    at = rng.randrange(len(lines))
    repeated = [*lines[:at], *[lines[at]] * rng.choice((0, 2, 30)), *lines[at + 1 :]]
    text = rng.choice(
        (text[:begin] + new + text[begin:], text[:begin] + new + text[end:], "".join(repeated))
    )
    return text.encode("utf-8", "surrogateescape")


def _places(value: Any) -> Iterable[tuple[Any, Any]]:
    """Every place in nested lists and mappings: the container and the key."""
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, item in list(pairs):
        yield value, key
        yield from _places(item)


def _changed(rng: random.Random, value: Any) -> Any:
    """Change a value of nested lists, mappings and arrays in a few places."""
    holder = [value]
    for _ in range(_few(rng)):
        container, key = rng.choice(list(_places(holder)))
        old, odd = container[key], copy.deepcopy(rng.choice(ODD))
        what = rng.randrange(4)
        if what == 0 and container is not holder:
            del container[key]
        elif (
            what == 1
            or not isinstance(old, dict | list | int | float | np.ndarray)
            or isinstance(old, bool)
        ):
            container[key] = odd
        elif isinstance(old, np.ndarray):
            container[key] = _array(rng, old)
        elif isinstance(old, dict):
            old[rng.choice(("a", 1, None, "seed", "extra", "..", ""))] = odd
        elif isinstance(old, list):
            container[key] = old * rng.choice((0, 1, 2, 20)) + [odd]
        else:
            container[key] = rng.choice(
                (-old, old + 1, old * 1000, old * 0.5, float(old), str(old), [old])
            )
    return holder[0]


def _array(rng: random.Random, array: Any) -> Any:
    """Another type or shape, or another number."""
    one = np.array(array)
    if one.size:
        numbers = (
            (np.nan, np.inf, -1, 10**6, 2**62) if one.dtype.kind == "f" else (-1, 0, 1, 100, 120)
        )
        one.flat[rng.randrange(one.size)] = rng.choice(numbers)
    kind = rng.choice((np.float32, np.int8, np.int64, np.uint64, np.bool_, np.float64))
    shape = rng.choice(((), (0,), (0, 2), (1, 1, 1), (3, 0, 2)))
    news = (
        one,
        one,
        array[:-1] if array.ndim else array[None],
        array.ravel(),
        array.T,
        array[..., None],
    )
    return rng.choice(
        (
            *news,
            np.repeat(array, 2, 0) if array.ndim else array,
            array.astype(kind),
            np.zeros(shape),
        )
    )


def _load_arrays(data: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(data)) as stored:
        return dict(stored)


def _dump_arrays(arrays: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numbers that do not fit another type
        np.savez(buffer, **{name: np.asarray(array) for name, array in arrays.items()})
    return buffer.getvalue()


def _load_table(data: bytes) -> list[list[str]]:
    mark = ";" if data.count(b";") > data.count(b",") else ","
    return [[mark], *(line.split(mark) for line in data.decode().splitlines())]


def _dump_table(rows: list[list[Any]]) -> bytes:
    # The first row is the separator, which changes like any other cell.
    (mark, *_), *lines = rows
    return "\n".join(mark.join(map(str, line)) for line in lines).encode()


STRUCTURES: dict[str, tuple[Callable[[bytes], Any], Callable[[Any], bytes]]] = {
    "yaml": (yaml.safe_load, lambda value: yaml.safe_dump(value, sort_keys=False).encode()),
    "json": (json.loads, lambda value: json.dumps(value).encode()),
    "csv": (_load_table, _dump_table),
    "npz": (_load_arrays, _dump_arrays),
}


class Draw:
    """Values out of bytes; when they are used up it goes on with zeros."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def byte(self) -> int:
        """The next byte."""
        self.at += 1
        return self.data[self.at - 1] if self.at <= len(self.data) else 0

    def number(self) -> float:
        """Any number of eight bytes, infinite ones included."""
        self.at += 8
        return float(struct.unpack("<d", self.data[self.at - 8 : self.at].ljust(8, b"\0"))[0])

    def choice(self, values: Any) -> Any:
        """One of some values."""
        return values[(self.byte() + 256 * self.byte()) % len(values)]

    def value(self, *likely: Any) -> Any:
        """One of the likely values, or an odd one."""
        kind = self.byte() % 8
        if kind < 3 and likely:
            return self.choice(likely)
        if kind == 3:
            return self.number()
        if kind == 4:
            return self.byte() - 128
        if kind == 5:
            return [self.choice(ODD + OBJECTS) for _ in range(self.byte() % 4)]
        if kind == 6:
            return self.data[self.at : self.at + self.byte() % 20].decode("latin-1")
        return self.choice(ODD + OBJECTS)

    def keywords(self, likely: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
        """Some of the arguments, and now and then one that does not exist."""
        chosen = {self.choice(list(likely)) for _ in range(1 + self.byte() % 4)}
        values = {name: self.value(*likely[name]) for name in sorted(chosen)}
        return values | ({"unknown": 1} if self.byte() == 255 else {})
