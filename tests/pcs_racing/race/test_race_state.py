import pickle

import numpy as np
import pytest
from same_arrays import assert_same

from pcs_racing.race.state import RaceState, concatenate, empty_state, take


@pytest.fixture
def state() -> RaceState:
    """Three races full of random numbers."""
    rng = np.random.default_rng(0)
    state = empty_state(3, 4)
    for array in state:
        array[...] = (
            rng.integers(0, 2, array.shape)
            if array.dtype.kind in "iu"
            else rng.normal(size=array.shape)
        )
    return state


def test_copies_parts_and_pickles_are_the_same_state_and_an_empty_one_is_zero(state):
    before = state.copy()
    copy = state.copy()
    for array in copy:
        array += np.ones(1, array.dtype)
    assert_same(state, before)
    assert_same(concatenate([take(state, [0]), take(state, [1, 2])]), state)
    assert_same(take(take(state, [2, 0, 1]), [1, 2, 0]), state)
    twice = take(state, [1, 1])
    assert twice.races == 2
    twice.cars[0] += 1.0
    assert not np.array_equal(twice.cars[0], twice.cars[1])
    assert_same(pickle.loads(pickle.dumps(state)), state)
    state = empty_state(3, 4)
    assert state.races == 3
    assert not state.crashed.any()
    for name, array in state._asdict().items():
        assert (array == (-1 if name == "leader" else 0)).all(), name
