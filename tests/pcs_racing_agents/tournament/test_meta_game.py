"""Games whose solutions are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from pcs_racing import InputError
from pcs_racing_agents.tournament.round_robin import alpha_rank, excess, zero_sum_equilibrium

CYCLE = np.array([[0.5, 0.6, 0.3], [0.4, 0.5, 0.7], [0.7, 0.3, 0.5]])
LADDER = np.array([[0.5, 0.6, 0.7], [0.4, 0.5, 0.7], [0.3, 0.3, 0.5]])


def test_known_equilibria():
    scissors = zero_sum_equilibrium([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    assert scissors.value == pytest.approx(0.0)
    assert scissors.row == pytest.approx(np.full(3, 1 / 3))
    mixed = zero_sum_equilibrium([[3, 1], [0, 2]])
    assert mixed.value == pytest.approx(1.5)
    assert mixed.row == pytest.approx([0.5, 0.5])
    assert mixed.column == pytest.approx([0.25, 0.75])
    assert zero_sum_equilibrium([[2.0, 5.0, 1.5]]).value == pytest.approx(1.5)  # the column player chooses


@given(arrays(np.float64, array_shapes(min_dims=2, max_dims=2, max_side=6), elements=st.floats(-1, 1)))
def test_nobody_can_gain_from_an_equilibrium(payoffs):
    result = zero_sum_equilibrium(payoffs)
    for chances in (result.row, result.column):
        assert chances.min() >= 0.0
        assert chances.sum() == pytest.approx(1.0)
    assert result.exploitability == pytest.approx(0.0, abs=1e-6)
    assert result.row @ payoffs @ result.column == pytest.approx(result.value)


def test_the_scale_of_the_payoffs_does_not_matter():
    small, large = (zero_sum_equilibrium(scale * excess(CYCLE)) for scale in (1e-9, 1e9))
    assert small.row == pytest.approx(large.row)
    # By hand: the chances are as the other two's excess, 0.2 : 0.2 : 0.1.
    assert small.row == pytest.approx([0.4, 0.4, 0.2])


def test_excess_of_scores():
    scores = np.array([[np.nan, 0.5], [0.1, np.nan]])  # 40 % of the races paid nobody
    assert excess(scores) == pytest.approx(np.array([[0.0, 0.2], [-0.2, 0.0]]))
    assert np.isnan(scores[0, 0])


def test_alpha_rank_prefers_who_beats_all_and_keeps_cycles():
    pytest.importorskip("pyspiel")
    pytest.importorskip("networkx")
    assert alpha_rank(LADDER)[0] > 0.99
    assert alpha_rank(CYCLE) == pytest.approx(np.full(3, 1 / 3))
    assert alpha_rank(LADDER, tolerance=0.25) == pytest.approx([0.5, 0.5, 0.0], abs=0.01)


def test_alpha_rank_is_the_stationary_distribution_by_hand():
    """Two agents, a beats b: a is taken over with chance e, b with 1 - e."""
    pytest.importorskip("pyspiel")
    pytest.importorskip("networkx")
    assert alpha_rank([[0.5, 0.8], [0.2, 0.5]], epsilon=0.1) == pytest.approx([0.9, 0.1])


def test_a_missing_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setattr("pcs_racing.base.optional.find_spec", lambda name: None if name == "pyspiel" else object())
    with pytest.raises(ModuleNotFoundError, match=r"\[games\]") as error:
        alpha_rank(CYCLE)
    assert error.value.name == "pyspiel"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: zero_sum_equilibrium([]), r"shape \(0,\)"),
        (lambda: zero_sum_equilibrium([[1.0, np.nan]]), "row 0 against column 1 is nan"),
        (lambda: zero_sum_equilibrium([["a"]]), "must be a matrix of numbers"),
        (lambda: excess([[1.0, 2.0]]), "a square matrix"),
        (lambda: excess([[0.5, np.nan], [0.5, 0.5]]), "row 0 against column 1 is nan"),
        (lambda: alpha_rank([[0.5]]), "there is 1 agent"),
        (lambda: alpha_rank(CYCLE, epsilon=0.9), "epsilon is 0.9"),
        (lambda: alpha_rank(CYCLE, tolerance=-1.0), "tolerance is -1"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message) as error:
        call()
    assert "\n" not in str(error.value)
