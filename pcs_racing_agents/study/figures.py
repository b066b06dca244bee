"""Picture of a study's table."""

from typing import Any

from pcs_racing_agents.base.style import COLOURS, INK, SOFT, new_figure, picture, short, tidy
from pcs_racing_agents.study.table import GAIN, Difference, StudyTable

PAPER = "#c22443"


@picture
def differences_picture(table: StudyTable) -> Any:
    """Draw the differences of each row in a panel: each agent from the base, and the gain."""
    tracks = list(dict.fromkeys(row.track for row in table.rows))
    opponents = list(dict.fromkeys(row.opponent for row in table.rows))
    # All panels share the lines of the whole table: an agent missing from a row leaves a gap.
    lines = [arm for arm in table.arms if arm != table.base]
    if any(row.gain is not None for row in table.rows):
        lines.append(GAIN)
    height = 0.55 + 0.21 * len(lines)
    figure = new_figure(2.0 + 2.3 * len(opponents), 0.7 + height * len(tracks))
    grid = figure.subplots(len(tracks), len(opponents), sharex=True, sharey=True, squeeze=False)
    # Not every track has every opponent: panels without a row stay empty.
    for axes in grid.ravel():
        axes.set_visible(False)
    for row in table.rows:
        axes = grid[tracks.index(row.track), opponents.index(row.opponent)]
        axes.set_visible(True)
        axes.set_title(
            f"{short(row.track, 16)}{'' if row.train else ' (test)'}, {short(row.opponent, 16)}",
            fontsize=8.5,
        )
        axes.axvline(0.0, color=INK, lw=0.8)
        for arm, difference in row.questions:
            colour = COLOURS[1] if arm in (table.best, GAIN) else COLOURS[0]
            _interval(axes, difference, -lines.index(arm), colour)
        # The paper has two agents: the base and the game-theoretic agent (our cfr-argmax).
        if row.paper is not None and "cfr-argmax" in lines:
            place = (row.paper.difference, -lines.index("cfr-argmax"))
            axes.plot(*place, "D", mfc="none", mec=PAPER, ms=5.0, mew=1.3, zorder=4)
        axes.set_yticks([-i for i in range(len(lines))], [short(name) for name in lines])
        axes.set_ylim(-len(lines) + 0.4, 0.6)
        axes.locator_params(axis="x", nbins=5)
        tidy(axes, "x")
    label = f"difference of score from {short(table.base)}, 95 % intervals"
    label += "; hollow: p (Holm) not below 0.05"
    if any(row.paper is not None for row in table.rows):
        label += "; diamonds: the paper's"
    figure.supxlabel(label, fontsize=8.5, color=SOFT)
    return figure


def _interval(axes: Any, difference: Difference, height: float, colour: str) -> None:
    """Draw a difference with its interval; hollow if it is not significant."""
    result = difference.result
    axes.plot([result.low, result.high], [height] * 2, color=colour, lw=2.0, solid_capstyle="butt")
    fill = colour if difference.p_holm < 0.05 else "white"
    axes.plot(result.difference, height, "o", ms=6, mec=colour, mew=1.4, mfc=fill, zorder=3)
