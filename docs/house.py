"""Draws docs/images/house.svg: the packages, and which way the data flows.

python docs/house.py
"""

from html import escape
from pathlib import Path

WIDTH, HEIGHT = 1140, 890
INK, LINE, PAPER = "#1f2933", "#52606d", "#ffffff"
FLOORS = {"environment": "#e3f0fb", "agents": "#fdf0dc", "outside": "#f1f3f5"}
EDGES = {"environment": "#2f74b5", "agents": "#c07a14", "outside": "#7b8794"}

# name: (floor, x, y, width, title, lines)
BOXES = {
    "map": ("outside", 40, 96, 200, "a map folder", ("yaml, picture, csv",)),
    "track": (
        "environment",
        300,
        96,
        240,
        "Track",
        ("track.py  maps.py  mapping/", "lines, walls, Frenet coordinates"),
    ),
    "driver": ("environment", 590, 96, 240, "Planner, Policy", ("planner.py  registry.py", "code and a vector theta")),
    "planners": ("environment", 880, 96, 220, "planners/", ("lattice, lane switcher,", "pure pursuit, gap follower")),
    "kernel": (
        "environment",
        300,
        226,
        530,
        "race kernel",
        (
            "vehicle.py  collision.py  lidar.py  ittc.py  race_kernel.py",
            "a batch of two-car races; their state is a value",
        ),
    ),
    "replay": ("environment", 880, 226, 220, "recording, replay", ("a race to watch",)),
    "points": ("environment", 300, 356, 240, "characteristics.py", ("trajectories to a point", "in the PCS")),
    "synthesis": ("agents", 590, 356, 240, "synthesis/", ("MO-CMA-ES: policies", "that nothing dominates")),
    "archive": (
        "environment",
        590,
        486,
        240,
        "PolicyArchive",
        ("archive.py: policies, their", "points, moves between them"),
    ),
    "game": (
        "environment",
        300,
        486,
        240,
        "RaceGame",
        ("game.py: start, moves, obser-", "vation, utility. The only rules"),
    ),
    "envs": ("environment", 40, 486, 200, "envs/", ("PettingZoo, Gymnasium,", "Stable-Baselines3")),
    "trees": ("agents", 300, 616, 240, "trees/  rollouts/", ("all moves that could have", "been made, driven")),
    "learned": ("agents", 590, 616, 240, "solvers/  approximator/", ("CFR, exact equilibria,", "networks for regrets")),
    "rl": ("outside", 40, 616, 200, "your RL code", ("and ppo/",)),
    "zoo": ("agents", 590, 746, 240, "strategies/", ("the zoo: all that", "answers predict")),
    "tournament": ("agents", 300, 746, 240, "tournament/", ("common random numbers,", "statistics, ratings")),
    "study": ("agents", 40, 746, 200, "study/  explaining/", ("the paper's experiment,", "tables, report")),
    "jobs": (
        "agents",
        880,
        486,
        220,
        "jobs.py  executors.py",
        (
            "long work: chunks, resume,",
            "threads, processes, cluster.",
            "Used by synthesis, trees,",
            "rollouts, ppo, tournament",
            "and study",
        ),
    ),
}
HEIGHTS = {1: 64, 2: 84, 5: 148}
# from, side, to, side; sides: l, r, t, b, optionally with a shift in pixels along that side
ARROWS = (
    ("map", "r", "track", "l"),
    ("planners", "l", "driver", "r"),
    ("track", "b", "kernel", "t-145"),
    ("driver", "b", "kernel", "t+145"),
    ("kernel", "r", "replay", "l"),
    ("kernel", "b-145", "points", "t"),
    ("points", "r", "synthesis", "l"),
    ("synthesis", "b", "archive", "t"),
    ("archive", "l", "game", "r"),
    ("points", "b", "game", "t"),
    ("game", "l", "envs", "r"),
    ("game", "b", "trees", "t"),
    ("envs", "b", "rl", "t"),
    ("trees", "r", "learned", "l"),
    ("learned", "b", "zoo", "t"),
    ("rl", "b", "zoo", "b"),
    ("zoo", "l", "tournament", "r"),
    ("tournament", "l", "study", "r"),
)


def height(name: str) -> int:
    """Height of a box, px."""
    return HEIGHTS[len(BOXES[name][5])]


def place(name: str, side: str) -> tuple[float, float]:
    """Point on the edge of a box."""
    _, x, y, width, _, _ = BOXES[name]
    tall, shift = height(name), float(side[1:] or 0)
    return {
        "l": (x, y + tall / 2 + shift),
        "r": (x + width, y + tall / 2 + shift),
        "t": (x + width / 2 + shift, y),
        "b": (x + width / 2 + shift, y + tall),
    }[side[0]]


def arrow(start: str, leaving: str, end: str, entering: str) -> str:
    """Return a line with a head between two boxes."""
    (x0, y0), (x1, y1) = place(start, leaving), place(end, entering)
    if start == "rl":  # a trained model races, too: around the study and the tournament
        path = f"M {x0 - 100} {y0 - 40} H 18 V {HEIGHT - 26} H {x1} V {y1 + 8}"
    elif abs(x0 - x1) < 2 or abs(y0 - y1) < 2 or leaving[0] in "lr":
        way = (x1 - 8 if x1 > x0 else x1 + 8, y0) if leaving[0] in "lr" else (x0, y1 - 8)
        path = f"M {x0} {y0} L {way[0]} {way[1]}"
    else:
        middle = (y0 + y1) / 2
        path = f"M {x0} {y0} V {middle} H {x1} V {y1 - 8}"
    return f'<path d="{path}" fill="none" stroke="{LINE}" stroke-width="2" marker-end="url(#head)"/>'


def box(name: str) -> str:
    """Return a box with its title and lines."""
    floor, x, y, width, title, lines = BOXES[name]
    parts = [
        f'<rect x="{x}" y="{y}" width="{width}" height="{height(name)}" rx="8" fill="{FLOORS[floor]}" '
        f'stroke="{EDGES[floor]}" stroke-width="1.5"/>',
        f'<text x="{x + 14}" y="{y + 27}" font-weight="600" font-size="16">{escape(title)}</text>',
    ]
    for number, line in enumerate(lines):
        parts.append(f'<text x="{x + 14}" y="{y + 49 + 20 * number}" font-size="14">{escape(line)}</text>')
    return "\n".join(parts)


def legend() -> str:
    """Return what the colours mean."""
    said = {
        "environment": "pcs_racing, which never imports the other",
        "agents": "pcs_racing_agents",
        "outside": "yours",
    }
    parts, x = [], 40
    for floor, text in said.items():
        parts.append(
            f'<rect x="{x}" y="32" width="22" height="22" rx="4" fill="{FLOORS[floor]}" stroke="{EDGES[floor]}"/>'
            f'<text x="{x + 32}" y="49" font-size="16">{text}</text>'
        )
        x += 90 + 8 * len(text)
    return "\n".join(parts)


def main() -> None:
    text = "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
            f'font-family="system-ui, Helvetica, Arial, sans-serif" fill="{INK}" role="img" '
            'aria-label="The packages of pcs-racing and the direction of the data">',
            '<defs><marker id="head" viewBox="0 0 10 10" refX="3" refY="5" markerWidth="6" markerHeight="6" '
            f'orient="auto-start-reverse"><path d="M 0 0 L 10 5 L 0 10 z" fill="{LINE}"/></marker></defs>',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{PAPER}"/>',
            legend(),
            *(arrow(*way) for way in ARROWS),
            *(box(name) for name in BOXES),
            "</svg>",
        ]
    )
    file = Path(__file__).parent / "images" / "house.svg"
    file.write_text(text + "\n", encoding="utf-8")
    print(file)


if __name__ == "__main__":
    main()
