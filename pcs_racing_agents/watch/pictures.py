"""Pictures of an explained race: paths in policy space and on the track, and values of moves."""

from typing import Any

import numpy as np

from pcs_racing.base.packing import join_segments
from pcs_racing_agents.base.style import CARS, INK, SOFT, new_figure, picture, short, tidy
from pcs_racing_agents.watch.explain import Explanation
from pcs_racing_agents.watch.pcs_picture import draw_archive, draw_arrow, in_units, plane


@picture
def explanation_picture(explanation: Explanation) -> Any:
    """Draw all pictures of a race on one sheet."""
    decided = [
        step
        for step in explanation.steps
        if step.values is not None or step.probabilities is not None
    ]
    heights = [4.6, 1.9] if decided else [4.6]
    figure = new_figure(11.0, sum(heights) + 0.6)
    rows = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    space, track = rows[0].subplots(1, 2, width_ratios=[1.0, 1.15])
    draw_space(space, explanation)
    draw_track(track, explanation)
    if decided:
        draw_values(rows[1], explanation)
    replay = explanation.replay
    figure.suptitle(
        f"{replay.title}, {replay.track_name}, {explanation.race} rules: {replay.outcome}",
        x=0.01,
        ha="left",
    )
    return figure


def draw_space(axes: Any, explanation: Explanation) -> None:
    """Draw the archive, the moves as numbered arrows, and the measured opponent before each."""
    archive, steps = explanation.archive, explanation.steps
    own_colour, other_colour = CARS[explanation.car], CARS[1 - explanation.car]
    draw_archive(axes, archive, faint=True)
    right, up = plane(archive)
    points = archive.coordinates[:, [right, up]]
    estimates = np.array([step.opponent for step in steps]).reshape(
        -1, len(archive.characteristics)
    )
    measured = in_units(archive, estimates)[:, [right, up]]
    _include(axes, measured)
    axes.plot(measured[:, 0], measured[:, 1], color=other_colour, lw=0.9, alpha=0.6, zorder=4)
    for k, point in enumerate(measured):
        _number(axes, point, k + 1, other_colour)
    # An arrow from a policy to itself is invisible; such moves are listed next to the policy.
    unchanged: dict[int, list[str]] = {}
    for k, step in enumerate(steps):
        if step.next_policy == step.policy:
            unchanged.setdefault(step.policy, []).append(str(k + 1))
            continue
        before, after = points[step.policy], points[step.next_policy]
        draw_arrow(axes, before, after, own_colour)
        _number(axes, before + 0.5 * (after - before), k + 1, own_colour)
    for policy in dict.fromkeys(
        [step.policy for step in steps[:1]] + [step.next_policy for step in steps]
    ):
        axes.plot(*points[policy], "o", ms=7, color=own_colour, mec="white", mew=0.8, zorder=5)
    for policy, numbers in unchanged.items():
        axes.annotate(
            f"{', '.join(numbers)}: kept",
            points[policy],
            xytext=(8, -8),
            textcoords="offset points",
            va="top",
            color=own_colour,
            fontsize=8.5,
            zorder=7,
        )
    names = explanation.names
    axes.set_title("Moves in the Policy Characteristic Space")
    axes.text(0.99, 0.99, f"{short(names[explanation.car])}: arrows", **_corner(axes, own_colour))
    axes.text(
        0.99,
        0.94,
        f"{short(names[1 - explanation.car])}: as measured before each move",
        **_corner(axes, other_colour),
    )


def draw_track(axes: Any, explanation: Explanation) -> None:
    """Draw the paths of both cars and their positions at each move."""
    replay = explanation.replay
    for loop in join_segments(replay.walls):
        axes.plot(loop[:, 0], loop[:, 1], color="#a5afbb", lw=1.0)
    for car, colour in enumerate(CARS):
        x, y = replay.cars[:, car, 0], replay.cars[:, car, 1]
        axes.plot(x, y, color=colour, lw=1.3, alpha=0.75)
        for k in range(len(explanation.steps)):
            frame = min(round(explanation.ends[k] / replay.frame_dt), len(x) - 1)
            _number(axes, (x[frame], y[frame]), k + 1, colour)
        axes.plot(x[0], y[0], "s", ms=5, color=colour, mec="white", mew=0.8, zorder=5)
        axes.plot(x[-1], y[-1], "o", ms=5, color="white", mec=colour, mew=1.6, zorder=5)
    for event in replay.events:
        if event.kind == "move":
            continue
        frame = min(round(event.time / replay.frame_dt), len(replay.cars) - 1)
        crash = event.kind == "crash"
        axes.plot(
            *replay.cars[frame, event.car, :2],
            "X" if crash else "^",
            ms=8 if crash else 7,
            color="#c22443" if crash else CARS[event.car],
            mec=INK,
            mew=0.8,
            zorder=7,
        )
    axes.set_aspect("equal")
    axes.axis("off")
    signs = "square: start, ring: end, numbers: moves"
    kinds = {event.kind for event in replay.events}
    signs += ", triangle: overtake" if "overtake" in kinds else ""
    signs += ", cross: crash" if "crash" in kinds else ""
    axes.set_title(signs, color=SOFT, fontsize=8.5)


def draw_values(figure: Any, explanation: Explanation) -> None:
    """Draw the values of the moves at each decision, or their probabilities without a network."""
    steps = explanation.steps
    valued = all(step.values is not None for step in steps)
    # One panel per move of the game: races of different length have comparable sheets.
    panels = figure.subplots(
        1, len(explanation.played.moves.codes[0, 0]), sharey=True, squeeze=False
    )[0]
    for axes in panels[len(steps) :]:
        axes.set_visible(False)  # no more decisions after a crash
    unit = explanation.unit
    scale = unit.scale if valued and unit is not None else 1.0
    # Moves to the same policy have separate bars, as the network values each move.
    for k, (axes, step) in enumerate(zip(panels, steps, strict=False)):
        bars = (
            scale * step.values
            if valued and step.values is not None
            else np.asarray(step.probabilities)
        )
        places = np.arange(len(bars))
        colours = [CARS[explanation.car] if i == step.move else "#b9c3ce" for i in places]
        axes.barh(places, bars, color=colours, height=0.66)
        axes.axvline(0.0, color=INK, lw=0.8)
        axes.set_yticks(np.arange(len(explanation.moves)), explanation.moves)
        axes.set_ylim(len(explanation.moves) - 0.5, -0.5)
        # A network without the move "stay" has no bar for it.
        if step.move >= len(bars):
            axes.annotate(
                "made",
                (0.0, step.move),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        axes.set_title(f"{k + 1}: {step.time:g} s", fontsize=9)
        axes.locator_params(axis="x", nbins=4)
        tidy(axes, "x")
        axes.spines["left"].set_visible(False)
    words = "chance of each move"
    if valued:
        names = {"of a win": ", wins", "m of lead": ", m of lead"}
        words = f"value of each move{names.get('' if unit is None else unit.text, '')}"
    figure.supxlabel(f"{words}; coloured: made", fontsize=9, color=SOFT)


def _number(axes: Any, point: Any, number: int, colour: str) -> None:
    """Draw a number in a circle."""
    axes.annotate(
        str(number),
        (float(point[0]), float(point[1])),
        ha="center",
        va="center",
        fontsize=7.0,
        color="white",
        fontweight="bold",
        zorder=6,
        bbox={
            "boxstyle": "circle,pad=0.18",
            "facecolor": colour,
            "edgecolor": "white",
            "linewidth": 0.8,
        },
    )


def _include(axes: Any, points: Any) -> None:
    """Widen the limits of a picture to include some points."""
    for column, limits, setter in (
        (0, axes.get_xlim(), axes.set_xlim),
        (1, axes.get_ylim(), axes.set_ylim),
    ):
        margin = 0.05 * (limits[1] - limits[0])
        low, high = (
            points[:, column].min(initial=limits[1]),
            points[:, column].max(initial=limits[0]),
        )
        setter(min(limits[0], low - margin), max(limits[1], high + margin))


def _corner(axes: Any, colour: str) -> dict[str, Any]:
    return {
        "transform": axes.transAxes,
        "ha": "right",
        "va": "top",
        "fontsize": 8.5,
        "color": colour,
    }
