import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing_agents.networks import Rows, join_rows
from pcs_racing_agents.networks.rows import pair_number, split_by_pair


def rows(count=12, pairs=4, seed=0, **changes) -> Rows:
    rng = np.random.default_rng(seed)
    values = {
        "observations": rng.normal(size=(count, 5)),
        "targets": rng.normal(size=(count, 3)),
        "weights": rng.uniform(0.5, 2.0, count),
        "pair": np.arange(count) % pairs,
        "step": np.arange(count) % 2,
    }
    return Rows(**{**values, **changes})


def test_rows_are_compact_and_impossible_ones_one_clear_error():
    made = rows()
    assert (made.observations.dtype, made.targets.dtype, made.weights.dtype) == (
        np.float32,
        np.float32,
        np.float64,
    )
    assert len(made) == 12
    for changes, message in [
        ({"targets": np.zeros((0, 3))}, r"targets have shape \(0, 3\)"),
        ({"targets": np.zeros(12)}, r"targets have shape \(12,\)"),
        ({"observations": np.zeros((11, 5))}, r"observations have shape \(11, 5\)"),
        ({"observations": np.full((12, 5), "a")}, "observations have shape"),
        (
            {"targets": np.where(np.arange(36).reshape(12, 3) == 13, np.nan, 1.0)},
            r"targets .* row 4",
        ),
        ({"observations": np.full((12, 5), np.inf)}, r"observations .* row 0"),
        ({"weights": np.zeros(12)}, "some must be above 0"),
        ({"weights": np.linspace(-1.0, 1.0, 12)}, "weights lie in -1 to 1"),
        ({"pair": np.zeros(12)}, "type float64"),
    ]:
        refused(message, rows, **changes)


def test_rows_can_be_taken_joined_and_split_by_pair():
    made = rows()
    part = made.take([3, 1])
    np.testing.assert_array_equal(part.targets, made.targets[[3, 1]])
    again = join_rows([made.take(np.arange(12) < 5), made.take(np.arange(12) >= 5)])
    for key in ("observations", "targets", "weights", "pair", "step"):
        np.testing.assert_array_equal(getattr(again, key), getattr(made, key))
    refused("no rows to join", join_rows, [])
    refused("one starting pair", split_by_pair, rows(pairs=1), 0.2, 0)
    refused("weights of 0", split_by_pair, rows(pairs=2, weights=np.arange(12) % 2 + 0.0), 0.5, 0)


@given(st.integers(0, 200), st.integers(0, 200), st.integers(0, 200), st.integers(0, 200))
def test_pair_numbers_are_those_of_unordered_pairs(a, b, c, d):
    same = {a, b} == {c, d} and sorted((a, b)) == sorted((c, d))
    assert (pair_number([a, b]) == pair_number([c, d])) == same
    assert pair_number([[a, b], [c, d]]).tolist() == [pair_number([a, b]), pair_number([c, d])]


@given(st.integers(2, 30), st.floats(0.01, 0.9), st.integers(0, 1000))
def test_no_pair_is_on_both_sides_of_the_split(pairs, share, seed):
    made = rows(count=90, pairs=pairs)
    held_out, chosen = split_by_pair(made, share, seed)
    assert not set(made.pair[held_out]) & set(made.pair[~held_out])
    assert set(made.pair[held_out]) == set(chosen.tolist())
    assert 1 <= len(chosen) <= pairs - 1
    assert abs(len(chosen) - share * pairs) <= 1.0
    np.testing.assert_array_equal(split_by_pair(made, share, seed)[0], held_out)
