"""The pictures of a study's report."""

from collections.abc import Sequence
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing_agents.pictures.curves import curves_picture
from pcs_racing_agents.pictures.style import (
    COLOURS,
    INK,
    SOFT,
    new_figure,
    picture,
    place_labels,
    short,
    tidy,
)
from pcs_racing_agents.study.report_inputs import Place
from pcs_racing_agents.study.table import StudyTable, TableRow
from pcs_racing_agents.tournament.pictures import payoffs_picture, ratings_picture

__all__ = [
    "adaptivity_picture",
    "curves_picture",
    "differences_picture",
    "exploitability_picture",
    "payoffs_picture",
    "ratings_picture",
    "scores_picture",
]

PAPER = "#c22443"


@picture
def scores_picture(table: StudyTable) -> Any:
    """Draw each agent's score with its interval: a panel for each row, the paper's win rates beside ours."""
    figure, panels = _grid(table)
    names = table.arms
    for row, axes in panels:
        places = {arm: -names.index(arm) for arm in names}
        base = row.arms[0]
        axes.axvline(base.score, color="#a5afbb", lw=0.9)
        for arm in row.arms:
            colour = _arm_colour(table, arm.arm)
            axes.plot([arm.low, arm.high], [places[arm.arm]] * 2, color=colour, lw=2.0, solid_capstyle="butt")
            axes.plot(arm.score, places[arm.arm], "o", color=colour, ms=5.5)
        if row.paper is not None:
            # The paper's agents are our base and its own game-theoretic agent, where that raced.
            shown = [(row.paper.non_gt, places[base.arm])]
            if "cfr-argmax" in places:
                shown.append((row.paper.gt, places["cfr-argmax"]))
            for value, place in shown:
                axes.plot(value, place, "D", mfc="none", mec=PAPER, ms=5.0, mew=1.3, zorder=4)
    told = "; diamonds: the paper's win rates" if _has_paper(table) else ""
    _finish(figure, panels, names, f"score: races won, ties half; lines: 95 % intervals{told}")
    return figure


@picture
def differences_picture(table: StudyTable) -> Any:
    """Draw each agent's difference from the base with its interval: a panel for each row, the paper's beside ours."""
    figure, panels = _grid(table)
    names = [arm for arm in table.arms if arm != table.base]
    for row, axes in panels:
        axes.axvline(0.0, color=INK, lw=0.8)
        for one in row.differences:
            _interval(axes, one, -names.index(one.arm), _arm_colour(table, one.arm))
        if row.paper is not None and "cfr-argmax" in names:
            place = -names.index("cfr-argmax")
            axes.plot(row.paper.difference, place, "D", mfc="none", mec=PAPER, ms=5.0, mew=1.3, zorder=4)
    told = f"difference of score from {short(table.base)}, 95 % intervals"
    told += "; hollow: p (Holm) not below 0.05" + ("; diamonds: the paper's" if _has_paper(table) else "")
    _finish(figure, panels, names, told)
    return figure


@picture
def adaptivity_picture(table: StudyTable) -> Any:
    """Draw what looking at the race adds: the best agent minus the best one that never looks, row by row.

    Raises
    ------
    InputError
        If the table knows no such difference.
    """
    rows = [(row, row.gain) for row in table.rows if row.gain is not None]
    if not rows:
        raise InputError("the table has no adaptivity gains; name the best and the blind arm")
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
        [-i for i in range(len(rows))], [f"{short(row.track)} against {short(row.opponent)}" for row, _ in rows]
    )
    axes.set_ylim(-len(rows) + 0.4, 0.6)
    axes.set_xlabel(f"score of {short(str(table.best))} minus score of {short(str(table.blind))}")
    axes.set_title(
        "blue: circuits learned on, orange: others; hollow: p (Holm) not below 0.05", fontsize=8.5, color=SOFT
    )
    tidy(axes, "x")
    return figure


@picture
def exploitability_picture(places: Sequence[Place], *, unit: str = "utility") -> Any:
    """Draw scores against what the agents lose to an opponent that knows them.

    Raises
    ------
    InputError
        If there is no agent.
    """
    if not places:
        raise InputError("there is no agent whose score and exploitability are known")
    figure = new_figure(7.2, 4.4)
    axes = figure.subplots()
    for i, place in enumerate(places):
        colour = COLOURS[i % len(COLOURS)]
        axes.errorbar(
            place.loss, place.score, place.score_error, place.loss_error, "o", color=colour, ms=6, elinewidth=1.0
        )
    axes.margins(x=0.16, y=0.12)
    axes.set_xlabel(f"lost to an opponent that knows it, {unit} (half the NashConv); right: easier to exploit")
    axes.set_ylabel("score in races")
    tidy(axes)
    points = [(place.loss, place.score) for place in places]
    place_labels(
        axes, points, [short(place.name) for place in places], [COLOURS[i % len(COLOURS)] for i in range(len(places))]
    )
    return figure


def _grid(table: StudyTable) -> tuple[Any, list[tuple[TableRow, Any]]]:
    """Return a figure with a panel for each row: circuits below each other, opponents side by side."""
    tracks = list(dict.fromkeys(row.track for row in table.rows))
    opponents = list(dict.fromkeys(row.opponent for row in table.rows))
    height = 0.55 + 0.21 * len(table.arms)
    figure = new_figure(2.0 + 2.3 * len(opponents), 0.7 + height * len(tracks))
    grid = figure.subplots(len(tracks), len(opponents), sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel():
        axes.set_visible(False)
    panels = []
    for row in table.rows:
        axes = grid[tracks.index(row.track), opponents.index(row.opponent)]
        axes.set_visible(True)
        axes.set_title(
            f"{short(row.track, 16)}{'' if row.seen else ' (unseen)'}, {short(row.opponent, 16)}", fontsize=8.5
        )
        panels.append((row, axes))
    return figure, panels


def _finish(figure: Any, panels: list[tuple[TableRow, Any]], names: Sequence[str], told: str) -> None:
    for _, axes in panels:
        axes.set_yticks([-i for i in range(len(names))], [short(name) for name in names])
        axes.set_ylim(-len(names) + 0.4, 0.6)
        axes.locator_params(axis="x", nbins=5)
        tidy(axes, "x")
    figure.supxlabel(told, fontsize=8.5, color=SOFT)


def _has_paper(table: StudyTable) -> bool:
    return any(row.paper is not None for row in table.rows)


def _arm_colour(table: StudyTable, arm: str) -> str:
    """Grey for the base, blue for all others but the best, which is to be found at a glance."""
    return "#6b7480" if arm == table.base else COLOURS[1] if arm == table.best else COLOURS[0]


def _interval(axes: Any, one: Any, place: float, colour: str) -> None:
    """Draw a difference with its interval; hollow where it may be nothing."""
    result = one.result
    axes.plot([result.low, result.high], [place] * 2, color=colour, lw=2.0, solid_capstyle="butt")
    axes.plot(
        result.difference, place, "o", ms=6, mec=colour, mew=1.4, mfc=colour if one.p_holm < 0.05 else "white", zorder=3
    )
