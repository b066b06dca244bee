"""Pictures of means with their intervals, a panel for each group."""

from collections.abc import Mapping
from pathlib import Path

from pcs_racing_agents.base.style import COLOURS, INK, new_figure, picture, save_picture, tidy

Interval = tuple[float, float, float]
"""Mean, low and high end."""


@picture
def draw_intervals(
    groups: Mapping[str, Mapping[str, Interval]], label: str, file: Path, columns: int = 3
) -> Path:
    """Draw the means of each group with their intervals; all groups have the same names.

    ``label``: label of the axis of the means.
    """
    rows, names = -(-len(groups) // columns), list(next(iter(groups.values())))
    figure = new_figure(3.2 * columns, rows * (0.8 + 0.24 * len(names)))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, (title, means) in zip(panels, groups.items(), strict=False):
        panel.axvline(0.0, color=INK, linewidth=0.8)
        for place, (mean, low, high) in enumerate(means.values()):
            panel.plot([low, high], [place] * 2, color=COLOURS[place % len(COLOURS)], linewidth=1.6)
            panel.plot(mean, place, "o", color=COLOURS[place % len(COLOURS)])
        panel.set(title=title, xlabel=label)
        panel.set_yticks(range(len(names)), names)
        tidy(panel, "x")
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    panels[0].invert_yaxis()
    return save_picture(figure, file)
