"""Learning curves: as a picture, and for TensorBoard."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.style import (
    COLOURS,
    SOFT,
    new_figure,
    picture,
    short,
    spread_labels,
    tidy,
)

Floats = NDArray[np.float64]


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
    log: bool | Collection[str] = False,
    mark: float | None = None,
    title: str = "",
) -> Any:
    """Draw learning curves, one panel per title, with the names of the lines at their ends.

    ``log``: whether the y axes are logarithmic, or the names of the panels with logarithmic axes.
    ``mark``: x of a vertical line, for instance at the selected network.
    """
    if not panels or not all(panels.values()):
        raise InputError("there are no learning curves to draw; give at least one for each panel")
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    # This avoids a nearly empty row of panels.
    columns = 3 if len(panels) in (5, 6, 9) else min(4, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(2.9 * columns + 0.4, 2.3 * rows + 0.3)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, curves) in zip(grid.ravel(), panels.items(), strict=False):
        logarithmic = log if isinstance(log, bool) else name in log
        for i, curve in enumerate(curves):
            shown = _drawable(curve, logarithmic)
            colour = COLOURS[i % len(COLOURS)]
            axes.plot(curve.x[shown], curve.y[shown], color=colour, lw=1.4)
            if curve.error is not None:
                low, high = curve.y - curve.error, curve.y + curve.error
                axes.fill_between(
                    curve.x[shown], low[shown], high[shown], color=colour, alpha=0.2, lw=0
                )
        if logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        if mark is not None:
            axes.axvline(mark, color=SOFT, lw=0.9, ls=":")
        axes.set_title(short(name), fontsize=9)
        tidy(axes, "y")
        axes.minorticks_off()
        _name_ends(axes, curves, logarithmic)
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel(x_label)
    for axes in grid[:, 0]:
        axes.set_ylabel(y_label)
    if title:
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def _drawable(curve: Curve, log: bool) -> NDArray[np.bool_]:
    return np.isfinite(curve.y) & ((curve.y > 0.0) | (not log))


def _name_ends(axes: Any, curves: Sequence[Curve], log: bool) -> None:
    """Write the names of lines at their ends, apart from each other."""
    low, high = (np.log10(axes.get_ylim()) if log else np.array(axes.get_ylim())).tolist()
    ends = []
    for i, curve in enumerate(curves):
        shown = np.flatnonzero(_drawable(curve, log))
        if len(shown):
            value = float(curve.y[shown[-1]])
            ends.append((i, float(np.log10(value)) if log else value))
    heights = spread_labels([(end - low) / (high - low) for _, end in ends], 0.1)
    for (i, _), height in zip(ends, heights, strict=True):
        axes.annotate(
            curves[i].label,
            (1.0, height),
            xycoords="axes fraction",
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            color=COLOURS[i % len(COLOURS)],
        )


def write_tensorboard(
    folder: Path, runs: Mapping[str, Iterable[tuple[int, Mapping[str, float]]]]
) -> Path:
    """Write curves for ``tensorboard --logdir FOLDER``; replace earlier curves of the same runs.

    Each run, in the folder of its name, has steps with values by tag; NaN is left out.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'curves for TensorBoard need torch and tensorboard: pip install "pcs-racing[learning]"'
        ) from None
    for name, steps in runs.items():
        # TensorBoard shows all events of a folder as one curve: events of an earlier run would mix
        # with it.
        for old in (folder / name).glob("events.out.tfevents.*"):
            old.unlink()
        with SummaryWriter(str(folder / name)) as writer:
            for step, values in steps:
                for tag, value in values.items():
                    if not np.isnan(value):
                        writer.add_scalar(tag, value, step)
    return folder
