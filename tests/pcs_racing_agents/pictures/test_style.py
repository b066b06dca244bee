from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing_agents.pictures.style import new_figure, place_labels, spread_labels


@given(st.lists(st.floats(-5.0, 5.0), max_size=12), st.floats(0.01, 2.0))
def test_labels_move_apart_and_keep_their_order(wanted, gap):
    places = spread_labels(wanted, gap)
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    moved = [places[i] for i in order]
    assert all(b - a >= gap - 1e-9 for a, b in pairwise(moved))
    if all(wanted[b] - wanted[a] >= gap for a, b in pairwise(order)):
        assert places == pytest.approx(wanted)


def test_names_stand_beside_their_points_and_cover_neither_points_nor_each_other():
    pytest.importorskip("matplotlib")
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    axes.set(xlim=(0.0, 10.0), ylim=(0.0, 10.0))
    place_labels(axes, [], [], [])
    assert not axes.texts
    crowd, lone, avoided = [(5.0 + 0.1 * k, 5.0) for k in range(6)], (1.0, 9.8), (5.3, 5.4)
    names = [f"point {k}" for k in range(7)]
    place_labels(axes, [*crowd, lone], names, [f"C{k}" for k in range(7)], avoid=[avoided])
    assert [text.get_text() for text in axes.texts] == names
    scale = 72.0 / figure.dpi
    left, low, right, high = (scale * axes.get_window_extent().get_points()).ravel()
    # A letter is 5.4 points wide, a line 10 high.
    boxes = [(x, y - 5.0, x + 5.4 * 7, y + 5.0) for x, y in (text.xyann for text in axes.texts)]
    marks = scale * axes.transData.transform([*crowd, lone, avoided])
    boxes += [(x - 4.0, y - 4.0, x + 4.0, y + 4.0) for x, y in marks]
    for one, other in combinations(range(len(boxes)), 2):
        (x0, y0, x1, y1), (u0, v0, u1, v1) = boxes[one], boxes[other]
        assert min(one, other) >= 7 or not (x0 < u1 and u0 < x1 and y0 < v1 and v0 < y1), (one, other)
    for text, box, mark in zip(axes.texts, boxes, marks, strict=False):
        assert left <= box[0] < box[2] <= right
        assert low <= box[1] < box[3] <= high
        away = np.hypot(max(box[0] - mark[0], mark[0] - box[2], 0.0), max(box[1] - mark[1], mark[1] - box[3], 0.0))
        assert away < 60.0
        assert (text.arrow_patch is None) == (away < 10.0)
