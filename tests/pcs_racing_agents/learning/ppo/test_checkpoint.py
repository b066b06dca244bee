from typing import NamedTuple

import numpy as np
import pytest

from pcs_racing import InputError
from pcs_racing_agents.learning.ppo.checkpoint import pack, unpack


class Pair(NamedTuple):
    a: object
    b: object


def state(x=0.0):
    generator = np.random.default_rng(3).bit_generator.state  # a dict with numbers of 128 bits
    return Pair([np.full((2, 3), x), (np.arange(2), None)], {"rng": dict(generator), "names": ["a", x]})


def test_what_is_taken_apart_comes_together_again():
    arrays = pack(state(1.5))
    assert all(isinstance(array, np.ndarray) and array.dtype != object for array in arrays.values())
    result = unpack(arrays, state())
    assert isinstance(result, Pair)
    np.testing.assert_array_equal(result.a[0], np.full((2, 3), 1.5))
    assert isinstance(result.a[1], tuple)
    assert result.a[1][1] is None
    assert result.b == state(1.5).b


def test_only_where_it_fits():
    with pytest.raises(InputError, match=r"a\.0 "):
        unpack(pack(state()), state()._replace(a=[np.zeros((3, 3)), (np.arange(2), None)]))
    with pytest.raises(InputError, match=r"b\.names\.1 "):
        unpack(pack(state()), state()._replace(b={**state().b, "names": ["a"]}))
    with pytest.raises(InputError, match="of a learner"):
        unpack({"a": np.zeros(2)}, state())
