import base64
import json
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused

from pcs_racing.base import packing

arrays = hnp.arrays(
    float,
    hnp.array_shapes(min_dims=1, max_dims=4, min_side=0, max_side=6),
    elements=st.floats(-1e8, 1e8, allow_subnormal=False),
)


@given(arrays, st.sampled_from([1, 100, 1000]), st.data())
def test_numbers_come_back_to_within_half_a_step(values, per_unit, data):
    axes = data.draw(st.lists(st.integers(0, values.ndim - 1), max_size=4))
    packed = json.loads(json.dumps(packing.pack(values, per_unit, axes)))
    back = packing.unpack(packed)
    assert back.shape == values.shape
    assert np.all(np.abs(back - values) <= 0.5 / per_unit + 1e-7)
    assert packing.pack(back, per_unit, axes) == packed  # what has been rounded stays as it is


def deflated(text):
    return base64.b64encode(zlib.compress(text.encode())).decode()


BROKEN = {
    "shape": ([3], [-2], [True, "2"], [10**9, 10**9], [10**5, 10**5], "2", [1] * 7),
    "per_unit": (0, float("nan"), "1000"),
    "differences": ([1], [-1], [0] * 9),
    "data": (
        *("A", "A<", "Aé", "A\ud800", base64.b64encode(b"[1,2]").decode(), None),
        *map(deflated, ("[1]", "[1,2,3]", '["a,b"]', "[1,2.5]", f"[1,{2**60}]", "0," * 10**6)),
    ),
    "more": (1,),
}


@pytest.mark.parametrize("part", BROKEN)
def test_broken_parts_are_refused(part):
    for value in BROKEN[part]:
        packed = packing.pack(np.array([1.0, 2.0]), 1)
        refused(r"speed", packing.unpack, packed | {part: value}, "speed")


def test_a_bomb_is_unpacked_no_further_than_its_shape():
    bomb = packing.pack(np.array([1.0, 2.0]), 1) | {"data": deflated("[" + "0," * 10**7)}
    tracemalloc.start()
    refused("speed", packing.unpack, bomb, "speed")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000  # bytes


def test_numbers_without_a_step_and_wrong_counts_are_refused():
    for value in [np.nan, np.inf, -np.inf, 1e300]:
        refused("finite", packing.pack, np.array([1.0, value]), 1000)
    for unpack_them, points, counts in [
        (packing.unpack_segments, np.zeros((4, 3)), [4]),
        (packing.unpack_segments, np.zeros((4, 2)), [3]),
        (packing.unpack_segments, np.zeros((4, 2)), [3, 1]),
        (packing.unpack_paths, np.zeros((2, 3, 4, 2)), [1, 1, 1]),
    ]:
        packed = {"points": packing.pack(points, 1), "counts": packing.pack(np.array(counts), 1)}
        refused("walls", unpack_them, packed, "walls")


def test_segments_join_to_loops_and_paths_may_differ_in_length():
    square = np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]], float)
    lone = np.array([[5.0, 5.0, 6.0, 6.0]])
    loop, open_end = packing.join_segments(np.vstack([square, lone]))
    assert loop.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert open_end.tolist() == [[5, 5], [6, 6]]
    paths = np.random.default_rng(1).uniform(-50, 50, (4, 2, 5, 3, 2))
    paths[0, 0, 1, 2:] = np.nan
    paths[3, 1, 4] = np.nan
    back = packing.unpack_paths(packing.pack_paths(paths, 100), "candidates")
    assert np.array_equal(np.isnan(back), np.isnan(paths))
    assert np.nanmax(np.abs(back - paths)) <= 0.005 + 1e-9


@given(
    hnp.arrays(
        float,
        st.tuples(st.integers(0, 30), st.just(4)),
        elements=st.sampled_from([0.0, 0.5, 1.0, 1.5]),
    )
)
def test_segments_come_back_in_some_order(segments):
    packed = packing.pack_segments(segments)
    back = packing.unpack_segments(packed, "walls")
    assert sorted(map(tuple, back)) == sorted(map(tuple, segments))
    assert packing.pack_segments(back) == packed


@given(
    hnp.arrays(float, (2, 3), elements=st.floats(-1e6, 1e6) | st.just(np.inf) | st.floats(0, 1e-3))
)
def test_costs_keep_their_order_and_their_rejections(costs):
    back = packing.unpack_costs(json.loads(json.dumps(packing.pack_costs(costs))), "costs")
    assert np.array_equal(np.isinf(back), np.isinf(costs))
    finite = np.isfinite(costs)
    assert np.all(np.diff(back[finite][np.argsort(costs[finite], kind="stable")]) >= 0)
    assert np.all(np.abs(back[finite] - costs[finite]) <= 0.0005 + 1e-9)
