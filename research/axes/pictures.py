"""Pictures of learned characteristics: their weights, and estimates against the coordinates in the payoffs."""

from typing import Any

import numpy as np

from pcs_racing_agents.pictures.style import COLOURS, EDGE, new_figure, picture, tidy
from research.axes.coordinates import COORDINATES
from research.axes.learn import JUDGED, Learning

MOST_BARS = 10


@picture
def learning_picture(learning: Learning) -> Any:
    """Draw, for each axis, its largest weights, and its estimates of left-out policies against their coordinates.

    Estimates come from fits that used neither the policy nor the circuit; colours show the first input.
    """
    axes = learning.characteristics.axes
    first = learning.characteristics.inputs[0].name
    behaviour = np.nanmean(learning.behaviour[..., 0], axis=(0, 2))
    figure = new_figure(4.2 * len(axes), 7.0)
    above, below = figure.subplots(2, len(axes), squeeze=False)
    for c, axis in enumerate(axes):
        ranked = sorted(axis.weights, key=lambda pair: -abs(pair[1]))[:MOST_BARS]
        bars = above[c]
        bars.barh(range(len(ranked)), [w for _, w in ranked], color=[COLOURS[int(w < 0.0)] for _, w in ranked])
        bars.set_yticks(range(len(ranked)), [term for term, _ in ranked], fontsize=7.5)
        bars.invert_yaxis()
        bars.axvline(0.0, color=EDGE, lw=1.0)
        bars.set_title(axis.name)
        bars.set_xlabel("weight, for inputs in standard deviations")
        tidy(bars, "x")
        dots = below[c]
        truth, estimate = learning.coordinates.standard[:, c], learning.estimates[:, c]
        ends = [min(truth.min(), estimate.min()), max(truth.max(), estimate.max())]
        dots.plot(ends, ends, "--", color=EDGE, lw=1.0)
        points = dots.scatter(truth, estimate, c=behaviour, cmap="viridis", s=34, edgecolors=EDGE, zorder=3)
        dots.set_xlabel(f"{COORDINATES[c]} in the payoffs, sd")
        dots.set_ylabel(f"estimate from {max(JUDGED)} segments, left out")
        dots.set_title(
            f"R2 from {', '.join(map(str, JUDGED))} segments: "
            + ", ".join(f"{learning.scores[count].r2[c]:.2f}" for count in JUDGED)
        )
        tidy(dots, "both")
    figure.colorbar(points, ax=list(below), shrink=0.9, label=first)
    return figure
