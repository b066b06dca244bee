"""Pictures of a tournament: payoff matrix and ratings."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing_agents.base.style import COLOURS, EDGE, INK, new_figure, picture, short, tidy
from pcs_racing_agents.tournament.ratings import Ratings


@picture
def payoffs_picture(names: Sequence[str], payoffs: ArrayLike) -> Any:
    """Draw the score matrix as a heat map; purple above one half, orange below.

    ``payoffs`` (array_like, shape (N, N)): score of the row's agent against the column's agent; NaN
    for pairs without races.
    """
    matrix = np.asarray(payoffs, np.float64)
    labels = [short(name) for name in names]
    size = 0.58 * len(names)
    figure = new_figure(size + 2.0, size + 1.4)
    axes = figure.subplots()
    image = axes.imshow(matrix, cmap="PuOr", vmin=-0.15, vmax=1.15)
    axes.set_xticks(range(len(names)), labels, rotation=40, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(names)), labels)
    for (i, j), value in np.ndenumerate(matrix):
        if not np.isnan(value):
            # Perceived lightness of the cell (ITU-R BT.601): white digits on dark cells.
            dark = image.cmap(image.norm(value))[:3] @ np.array([0.299, 0.587, 0.114]) < 0.5
            axes.text(
                j,
                i,
                f"{value:.2f}",
                ha="center",
                va="center",
                fontsize=8,
                color="white" if dark else INK,
            )
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("score of the row's agent against the column's")
    return figure


@picture
def ratings_picture(ratings: Ratings) -> Any:
    """Draw the ratings with their intervals, best on top, on the scale of chess."""
    order = np.argsort(-ratings.strength, kind="stable")
    values, low, high = ratings.elo
    figure = new_figure(7.2, 0.9 + 0.3 * len(order))
    axes = figure.subplots()
    axes.axvline(0.0, color=EDGE, lw=1.0)
    for rank, i in enumerate(order):
        if np.isfinite(low[i]):
            axes.plot(
                [low[i], high[i]], [-rank] * 2, color=COLOURS[0], lw=2.0, solid_capstyle="butt"
            )
        axes.plot(values[i], -rank, "o", color=COLOURS[0], ms=6)
    axes.set_yticks([-rank for rank in range(len(order))], [short(ratings.names[i]) for i in order])
    axes.set_ylim(-len(order) + 0.4, 0.6)
    axes.set_xlabel("rating (Bradley-Terry; 400 are odds of ten to one; mean 0)")
    tidy(axes, "x")
    return figure
