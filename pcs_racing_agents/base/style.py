"""Style of all pictures: colours for colour-blind readers, and reproducible bytes."""

import io
import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from pcs_racing.base.errors import require
from pcs_racing.base.files import write_atomically

INK, SOFT, EDGE = "#17202b", "#5c6877", "#dfe4ea"
CARS = ("#1b6fd8", "#e08700")
"""Colours of car 0 and car 1, as in replays."""
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7a5195",
    "#8c6d31",
    "#6b7480",
)
"""Colours of other items: the palette of Okabe and Ito (2008), then some more; grey comes last."""

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": "#a5afbb",
    "axes.labelcolor": SOFT,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.8,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "grid.color": EDGE,
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "text.parse_math": False,
    "svg.hashsalt": "pcs-racing",
    "svg.fonttype": "path",
}

P = ParamSpec("P")
T = TypeVar("T")


def picture(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function to draw in this style; without matplotlib it raises an error."""

    @wraps(draw)
    def styled(*arguments: P.args, **options: P.kwargs) -> T:
        require("matplotlib", extra="plots")
        from matplotlib import rc_context

        # For this drawing only: a user's own pictures keep their style.
        with rc_context(_STYLE):
            return draw(*arguments, **options)

    return styled


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure without a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    # Not by pyplot, which keeps every figure in memory and may ask for a screen.
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Any, grid: str = "both") -> None:
    """Draw a light grid (``"x"``, ``"y"``, ``"both"`` or ``""``) and no tick marks."""
    axes.tick_params(length=0)
    if grid:
        axes.grid(visible=True, axis=grid)


def short(name: str, longest: int = 26) -> str:
    """Return a name, cut to ``longest`` characters."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


@picture
def picture_bytes(figure: Any, kind: str = "svg") -> bytes:
    """Return a figure as ``"svg"`` or ``"png"``; the same figure gives the same bytes."""
    content = io.BytesIO()
    # Dates and versions in a file would make equal pictures differ.
    metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {"Software": None}
    figure.savefig(content, format=kind, dpi=150, metadata=metadata)
    return content.getvalue()


def save_picture(figure: Any, path: str | os.PathLike[str]) -> Path:
    """Write a figure to a file whose name ends in ``.svg`` or ``.png``."""
    target = Path(path)
    content = picture_bytes(figure, target.suffix.lstrip("."))
    write_atomically(target, content)
    return target
