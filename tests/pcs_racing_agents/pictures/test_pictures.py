import numpy as np
import pytest

from pcs_racing import InputError
from pcs_racing_agents.pictures.curves import Curve, curves_picture, write_tensorboard
from pcs_racing_agents.pictures.style import picture_bytes

X = np.arange(5.0)
FALLING = Curve(X, np.exp(-X), "training", error=np.full(5, 0.01))
SPARSE = Curve(X, np.array([1.0, np.nan, 0.5, np.nan, 0.0]), "validation")


def heights(axes, line: int) -> list[float]:
    return list(axes.lines[line].get_ydata())


def test_panels_show_what_is_known():
    figure = curves_picture({"loss": [FALLING, SPARSE], "share": [SPARSE]}, log=("loss",), mark=2.0, title="net")
    loss, share = figure.axes
    assert (loss.get_yscale(), share.get_yscale()) == ("log", "linear")
    assert {0.2, 0.5} <= set(np.round(loss.yaxis.get_majorticklocs(), 6))
    assert loss.yaxis.get_major_formatter()(0.25, 0) == "0.25"
    assert heights(loss, 1) == [1.0, 0.5]  # NaN is left out, and 0 where the axis is logarithmic
    assert heights(share, 0) == [1.0, 0.5, 0.0]
    assert [text.get_text() for text in loss.texts] == ["training", "validation"]
    assert list(loss.lines[-1].get_xdata()) == [2.0, 2.0]
    assert len(loss.collections) == 1  # the band of the standard error
    assert figure.get_suptitle() == "net"
    assert picture_bytes(figure, "png").startswith(b"\x89PNG")


@pytest.mark.parametrize("panels", [{}, {"loss": []}])
def test_nothing_to_draw_is_one_clear_error(panels):
    with pytest.raises(InputError, match="no learning curves"):
        curves_picture(panels)


def test_curves_for_tensorboard_replace_earlier_ones(tmp_path):
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    pytest.importorskip("torch")
    for last in (0.25, 0.125):
        runs = {"seed-0": [(0, {"loss/a": 0.5, "loss/b": np.nan}), (10, {"loss/a": last, "loss/b": 1.0})]}
        assert write_tensorboard(tmp_path / "curves", runs) == tmp_path / "curves"
    assert len(list((tmp_path / "curves" / "seed-0").glob("events.out.tfevents.*"))) == 1
    events = reader.EventAccumulator(str(tmp_path / "curves" / "seed-0")).Reload()
    assert [(event.step, event.value) for event in events.Scalars("loss/a")] == [(0, 0.5), (10, 0.125)]
    assert [event.step for event in events.Scalars("loss/b")] == [10]
