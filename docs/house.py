"""Draws docs/images/house.svg: the floors of the two packages, and the two roads through them.

python docs/house.py
"""

from html import escape
from pathlib import Path

INK, LINE, PAPER = "#1f2933", "#52606d", "#ffffff"
FLOORS = [
    ("agents", "cli/", "the commands of pcs-racing"),
    ("agents", "study/", "the paper's study: stages, table, report"),
    ("agents", "watch/", "races to watch; why an agent made a move"),
    ("agents", "learning/", "PPO, responses, PSRO, self-play"),
    ("agents", "tournament/", "races of many competitors, ratings, statistics"),
    ("agents", "agents/", "the zoo: everything that answers predict"),
    ("agents", "networks/", "regrets of a game tree, learned"),
    ("agents", "trees/  solvers/", "game trees that were driven; CFR, equilibria"),
    ("agents", "policies/", "MO-CMA-ES: archives of policies; tuning; payoffs of pools"),
    ("agents", "base/", "jobs that resume; tables, style of pictures"),
    ("environment", "testing/", "checks for your own planners, archives, axes"),
    ("environment", "f1tenth/", "the F1TENTH gym's interface, for its programs"),
    ("environment", "envs/", "PettingZoo, Gymnasium, Stable-Baselines3"),
    ("environment", "game/", "rules, characteristics, archive, moves in the PCS"),
    ("environment", "race/", "two cars: start, kernel, state, recording, replay"),
    ("environment", "planners/", "interface; lattice, lane switcher, ..."),
    ("environment", "car/", "vehicle, contacts, lidar, time to collision"),
    ("environment", "track/", "lines, walls, Frenet coordinates; how they are built"),
    ("environment", "base/", "errors, files, checks, seeds, compilation"),
]
FILL = {"environment": "#e3f0fb", "agents": "#fdf0dc"}
EDGE = {"environment": "#2f74b5", "agents": "#c07a14"}
NAME = {"environment": "pcs_racing", "agents": "pcs_racing_agents"}
ROADS = {
    "a parameter vector": ["policies/", "base/", "race/", "planners/"],
    "a move": ["agents/", "envs/", "game/", "race/"],
}
"""Floors that each road passes, from the search or the agent to the kernel; ``docs/design.md``
names the functions.
"""

TOP, STEP, HEIGHT, LEFT, WIDTH = 70, 42, 36, 40, 760
ROAD_X = (880, 1020)


def text(
    x: float, y: float, words: str, size: int = 15, anchor: str = "start", weight: str = "normal"
) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{anchor}"'
        f' font-weight="{weight}" fill="{INK}">{escape(words)}</text>'
    )


def floor_y(row: int) -> float:
    return TOP + STEP * row


def drawing() -> str:
    """Return the picture as SVG."""
    height = TOP + STEP * len(FLOORS) + 30
    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1140 {height}" '
            'font-family="system-ui, sans-serif" role="img">'
        ),
        f'<rect width="1140" height="{height}" fill="{PAPER}"/>',
        text(
            LEFT,
            40,
            "Floors: a file imports from its own floor and from those below",
            weight="bold",
        ),
    ]
    for row, (package, name, words) in enumerate(FLOORS):
        y = floor_y(row)
        parts.append(
            f'<rect x="{LEFT}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="4"'
            f' fill="{FILL[package]}" stroke="{EDGE[package]}"/>'
        )
        parts.append(text(LEFT + 14, y + 24, name, weight="bold"))
        parts.append(text(LEFT + 260, y + 24, words))
        if row == 0 or FLOORS[row - 1][0] != package:
            parts.append(text(LEFT + WIDTH - 14, y + 24, NAME[package], 14, "end"))
    rows = {name: row for row, (_, name, _) in reversed(list(enumerate(FLOORS)))}
    for x, (road, floors) in zip(ROAD_X, ROADS.items(), strict=True):
        ys = [floor_y(rows[name]) + HEIGHT / 2 for name in floors]
        parts.append(text(x, 40, road, 15, "middle", "bold"))
        parts.append(
            f'<path d="M{x} {ys[0]} V{ys[-1]}" stroke="{LINE}" stroke-width="2" fill="none"/>'
        )
        parts.extend(f'<circle cx="{x}" cy="{y}" r="6" fill="{LINE}"/>' for y in ys)
        for y in ys:
            parts.append(
                f'<path d="M{LEFT + WIDTH} {y} H{x}" stroke="{LINE}" stroke-dasharray="2 5"'
                ' fill="none"/>'
            )
    parts.append("</svg>")
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    file = Path(__file__).resolve().parent / "images" / "house.svg"
    file.write_text(drawing(), encoding="utf-8")
    print(file)
