"""What hypothesis generates: structures with the names that valid inputs have, tables, arrays, and spliced bytes."""

import io
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import yaml
from fuzz_mutations import NUMBERS, ODD, WORDS
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

__all__ = ["strategy"]

TEXT = st.text(max_size=20) | st.sampled_from([*NUMBERS, *WORDS])
LEAF = st.none() | st.booleans() | st.integers() | st.floats() | TEXT | st.sampled_from(ODD)
VALUE = st.recursive(
    LEAF, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=3), max_leaves=8
)
ARRAY = arrays_of.arrays(
    st.sampled_from([np.bool_, np.int8, np.int32, np.int64, np.uint64, np.float32, np.float64, np.dtype("U3")]),
    arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


@cache
def strategy(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    """Return a strategy for inputs of a kind."""
    make = {"yaml": _nested, "json": _nested, "csv": _tables, "text": _texts, "npz": _arrays, "values": _values}
    chosen = make.get(kind, _spliced)
    return chosen(seeds, kind)


def _nested(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    """Mappings like the seeds, with other values somewhere in them."""
    load: Callable[[bytes], Any] = yaml.safe_load if kind == "yaml" else json.loads
    known = [load(seed) for seed in seeds]
    value = VALUE | st.sampled_from([leaf for base in known for leaf in _leaves(base)])  # right, but elsewhere

    @st.composite
    def changed(draw: st.DrawFn) -> bytes:
        base = _copy(draw(st.sampled_from(known)))
        for _ in range(draw(st.integers(1, 3))):
            place = base
            while True:  # go down, now and then
                inner = [value for value in _parts(place) if isinstance(value, dict | list)]
                if not inner or draw(st.integers(0, 2)) == 0:
                    break
                place = draw(st.sampled_from(inner))
            if isinstance(place, dict):
                names = [str(name) for name in place]
                place[draw(st.sampled_from(names) | TEXT if names else TEXT)] = _copy(draw(value))
            elif isinstance(place, list) and place:
                place[draw(st.integers(0, len(place) - 1))] = _copy(draw(value))
            else:
                base = _copy(draw(value))
                break
        if kind == "json":
            return json.dumps(base, default=str).encode("utf-8", "surrogatepass")
        return yaml.safe_dump(base, sort_keys=False).encode("utf-8", "surrogatepass")

    return changed()


def _parts(value: Any) -> list[Any]:
    return list(value.values()) if isinstance(value, dict) else list(value) if isinstance(value, list) else []


def _leaves(value: Any) -> list[Any]:
    parts = _parts(value)
    return [leaf for part in parts for leaf in _leaves(part)] if parts else [value]


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy(item) for key, item in value.items()}
    return [_copy(item) for item in value] if isinstance(value, list) else value


def _texts(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    words = sorted({part for seed in seeds for part in seed.decode().replace("=", " = ").replace(":", " : ").split()})
    parts = st.lists(st.sampled_from([*words, ":", "=", ","]) | TEXT, max_size=8)
    return parts.map(lambda found: "".join(found).encode("utf-8", "surrogatepass"))


def _tables(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    """Tables with a seed's first line, and its rows, some with another cell or mark."""
    cell = st.floats().map(str) | st.integers().map(str) | TEXT

    @st.composite
    def table(draw: st.DrawFn) -> bytes:
        known = draw(st.sampled_from(seeds)).decode().splitlines()
        mark = ";" if known[0].count(";") > known[0].count(",") else ","
        lines = known[:1]
        for line in known[1:][: draw(st.integers(0, 100))]:
            change = draw(st.integers(0, 15))
            row = line.split(mark)
            if change == 0:
                row[draw(st.integers(0, len(row) - 1))] = draw(cell)
            elif change == 1:
                row = draw(st.lists(cell, max_size=len(row) + 1))
            lines.append((draw(st.sampled_from(",;\t")) if change == 2 else mark).join(row))
        return "\n".join(lines).encode("utf-8", "surrogatepass")

    return table()


def _arrays(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    """Files of arrays under the seeds' names, one to three of them replaced."""
    known = []
    for seed in seeds:
        with np.load(io.BytesIO(seed)) as stored:
            known.append(dict(stored))

    @st.composite
    def packed(draw: st.DrawFn) -> bytes:
        arrays = dict(draw(st.sampled_from(known)))
        for _ in range(draw(st.integers(1, 3))):
            name = draw(st.sampled_from(sorted(arrays)) | st.sampled_from(["extra", "a/b", "0"]))
            old = arrays.get(name, np.zeros(2))
            how = draw(st.integers(0, 3))
            if how == 0:
                arrays[name] = draw(ARRAY)
            elif how == 1 and old.dtype.kind in "biuf" and old.size:  # of the right kind and shape, with other numbers
                new = arrays_of.arrays(old.dtype, draw(st.integers(1, min(3, old.size))))
                at = draw(st.integers(0, old.size - 1))
                arrays[name] = np.concatenate([old.flat[:at], draw(new), old.flat])[: old.size].reshape(old.shape)
            elif how == 2 and old.size:
                shape = draw(st.permutations(old.shape))
                arrays[name] = old.reshape(shape)
            else:
                arrays.pop(name, None)
            if not arrays:
                break
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        return buffer.getvalue()

    return packed()


def _values(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    return st.binary(max_size=120)


def _spliced(seeds: tuple[bytes, ...], kind: str) -> st.SearchStrategy[bytes]:
    """Bytes put into valid ones, at places that hypothesis chooses, or nothing but bytes."""

    @st.composite
    def spliced(draw: st.DrawFn) -> bytes:
        data = draw(st.sampled_from(seeds))
        for _ in range(draw(st.integers(1, 4))):
            at = draw(st.integers(0, len(data)))
            data = data[:at] + draw(st.binary(max_size=12)) + data[at + draw(st.integers(0, 12)) :]
        return data

    return spliced() | st.binary(max_size=300)
