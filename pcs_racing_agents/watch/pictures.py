"""Pictures of an explained race: paths in policy space and on the track, and values of moves."""

from typing import Any

import numpy as np

from pcs_racing.base.packing import join_segments
from pcs_racing_agents.base.style import CARS, INK, SOFT, new_figure, picture, short, tidy
from pcs_racing_agents.policies.picture import draw_archive, draw_arrow, in_units, plane
from pcs_racing_agents.watch.explain import Explanation

SIGNS = {"overtake": "^", "crash": "X"}
"""Markers of the events on the track."""


@picture
def explanation_picture(explanation: Explanation) -> Any:
    """Draw all pictures of a race on one sheet."""
    replay, steps = explanation.replay, explanation.steps
    known = [step for step in steps if step.values is not None or step.probabilities is not None]
    heights = [4.6, 1.9] if known else [4.6]
    figure = new_figure(11.0, sum(heights) + 0.6)
    rows = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    space, track = rows[0].subplots(1, 2, width_ratios=[1.0, 1.15])
    draw_space(space, explanation)
    draw_track(track, explanation)
    if known:
        draw_values(rows[1], explanation)
    rules = f"{explanation.game.rules.name} rules"
    title = f"{replay.title}, {replay.track_name}, {rules}: {replay.outcome}"
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def draw_space(axes: Any, explanation: Explanation) -> None:
    """Draw the archive, the moves as numbered arrows, and the measured opponent before each."""
    archive, steps, car = explanation.game.archive, explanation.steps, explanation.car
    names, (own, other) = explanation.replay.car_names, (CARS[car], CARS[1 - car])
    draw_archive(axes, archive, faint=True)
    columns = list(plane(archive))
    points = archive.coordinates[:, columns]
    estimates = np.reshape([step.opponent for step in steps], (-1, len(archive.characteristics)))
    measured = in_units(archive, estimates)[:, columns]
    label = f"{short(names[1 - car])}, as measured before each move"
    axes.plot(*measured.T, color=other, lw=0.9, alpha=0.6, zorder=4, label=label)
    # Measurements may lie outside the archive's limits.
    for limits, set_limits, values in zip(
        (axes.get_xlim(), axes.get_ylim()), (axes.set_xlim, axes.set_ylim), measured.T, strict=True
    ):
        set_limits(values.min(initial=limits[0]), values.max(initial=limits[1]))
    # An arrow from a policy to itself is invisible; such moves are listed next to the policy.
    unchanged: dict[int, list[str]] = {}
    for k, step in enumerate(steps):
        _number(axes, measured[k], k + 1, other)
        before, after = points[step.policy], points[step.next_policy]
        axes.plot(*after, "o", ms=7, color=own, mec="white", mew=0.8, zorder=5)
        if step.next_policy == step.policy:
            unchanged.setdefault(step.policy, []).append(str(k + 1))
            continue
        draw_arrow(axes, before, after, own)
        _number(axes, 0.5 * (before + after), k + 1, own)
    place: dict[str, Any] = {"xytext": (8, -8), "textcoords": "offset points", "va": "top"}
    for policy, numbers in unchanged.items():
        text = f"{', '.join(numbers)}: kept"
        axes.annotate(text, points[policy], **place, color=own, fontsize=8.5, zorder=7)
    axes.plot([], [], color=own, label=f"{short(names[car])}, moves")
    axes.legend()
    axes.set_title("Moves in the Policy Characteristic Space")


def draw_track(axes: Any, explanation: Explanation) -> None:
    """Draw the paths of both cars, their positions at each move, overtakes and crashes."""
    replay, options = explanation.replay, {"mew": 0.8, "zorder": 5}
    for loop in join_segments(replay.walls):
        axes.plot(*loop.T, color="#a5afbb", lw=1.0)
    for car, colour in enumerate(CARS):
        path = replay.cars[:, car, :2]
        axes.plot(*path.T, color=colour, lw=1.3, alpha=0.75)
        axes.plot(*path[0], "s", ms=5, color=colour, mec="white", **options)
        for k, step in enumerate(explanation.steps):
            _number(axes, path[_frame(explanation, step.time)], k + 1, colour)
    for event in replay.events:
        if event.kind in SIGNS:
            place = replay.cars[_frame(explanation, event.time), event.car, :2]
            axes.plot(*place, SIGNS[event.kind], ms=8, color=CARS[event.car], mec=INK, **options)
    axes.set_aspect("equal")
    axes.axis("off")
    signs = "square: start, numbers: moves, triangle: overtake, cross: crash"
    axes.set_title(signs, color=SOFT, fontsize=8.5)


def _frame(explanation: Explanation, time: float) -> int:
    """Return the frame of the replay at a time; a crash ends it early."""
    replay = explanation.replay
    return min(round(time / replay.frame_dt), len(replay.cars) - 1)


def draw_values(figure: Any, explanation: Explanation) -> None:
    """Draw the values of the moves at each decision, or their probabilities without a network."""
    steps, names = explanation.steps, explanation.game.moves
    valued = all(step.values is not None for step in steps)
    # One panel per move of the game: races of different length have comparable sheets.
    moves = explanation.game.rules.moves
    panels = figure.subplots(1, moves, sharey=True, squeeze=False)[0]
    for axes in panels[len(steps) :]:
        axes.set_visible(False)  # no more decisions after a crash
    # Moves to the same policy have separate bars, as the network values each move.
    for k, (axes, step) in enumerate(zip(panels, steps, strict=False)):
        bars = np.asarray(step.values if valued else step.probabilities)
        colours = [CARS[explanation.car] if i == step.move else "#b9c3ce" for i in range(len(bars))]
        axes.barh(np.arange(len(bars)), bars, color=colours, height=0.66)
        axes.axvline(0.0, color=INK, lw=0.8)
        axes.set_yticks(np.arange(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_title(f"{k + 1}: {step.time:g} s, {names[step.move]}", fontsize=9)
        axes.locator_params(axis="x", nbins=4)
        tidy(axes, "x")
        axes.spines["left"].set_visible(False)
    bar = f"value ({explanation.unit or 'relative'})" if valued else "chance"
    figure.supxlabel(f"{bar} of each move; coloured: made", fontsize=9, color=SOFT)


def _number(axes: Any, point: Any, number: int, colour: str) -> None:
    """Draw a number in a circle."""
    circle = {"boxstyle": "circle,pad=0.18", "facecolor": colour, "edgecolor": "white", "lw": 0.8}
    style = {"ha": "center", "va": "center", "fontsize": 7.0, "fontweight": "bold", "zorder": 6}
    axes.text(float(point[0]), float(point[1]), str(number), color="white", bbox=circle, **style)
