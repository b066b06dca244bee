from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing_agents.pictures.style import spread_labels


@given(st.lists(st.floats(-5.0, 5.0), max_size=12), st.floats(0.01, 2.0))
def test_labels_move_apart_and_keep_their_order(wanted, gap):
    places = spread_labels(wanted, gap)
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    moved = [places[i] for i in order]
    assert all(b - a >= gap - 1e-9 for a, b in pairwise(moved))
    if all(wanted[b] - wanted[a] >= gap for a, b in pairwise(order)):
        assert places == pytest.approx(wanted)
