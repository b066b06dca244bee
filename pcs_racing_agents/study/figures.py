"""Pictures of a study's report."""

from collections.abc import Sequence
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.style import COLOURS, INK, SOFT, new_figure, picture, short, tidy
from pcs_racing_agents.study.table import StudyTable, TableRow

PAPER = "#c22443"


@picture
def scores_picture(table: StudyTable) -> Any:
    """Draw each agent's score with its interval and the paper's win rates, one panel per row."""
    figure, panels = _grid(table)
    names = table.arms
    for row, axes in panels:
        heights = {arm: -names.index(arm) for arm in names}
        base = row.arms[0]
        axes.axvline(base.score, color="#a5afbb", lw=0.9)
        for arm in row.arms:
            colour = _arm_colour(table, arm.arm)
            axes.plot(
                [arm.low, arm.high],
                [heights[arm.arm]] * 2,
                color=colour,
                lw=2.0,
                solid_capstyle="butt",
            )
            axes.plot(arm.score, heights[arm.arm], "o", color=colour, ms=5.5)
        if row.paper is not None:
            # The paper has two agents: the base and the game-theoretic agent (our cfr-argmax).
            diamonds = [(row.paper.non_gt, heights[base.arm])]
            if "cfr-argmax" in heights:
                diamonds.append((row.paper.gt, heights["cfr-argmax"]))
            for value, height in diamonds:
                axes.plot(value, height, "D", mfc="none", mec=PAPER, ms=5.0, mew=1.3, zorder=4)
    note = "; diamonds: the paper's win rates" if _has_paper(table) else ""
    _finish(figure, panels, names, f"score: races won, ties half; lines: 95 % intervals{note}")
    return figure


@picture
def differences_picture(table: StudyTable) -> Any:
    """Draw each agent's difference from the base, with intervals and the paper's differences."""
    figure, panels = _grid(table)
    # All panels share the heights of the whole table: an agent missing from a row leaves a gap.
    names = [arm for arm in table.arms if arm != table.base]
    for row, axes in panels:
        axes.axvline(0.0, color=INK, lw=0.8)
        for difference in row.differences:
            _interval(
                axes, difference, -names.index(difference.arm), _arm_colour(table, difference.arm)
            )
        if row.paper is not None and "cfr-argmax" in names:
            height = -names.index("cfr-argmax")
            axes.plot(
                row.paper.difference, height, "D", mfc="none", mec=PAPER, ms=5.0, mew=1.3, zorder=4
            )
    label = f"difference of score from {short(table.base)}, 95 % intervals"
    label += "; hollow: p (Holm) not below 0.05" + (
        "; diamonds: the paper's" if _has_paper(table) else ""
    )
    _finish(figure, panels, names, label)
    return figure


@picture
def adaptivity_picture(table: StudyTable) -> Any:
    """Draw each row's adaptivity gain: best agent minus best agent without observations."""
    rows = [(row, row.gain) for row in table.rows if row.gain is not None]
    if not rows:
        raise InputError("the table has no adaptivity gains; name the best and the open-loop arm")
    figure = new_figure(7.2, 1.0 + 0.34 * len(rows))
    axes = figure.subplots()
    axes.axvline(0.0, color=INK, lw=0.8)
    for i, (row, gain) in enumerate(rows):
        colour = COLOURS[0] if row.seen else COLOURS[1]
        _interval(axes, gain, -i, colour)
        axes.annotate(
            f"{gain.result.difference:+.3f}",
            (1.0, -i),
            xycoords=("axes fraction", "data"),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
            color=colour,
        )
    axes.set_yticks(
        [-i for i in range(len(rows))],
        [f"{short(row.track)} against {short(row.opponent)}" for row, _ in rows],
    )
    axes.set_ylim(-len(rows) + 0.4, 0.6)
    axes.set_xlabel(
        f"score of {short(str(table.best))} minus score of {short(str(table.open_loop))}"
    )
    axes.set_title(
        "blue: circuits learned on, orange: others; hollow: p (Holm) not below 0.05",
        fontsize=8.5,
        color=SOFT,
    )
    tidy(axes, "x")
    return figure


def _grid(table: StudyTable) -> tuple[Any, list[tuple[TableRow, Any]]]:
    """Return a figure with one panel per row: one line per track, one column per opponent."""
    tracks = list(dict.fromkeys(row.track for row in table.rows))
    opponents = list(dict.fromkeys(row.opponent for row in table.rows))
    height = 0.55 + 0.21 * len(table.arms)
    figure = new_figure(2.0 + 2.3 * len(opponents), 0.7 + height * len(tracks))
    grid = figure.subplots(len(tracks), len(opponents), sharex=True, sharey=True, squeeze=False)
    # Not every track has every opponent: panels without a row stay empty.
    for axes in grid.ravel():
        axes.set_visible(False)
    panels = []
    for row in table.rows:
        axes = grid[tracks.index(row.track), opponents.index(row.opponent)]
        axes.set_visible(True)
        axes.set_title(
            f"{short(row.track, 16)}{'' if row.seen else ' (unseen)'}, {short(row.opponent, 16)}",
            fontsize=8.5,
        )
        panels.append((row, axes))
    return figure, panels


def _finish(
    figure: Any, panels: list[tuple[TableRow, Any]], names: Sequence[str], label: str
) -> None:
    for _, axes in panels:
        axes.set_yticks([-i for i in range(len(names))], [short(name) for name in names])
        axes.set_ylim(-len(names) + 0.4, 0.6)
        axes.locator_params(axis="x", nbins=5)
        tidy(axes, "x")
    figure.supxlabel(label, fontsize=8.5, color=SOFT)


def _has_paper(table: StudyTable) -> bool:
    return any(row.paper is not None for row in table.rows)


def _arm_colour(table: StudyTable, arm: str) -> str:
    """Return grey for the base, orange for the best agent, and blue for the others."""
    return "#6b7480" if arm == table.base else COLOURS[1] if arm == table.best else COLOURS[0]


def _interval(axes: Any, difference: Any, height: float, colour: str) -> None:
    """Draw a difference with its interval; hollow if it is not significant."""
    result = difference.result
    axes.plot([result.low, result.high], [height] * 2, color=colour, lw=2.0, solid_capstyle="butt")
    axes.plot(
        result.difference,
        height,
        "o",
        ms=6,
        mec=colour,
        mew=1.4,
        mfc=colour if difference.p_holm < 0.05 else "white",
        zorder=3,
    )
