from itertools import combinations

import numpy as np
import pytest
from refusal import refused

from pcs_racing_agents.base.curves import Curve, curves_picture
from pcs_racing_agents.base.style import new_figure, picture_bytes, place_labels

X = np.arange(5.0)
FALLING = Curve(X, np.exp(-X), "training", error=np.full(5, 0.01))
SPARSE = Curve(X, np.array([1.0, np.nan, 0.5, np.nan, 0.0]), "validation")


def heights(axes, line: int) -> list[float]:
    return list(axes.lines[line].get_ydata())


def test_panels_show_what_is_known_and_nothing_to_draw_is_one_clear_error():
    figure = curves_picture(
        {"loss": [FALLING, SPARSE], "share": [SPARSE]}, log=("loss",), mark=2.0, title="net"
    )
    loss, share = figure.axes
    assert (loss.get_yscale(), share.get_yscale()) == ("log", "linear")
    assert {0.2, 0.5} <= set(np.round(loss.yaxis.get_majorticklocs(), 6))
    assert loss.yaxis.get_major_formatter()(0.25, 0) == "0.25"
    assert heights(loss, 1) == [1.0, 0.5]  # NaN is left out, and 0 where the axis is logarithmic
    assert heights(share, 0) == [1.0, 0.5, 0.0]
    labels = [text.get_text() for text in loss.get_legend().get_texts()]
    assert labels == ["training", "validation"]
    assert list(loss.lines[-1].get_xdata()) == [2.0, 2.0]
    assert len(loss.collections) == 1  # the band of the standard error
    assert figure.get_suptitle() == "net"
    assert picture_bytes(figure, "png").startswith(b"\x89PNG")
    for panels in [{}, {"loss": []}]:
        refused("no learning curves", curves_picture, panels)


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
        assert min(one, other) >= 7 or not (x0 < u1 and u0 < x1 and y0 < v1 and v0 < y1), (
            one,
            other,
        )
    for text, box, mark in zip(axes.texts, boxes, marks, strict=False):
        assert left <= box[0] < box[2] <= right
        assert low <= box[1] < box[3] <= high
        away = np.hypot(
            max(box[0] - mark[0], mark[0] - box[2], 0.0),
            max(box[1] - mark[1], mark[1] - box[3], 0.0),
        )
        assert away < 60.0
        assert (text.arrow_patch is None) == (away < 10.0)
