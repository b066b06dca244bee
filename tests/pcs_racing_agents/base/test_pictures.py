import numpy as np

from pcs_racing_agents.base.curves import Curve, curves_picture
from pcs_racing_agents.base.style import picture_bytes

X = np.arange(5.0)
FALLING = Curve(X, np.exp(-X), "training", error=np.full(5, 0.01))
SPARSE = Curve(X, np.array([1.0, np.nan, 0.5, np.nan, 0.0]), "validation")


def heights(axes, line: int) -> list[float]:
    return list(axes.lines[line].get_ydata())


def test_panels_show_what_is_known():
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
