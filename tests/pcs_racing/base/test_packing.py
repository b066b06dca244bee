import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused
from replay_pages import unpack

from pcs_racing.base.packing import join_segments, pack, pack_paths

arrays = hnp.arrays(
    float,
    hnp.array_shapes(min_dims=1, max_dims=4, min_side=0, max_side=6),
    elements=st.floats(-1e8, 1e8, allow_subnormal=False),
)


@given(arrays, st.sampled_from([1, 100, 1000]), st.data())
def test_numbers_come_back_to_within_half_a_step(values, per_unit, data):
    axes = data.draw(st.lists(st.integers(0, values.ndim - 1), max_size=4))
    packed = json.loads(json.dumps(pack(values, per_unit, axes)))
    back = unpack(packed)
    assert back.shape == values.shape
    assert np.all(np.abs(back - values) <= 0.5 / per_unit + 1e-7)
    assert pack(back, per_unit, axes) == packed  # rounding again changes nothing


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_numbers_without_a_step_are_refused(value):
    refused("finite", pack, np.array([1.0, value]), 1000)


def test_segments_join_to_loops_and_open_lines():
    square = np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]], float)
    lone = np.array([[5.0, 5.0, 6.0, 6.004]])
    loop, open_end = join_segments(np.vstack([square, lone]))
    assert loop.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert open_end.tolist() == [[5, 5], [6, 6]]
    assert join_segments(np.empty((0, 4))) == []


def test_the_last_point_of_a_path_repeats():
    paths = np.random.default_rng(1).uniform(-50, 50, (4, 2, 5, 3, 2))
    paths[0, 0, 1, 2:] = np.nan
    paths[3, 1, 4] = np.nan
    held = paths.copy()
    held[0, 0, 1, 2] = held[0, 0, 1, 1]
    held[3, 1, 4] = 0.0
    for shape in (paths.shape, (8, 5, 3, 2)):  # candidates, plans
        back = unpack(pack_paths(paths.reshape(shape)))
        np.testing.assert_allclose(back, held.reshape(shape), atol=0.005 + 1e-9)
