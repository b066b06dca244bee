"""What the lattice planner considers behind another car, for two weightings of one cost (docs/images/planner.png).

    python benchmarks/planner_figure.py
    python benchmarks/planner_figure.py --track Saltmere --at 40 --out planner.png

Each thin line is one move at the speed of an attack, coloured by how much more it costs than the best candidate, red if
it is rejected. The planner weighs each move at three more speeds; the bold one is driven, at the speed that its label
says. Needs matplotlib: pip install ".[plots]".
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing import PAPER, Policy, RaceSetup, Starts, Track, load_track
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.view import OPP_PSI, OPP_X, OPP_Y, OWN_BETA, OWN_PSI, OWN_X, OWN_Y, VIEW_SIZE
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import start_races

Floats = NDArray[np.float64]

BEHIND, AHEAD = -0.7, 7.0  # m of road in the picture
SPEEDS = 4
SPEED_LABELS = ("attacks", "at its own pace", "at 85 % of it", "follows")
WEIGHTINGS = (
    ("Much weight on passing, little on the race line", {"overtaking": 2.0, "deviation": -0.7}),
    ("Little weight on passing, much on the race line", {"overtaking": -1.0, "deviation": 1.0, "progress": 0.0}),
)
INK, PAPER_COLOUR, ROAD = "#1d2530", "#ffffff", "#eef0f3"
OWN, OTHER, REJECTED = "#1f6fd6", "#f0a202", "#d7263d"


def look(track: Track, s: float, gap: float, d: float, opponent_d: float, speeds: tuple[float, float]) -> Floats:
    """View of a car at (s, d) with the opponent a gap ahead."""
    setup = RaceSetup(track, PAPER, (LATTICE, LATTICE))
    state = start_races(setup, Starts(np.zeros(1), np.zeros(1, np.int64)), np.zeros(1, np.uint64))
    for car, (at, across, v) in enumerate([(s, d, speeds[0]), (s + gap, opponent_d, speeds[1])]):
        x, y, psi = track.to_cartesian([at % track.length, across])
        state.cars[0, car] = [x, y, 0.0, v, psi % (2.0 * np.pi), 0.0, 0.0]
        state.frenet[0, car] = at % track.length, across
        state.progress[0, car] = at
    view = np.zeros(VIEW_SIZE)
    fill_view(track.arrays, state, 0, 0, np.stack([F1TENTH.as_row()] * 2), setup.settings, view)
    return view


def smooth(points: Floats, times: int = 8) -> Floats:
    """Curve through points by Catmull-Rom splines: a picture has no corners where the planner has none."""
    before = np.vstack([2.0 * points[0] - points[1], points[:-1]])
    after = np.vstack([points[1:], 2.0 * points[-1] - points[-2]])
    slope = 0.5 * (after - before)
    u = np.linspace(0.0, 1.0, times, endpoint=False)[:, None]
    pieces = [
        (1 + 2 * u) * (1 - u) ** 2 * points[k]
        + u * (1 - u) ** 2 * slope[k]
        + u**2 * (3 - 2 * u) * points[k + 1]
        - u**2 * (1 - u) * slope[k + 1]
        for k in range(len(points) - 1)
    ]
    return np.vstack([*pieces, points[-1:]])


def frame(view: Floats, turn: float) -> tuple[Floats, Floats]:
    """Origin and rotation that put the car at the origin and its way to the right."""
    c, s = np.cos(turn), np.sin(turn)
    return view[[OWN_X, OWN_Y]], np.array([[c, s], [-s, c]])


def draw(axes, track: Track, policy: Policy, view: Floats, turn: float, title: str, most: float):  # type: ignore[no-untyped-def]
    from matplotlib import colormaps, patheffects
    from matplotlib.colors import PowerNorm
    from matplotlib.patches import Rectangle
    from matplotlib.transforms import Affine2D

    origin, rotation = frame(view, turn)

    def place(points: Floats) -> Floats:
        return (points - origin) @ rotation.T

    # The road: everything between the walls.
    s = np.linspace(-3.0, 11.0, 281) + track.to_frenet(origin)[0]
    row = (np.mod(s, track.length) / track.arrays.ds).astype(int) % len(track.line)
    edges = [place(track.to_cartesian(np.column_stack([s % track.length, d]))[:, :2]) for d in side_widths(track, row)]
    axes.fill(*np.vstack([edges[0], edges[1][::-1]]).T, color=ROAD, zorder=0)
    for edge in edges:
        axes.plot(*edge.T, color=INK, linewidth=1.6, solid_capstyle="round", zorder=1)
    line = place(track.to_cartesian(np.column_stack([s % track.length, np.zeros_like(s)]))[:, :2])
    axes.plot(*line.T, color="#8a94a3", linewidth=1.1, dashes=(5, 4), zorder=1)

    # The candidates: the worst first, so that the good ones lie on top.
    points, costs = LATTICE.candidates(track.arrays, policy.parameters, view, np.zeros(LATTICE.memory_size))
    moves = len(points) // SPEEDS
    best, attacks = int(np.argmin(costs)), costs[:moves]
    scale = PowerNorm(0.5, 0.0, most)
    colours = colormaps["viridis_r"]
    for g in np.argsort(-np.nan_to_num(attacks, posinf=1e9)):
        curve = smooth(place(points[g]))
        if np.isinf(attacks[g]):
            axes.plot(*curve.T, color=REJECTED, linewidth=1.4, alpha=0.75, zorder=2)
            axes.plot(*curve[-1], "x", color=REJECTED, markersize=5, zorder=2)
        else:
            colour = colours(scale(attacks[g] - costs[best]))
            axes.plot(*curve.T, color=colour, linewidth=1.8, zorder=3, solid_capstyle="round")
            axes.plot(*curve[-1], "o", color=colour, markersize=3.5, zorder=3)
    chosen = smooth(place(points[best]))
    halo = [patheffects.Stroke(linewidth=7.5, foreground="white"), patheffects.Normal()]
    axes.plot(*chosen.T, color=INK, linewidth=4.5, zorder=4, solid_capstyle="round", path_effects=halo)

    speed = SPEED_LABELS[best // moves]
    axes.annotate(
        speed,
        chosen[-1],
        xytext=(8, 0),
        textcoords="offset points",
        va="center",
        color=INK,
        fontsize=9.5,
        zorder=6,
        path_effects=[patheffects.withStroke(linewidth=3.0, foreground=ROAD)],
    )

    heading = view[OWN_PSI] + view[OWN_BETA] - turn
    cars = [(np.zeros(2), heading, OWN), (place(view[[OPP_X, OPP_Y]]), view[OPP_PSI] - turn, OTHER)]
    for centre, angle, colour in cars:
        body = Rectangle(
            (-0.5 * F1TENTH.length, -0.5 * F1TENTH.width),
            F1TENTH.length,
            F1TENTH.width,
            facecolor=colour,
            edgecolor=INK,
        )
        body.set(linewidth=1.2, zorder=5, joinstyle="round")
        body.set_transform(Affine2D().rotate(angle).translate(*centre) + axes.transData)
        axes.add_patch(body)
    axes.set_title(title, fontsize=11, color=INK, loc="left", pad=6)
    seen = np.vstack([edge[(edge[:, 0] > BEHIND) & (edge[:, 0] < AHEAD)] for edge in edges])
    axes.set_xlim(BEHIND, AHEAD)
    axes.set_ylim(seen[:, 1].min() - 0.05, seen[:, 1].max() + 0.05)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return scale, colours


def side_widths(track: Track, row: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Distance of the right and the left wall from the race line, m, without the steps of the grid's cells."""
    window = np.hanning(13)
    widths = np.pad(track.line[row, 7:9], ((6, 6), (0, 0)), mode="edge")
    right, left = (np.convolve(width, window / window.sum(), mode="valid") for width in widths.T)
    return -right, left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Brackwater", help="name of a shipped circuit or a map folder")
    parser.add_argument("--at", type=float, default=4.0, help="arc length of the car, m")
    parser.add_argument("--gap", type=float, default=2.5, help="distance to the opponent along the track, m")
    parser.add_argument("--speeds", type=float, nargs=2, default=(6.0, 5.0), help="own and the opponent's speed, m/s")
    parser.add_argument("--out", type=Path, default=Path("docs/images/planner.png"))
    arguments = parser.parse_args()
    try:
        import matplotlib
    except ImportError as error:
        raise SystemExit('the figure needs matplotlib: pip install ".[plots]"') from error
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.lines import Line2D

    track = load_track(arguments.track)
    view = look(track, arguments.at, arguments.gap, 0.0, 0.0, arguments.speeds)
    turn = float(track.to_cartesian([(arguments.at + 2.5) % track.length, 0.0])[2])
    figure, panels = plt.subplots(1, 2, figsize=(11.0, 3.1), dpi=200, facecolor=PAPER_COLOUR, layout="constrained")
    for axes, (title, parameters) in zip(panels, WEIGHTINGS, strict=True):
        scale, colours = draw(axes, track, LATTICE.policy(parameters), view, turn, title, most=16.0)
    bar = figure.colorbar(
        ScalarMappable(scale, colours), ax=panels, shrink=0.7, aspect=22, pad=0.01, extend="max", ticks=[0, 1, 4, 9, 16]
    )
    bar.set_label("cost above the best", color=INK)
    bar.outline.set_visible(False)
    handles = [
        Line2D([], [], color=INK, linewidth=4.5, label="chosen"),
        Line2D([], [], color=REJECTED, linewidth=1.4, marker="x", markersize=5, label="rejected"),
        Line2D([], [], color="#8a94a3", linewidth=1.1, dashes=(5, 4), label="race line"),
        Line2D([], [], color=OWN, marker="s", linestyle="", markersize=8, label="own car"),
        Line2D([], [], color=OTHER, marker="s", linestyle="", markersize=8, label="opponent"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9.5, labelcolor=INK)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(arguments.out)
    print(arguments.out)


if __name__ == "__main__":
    main()
