"""Learned characteristics in words: what they are made of, and how well they are estimated."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.game.characteristics import get_characteristics
from pcs_racing_agents.base.style import COLOURS, EDGE, new_figure, picture, tidy
from pcs_racing_agents.base.tables import aligned, write_csv
from studies.axes.coordinates import COORDINATES
from studies.axes.learn import JUDGED, Learning
from studies.axes.learned import LearnedAxis, LearnedCharacteristics
from studies.axes.validation import Accuracy

MOST_WORDS = 6
"""Terms of an axis that its sentence names; tables and files hold all."""


def learning_text(learning: Learning) -> str:
    """Return the table of R2, the sentence of every axis, and what the inputs mean."""
    plane = learning.coordinates
    several = learning.behaviour.shape[0] > 1
    circuits = " on held-out circuits" if several else ""
    parts = [
        *aligned(score_rows(learning.scores)),
        "",
        f"R2 of held-out policies{circuits} (cross-validated), from so many segments;",
        "+-: standard error over policies.",
        f"Cyclic plane: strength {plane.strength:.2f}; noise alone reaches {plane.noise:.2f}.",
    ]
    if plane.strength <= plane.noise:
        parts.append("The plane is no stronger than noise: this pool holds no cycle that could be learned.")
    return "\n".join([*parts, "", learned_text(learning.characteristics)])


def learned_text(learned: LearnedCharacteristics) -> str:
    """Return what every axis is made of."""
    kinds = {kind.name: kind for kind in get_characteristics([item.name for item in learned.inputs])}
    lines = [axis_words(axis) for axis in learned.axes]
    lines += ["", "Each input counts in standard deviations from its mean:"]
    for item in learned.inputs:
        kind = kinds[item.name]
        lines.append(f"  {item.name}: mean {item.mean:.3g}, sd {item.scale:.3g} {kind.unit} ({kind.meaning})")
    return "\n".join(lines)


def axis_words(axis: LearnedAxis) -> str:
    """Return a sentence that names the largest terms of an axis with their weights."""
    ranked = sorted(axis.weights, key=lambda pair: -abs(pair[1]))
    shown = [f"{weight:+.2f} {term}" for term, weight in ranked[:MOST_WORDS]]
    rest = len(ranked) - len(shown)
    more = f", and {rest} smaller {'term' if rest == 1 else 'terms'}" if rest else ""
    return f"{axis.name} ({axis.meaning}): {axis.intercept:+.2f} {' '.join(shown)}{more}"


def score_rows(scores: Mapping[int, Accuracy]) -> list[tuple[str, ...]]:
    """Return rows of a table: R2 of each coordinate by number of segments."""
    rows: list[tuple[str, ...]] = [("segments", *(f"R2 {name}" for name in COORDINATES))]
    for count, score in sorted(scores.items()):
        cells = (f"{r2:+.2f} +- {error:.2f}" for r2, error in zip(score.r2, score.error, strict=True))
        rows.append((str(count), *cells))
    return rows


def write_weights(learned: LearnedCharacteristics, path: Path) -> Path:
    """Write all weights as CSV, a line for each axis and term."""
    rows: list[tuple[object, ...]] = [("axis", "term", "weight")]
    for axis in learned.axes:
        rows += [(axis.name, "1", axis.intercept), *((axis.name, term, weight) for term, weight in axis.weights)]
    return write_csv(rows, path)


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
