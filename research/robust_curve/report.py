"""The curve of gain against loss as text, as a file and as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcs_racing_agents.pictures.style import COLOURS, SOFT, new_figure, picture, tidy
from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.text_table import aligned, interval_text
from research.robust_curve.curve import CurvePoint

HEAD = ("p", "gain", "95 % interval", "loss", "95 % interval", "races", "networks")
COLUMNS = ("pool_share", "gain", "gain_low", "gain_high", "loss", "loss_low", "loss_high", "races", "networks")
NOTE = """p: share of the training games against the pool, the others against learned adversaries; gain: score against
the pool minus that of {baseline} in the same races; loss: to a best reply that was learned against the agent"""


def curve_text(points: Sequence[CurvePoint], baseline: str) -> str:
    """Return the table of a curve, with the meaning of its columns."""
    rows = [
        (
            f"{point.pool_share:g}",
            f"{point.gain.mean:+.3f}",
            interval_text(point.gain.low, point.gain.high),
            f"{point.loss.mean:+.3f}",
            interval_text(point.loss.low, point.loss.high),
            str(point.gain.units),
            str(len(point.networks.networks)),
        )
        for point in points
    ]
    return "\n".join([*aligned([HEAD, *rows]), "", NOTE.format(baseline=baseline)])


def write_curve(points: Sequence[CurvePoint], path: Path) -> Path:
    """Write a line for each share as CSV."""
    lines: list[tuple[object, ...]] = [COLUMNS]
    for point in points:
        numbers = (point.pool_share, *point.gain[:3], *point.loss[:3])
        lines.append((*(f"{value:.6g}" for value in numbers), point.gain.units, len(point.networks.networks)))
    return write_csv(lines, path)


@picture
def curve_picture(points: Sequence[CurvePoint], baseline: str) -> Any:
    """Draw the gain over the loss, with the intervals of both; each point is named by its share p."""
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    along = sorted(points, key=lambda point: point.pool_share)
    axes.plot([point.loss.mean for point in along], [point.gain.mean for point in along], color=SOFT, lw=0.9, zorder=1)
    for number, point in enumerate(along):
        x, y = point.loss.mean, point.gain.mean
        axes.plot([point.loss.low, point.loss.high], [y, y], color=COLOURS[0], lw=1.2)
        axes.plot([x, x], [point.gain.low, point.gain.high], color=COLOURS[0], lw=1.2)
        axes.plot(x, y, "o", color=COLOURS[0], ms=6)
        # Neighbours have their labels on different sides: points of large shares often lie close together.
        where = {"xytext": (7, -13)} if number % 2 == 0 else {"xytext": (-7, 7), "ha": "right"}
        axes.annotate(f"p = {point.pool_share:g}", (x, y), textcoords="offset points", fontsize=8.5, **where)
    axes.axhline(0.0, color=SOFT, lw=0.7)
    axes.axvline(0.0, color=SOFT, lw=0.7)
    axes.set_xlabel("loss to a learned best reply, races won; left: harder to exploit")
    axes.set_ylabel(f"gain over {baseline} against the pool, races won")
    axes.set_title("lines: 95 % intervals")
    tidy(axes)
    return figure
