"""Learning curves as a picture."""

from collections.abc import Collection, Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.typing import Floats
from pcs_racing_agents.base.style import COLOURS, SOFT, new_figure, picture, short, tidy


class Curve(NamedTuple):
    """Learning curve."""

    x: Floats  #: shape (E,): ``x``, ``y``: Points of the curve; NaN without a measurement.
    y: Floats
    label: str  #: Name of the line.
    error: Floats | None = None  #: shape (E,): Standard errors of ``y``, drawn as a band.


@picture
def curves_picture(
    panels: Mapping[str, Sequence[Curve]],
    *,
    x_label: str = "epoch",
    y_label: str = "",
    log: Collection[str] = (),
    mark: float | None = None,
    title: str = "",
) -> Any:
    """Draw learning curves, one panel per title.

    ``log``: names of the panels with a logarithmic y axis. ``mark``: x of a vertical line, for
    instance at the selected network.
    """
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(2.9 * columns + 0.4, 2.3 * rows + 0.3)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, curves) in zip(grid.ravel(), panels.items(), strict=False):
        for curve, colour in zip(curves, cycle(COLOURS), strict=False):
            shown = np.isfinite(curve.y) & ((curve.y > 0.0) | (name not in log))
            x, y = curve.x[shown], curve.y[shown]
            axes.plot(x, y, color=colour, lw=1.4, label=curve.label)
            if curve.error is not None:
                error = curve.error[shown]
                axes.fill_between(x, y - error, y + error, color=colour, alpha=0.2, lw=0)
        if name in log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        if mark is not None:
            axes.axvline(mark, color=SOFT, lw=0.9, ls=":")
        axes.set_title(short(name), fontsize=9)
        tidy(axes, "y")
        axes.minorticks_off()
        axes.legend(fontsize=8)
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    figure.supxlabel(x_label, fontsize=9, color=SOFT)
    figure.supylabel(y_label, fontsize=9, color=SOFT)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure
