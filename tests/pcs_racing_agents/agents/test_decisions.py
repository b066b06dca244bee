import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pcs_racing import UnknownNameError
from pcs_racing_agents.agents.from_network import DECISIONS, argmax, get_decision, regret_matching, softmax

VALUES = arrays(np.float32, (5, 4), elements=st.floats(-100.0, 100.0, width=32))


@given(VALUES)
@pytest.mark.parametrize("name", DECISIONS)
def test_chances_are_chances(name, values):
    chances = get_decision(name)(values)
    assert (chances >= 0.0).all()
    np.testing.assert_allclose(chances.sum(axis=1), 1.0, atol=1e-12)
    best = np.argmax(values, axis=1)
    np.testing.assert_allclose(chances[np.arange(5), best], chances.max(axis=1), atol=1e-6)


def test_what_each_rule_does():
    # Of equal values argmax takes the first; where no regret is positive, regret matching takes the highest.
    values = np.array([[1.0, 3.0, -2.0, 0.0], [-3.0, -1.0, -1.0, -9.0]])
    np.testing.assert_array_equal(argmax(values), [[0, 1, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_allclose(regret_matching(values), [[0.25, 0.75, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_allclose(softmax(np.log([[1.0, 2.0, 5.0, 2.0]])), [[0.1, 0.2, 0.5, 0.2]])
    with pytest.raises(UnknownNameError, match="'best' is unknown"):
        get_decision("best")
