"""Pictures of the Policy Characteristic Space: explored policies, the archive, and its moves."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import move_names, move_table
from pcs_racing_agents.base.style import (
    COLOURS,
    SOFT,
    new_figure,
    picture,
    short,
    tidy,
)

Floats = NDArray[np.float64]


def plane(archive: PolicyArchive) -> tuple[int, int]:
    """Return the characteristics of the x and y axis: second and first, as in the paper."""
    return min(1, len(archive.characteristics) - 1), 0


def in_units(archive: PolicyArchive, normalised: ArrayLike) -> Floats:
    """Return points in the characteristics' units, shape (..., G), from normalised coordinates."""
    return archive.nadir + np.asarray(normalised, np.float64) * (archive.ideal - archive.nadir)


def draw_archive(axes: Any, archive: PolicyArchive, *, faint: bool = False) -> None:
    """Draw an archive's policies and all explored policies, in the characteristics' units.

    A colour bar shows the policies' crash rate, if known. ``faint``: True draws all policies grey,
    as a background.
    """
    right, up = plane(archive)
    everything, policies = archive.explored_coordinates, archive.coordinates
    if len(everything):
        axes.plot(
            everything[:, right],
            everything[:, up],
            ".",
            color="#c3ccd6",
            ms=3.2,
            mew=0.0,
            rasterized=True,
        )
    # Thousands of explored policies are pixels even in a vector picture, below the archive.
    options: dict[str, Any] = {"s": 30, "zorder": 3, "linewidths": 0.5, "edgecolors": "white"}
    if faint or archive.own_crash is None:
        axes.scatter(
            policies[:, right], policies[:, up], color="#8b97a5" if faint else COLOURS[0], **options
        )
    else:
        shares = 100.0 * archive.own_crash
        dots = axes.scatter(
            policies[:, right], policies[:, up], c=shares, cmap="cividis", vmin=0.0, **options
        )
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


def draw_arrow(axes: Any, start: ArrayLike, end: ArrayLike, colour: str, **options: Any) -> None:
    """Draw an arrow between two points of a plane."""
    style = {
        "arrowstyle": "-|>,head_width=0.25,head_length=0.5",
        "color": colour,
        "lw": 1.6,
        "shrinkA": 4.0,
    }
    arrow = {**style, "shrinkB": 3.0, "mutation_scale": 10.0, **options}
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
    right, up = plane(archive)
    points = archive.coordinates
    point = points[start, [right, up]]
    axes.plot(*point, "o", ms=9, mfc="none", mec=COLOURS[1], mew=1.6, zorder=5)
    leads_to = move_table(archive, epsilon)[start]
    ineffective: list[str] = []
    # Moves to the same policy share an arrow.
    for i, target in enumerate(dict.fromkeys(leads_to.tolist())):
        names = [
            name
            for name, end in zip(move_names(archive, epsilon), leads_to, strict=True)
            if end == target
        ]
        if target == start:
            ineffective = names
            continue
        colour = COLOURS[1:][i % len(COLOURS[1:])]
        draw_arrow(axes, point, points[target, [right, up]], colour)
        axes.plot([], [], color=colour, lw=1.6, label=", ".join(names))
    axes.legend(loc="lower left")
    title = f"{len(archive)} policies"
    if len(archive.explored_coordinates):
        title += f", grey: {len(archive.explored_coordinates)} explored"
    axes.set_title(f"Archive {short(archive.name)}, preset {archive.preset}: {title}")
    text = f"arrows: moves of policy {start}"
    if ineffective:
        text += f"; {', '.join(ineffective)} keep{'s' if len(ineffective) == 1 else ''} it"
    axes.text(
        1.0, 1.0, text, transform=axes.transAxes, ha="right", va="top", color=SOFT, fontsize=8.5
    )
    return figure
