"""Pictures of the Policy Characteristic Space: explored policies, the archive, and its moves."""

from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import move_names, move_table
from pcs_racing_agents.base.style import COLOURS, new_figure, picture, short, tidy


def plane(archive: PolicyArchive) -> tuple[int, int]:
    """Return the characteristics of the x and y axis: second and first, as in the paper."""
    return min(1, len(archive.characteristics) - 1), 0


def draw_archive(axes: Any, archive: PolicyArchive) -> None:
    """Draw an archive's policies and all explored policies, in the characteristics' units.

    A colour bar shows the policies' crash rate, if known.
    """
    right, up = plane(archive)
    # Thousands of explored policies are pixels even in a vector picture, below the archive.
    explored = archive.explored_coordinates[:, [right, up]]
    axes.plot(*explored.T, ".", color="#c3ccd6", ms=3.2, mew=0.0, rasterized=True)
    policies = archive.coordinates[:, [right, up]]
    options: dict[str, Any] = {"s": 30, "zorder": 3, "linewidths": 0.5, "edgecolors": "white"}
    if archive.own_crash is None:
        axes.scatter(*policies.T, color=COLOURS[0], **options)
    else:
        shares = 100.0 * archive.own_crash
        dots = axes.scatter(*policies.T, c=shares, cmap="cividis", vmin=0.0, **options)
        bar = axes.figure.colorbar(dots, ax=axes, shrink=0.75, aspect=24, pad=0.02)
        bar.set_label("own crashes, % of races")
        bar.outline.set_visible(False)
        bar.ax.tick_params(length=0)
    kinds = get_characteristics(archive.characteristics)
    axes.set_xlabel(f"{kinds[right].name}, {kinds[right].unit}")
    axes.set_ylabel(f"{kinds[up].name}, {kinds[up].unit}")
    tidy(axes)
    axes.set_xlim(axis_limits(archive, right, 1.0))
    axes.set_ylim(axis_limits(archive, up, 1.0))


def axis_limits(archive: PolicyArchive, axis: int, reach: float) -> tuple[float, float]:
    """Return limits of an axis: the archive and most explored policies, without far outliers.

    ``reach``: max distance of explored policies from the archive, in ranges of the archive.
    """
    low, high = float(archive.nadir[axis]), float(archive.ideal[axis])
    size = max(high - low, 1e-9)
    explored = archive.explored_coordinates[:, axis]
    if len(explored):
        tails = np.quantile(explored, [0.02, 0.98]).tolist()
        low = max(min(low, tails[0]), low - reach * size)
        high = min(max(high, tails[1]), high + reach * size)
    return low - 0.08 * size, high + 0.08 * size


def draw_arrow(axes: Any, start: ArrayLike, end: ArrayLike, colour: str) -> None:
    """Draw an arrow between two points of a plane."""
    head = {"arrowstyle": "-|>,head_width=0.25,head_length=0.5", "mutation_scale": 10.0}
    arrow = {**head, "color": colour, "lw": 1.6, "shrinkA": 4.0, "shrinkB": 3.0}
    axes.annotate("", xy=np.asarray(end), xytext=np.asarray(start), arrowprops=arrow, zorder=4)


@picture
def archive_picture(archive: PolicyArchive, *, epsilon: float | tuple[float, ...] = 0.35) -> Any:
    """Draw an archive, and the moves of the policy in its middle.

    ``epsilon``: length of a move in normalised units.
    """
    start = archive.select("middle")
    figure = new_figure(7.2, 5.2)
    axes = figure.subplots()
    draw_archive(axes, archive)
    points = archive.coordinates[:, list(plane(archive))]
    ring = {"ms": 9, "mfc": "none", "mec": COLOURS[1], "mew": 1.6, "zorder": 5}
    ends = move_table(archive, epsilon)[start, :-1]
    axes.plot(*points[start], "o", **ring, label=f"policy {start}")
    # Moves to the same policy share an arrow.
    for target, colour in zip(dict.fromkeys(ends.tolist()), cycle(COLOURS[1:]), strict=False):
        named = zip(move_names(archive, epsilon)[:-1], ends, strict=True)
        moves = ", ".join(name for name, end in named if end == target)
        if target == start:
            axes.plot([], [], color="none", label=f"{moves}: no effect")
        else:
            draw_arrow(axes, points[start], points[target], colour)
            axes.plot([], [], color=colour, lw=1.6, label=moves)
    axes.legend(loc="lower left")
    title = f"{len(archive)} policies"
    if len(archive.explored_coordinates):
        title += f", grey: {len(archive.explored_coordinates)} explored"
    axes.set_title(f"Archive {short(archive.name)}, rules {archive.rules}: {title}")
    return figure
