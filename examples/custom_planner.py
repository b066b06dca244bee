"""Write a compiled planner with two parameters, and race it in a tournament.

    python examples/custom_planner.py
    python examples/custom_planner.py --track Saltmere --races 100 --pace 0.3

The planner follows a line between the race line and the middle of the track: it is faster near the
race line, and has more distance to the walls in the middle. A table shows the effect of the
parameter ``caution``; then three policies of the planner enter a tournament with agents of the zoo.
docs/planners.md explains every part.
"""

import argparse

import numpy as np

from pcs_racing import load_rules, load_track, run_races
from pcs_racing.game import ITTC, ITTC_SAMPLES
from pcs_racing.planners import (
    KAPPA,
    LEFT,
    PATH_KAPPA,
    PATH_POINTS,
    PATH_SPEED,
    PATH_X,
    PATH_Y,
    PSI,
    RIGHT,
    SPEED,
    Parameter,
    Planner,
    angle_between,
    compiled,
    get_planner,
    register_planner,
    to_cartesian,
    view as view_of,  # indices of `view`
)
from pcs_racing_agents.tournament import play_tournament

# 1. The parameters, in the order of `theta`, with bounds and a default. Synthesis searches between
# the bounds.
PARAMETERS = (
    Parameter(
        "pace",
        0.0,
        1.0,
        0.5,
        "speed scale, from the minimum (0) to the maximum (1) of the race's speed range",
    ),
    Parameter(
        "caution",
        0.0,
        1.0,
        0.3,
        "lateral position, from the race line (0) to the middle of the track (1)",
    ),
)
PACE, CAUTION = range(2)


# 2. The plan, ten times a second. It is compiled: numbers and loops, no Python objects, no
# exceptions.
@compiled
def plan(track, theta, view, memory, scratch, path):
    line = track.line
    s, d, v = view[view_of.OWN_S], view[view_of.OWN_D], view[view_of.OWN_V]

    # Speed: the speed profile times the scale of `pace`, limited to keep 1.5 m to a car in front.
    scale = view[view_of.SPEED_LOW] + theta[PACE] * (
        view[view_of.SPEED_HIGH] - view[view_of.SPEED_LOW]
    )
    gap = view[view_of.GAP]
    gap -= np.floor(gap / track.length + 0.5) * track.length  # without laps
    max_speed = np.inf
    if gap > 0.0 and abs(view[view_of.OPP_D] - d) < 0.45:
        max_speed = max(view[view_of.OPP_V] + 1.2 * (gap - 1.5), 0.0)

    # Twelve points for the default `control` to follow by pure pursuit. Their distance from the
    # race line is a cubic that starts along the car's course, `rise` metres sideways over its
    # length, and ends at the goal.
    length = 1.5 + 0.2 * v
    course = view[view_of.OWN_PSI] + view[view_of.OWN_BETA]
    here = line[int(s / track.ds)]
    rise = length * np.tan(min(max(angle_between(course, here[PSI]), -1.0), 1.0))
    for j in range(PATH_POINTS):
        u = j / (PATH_POINTS - 1)
        there = line[int((s + u * length) / track.ds) % line.shape[0]]
        goal = theta[CAUTION] * 0.5 * (there[LEFT] - there[RIGHT])
        across = goal + (1.0 - u) ** 2 * ((1.0 + 2.0 * u) * (d - goal) + u * rise)
        path[j, PATH_X], path[j, PATH_Y], _ = to_cartesian(track, s + u * length, across)
        path[j, PATH_SPEED] = min(scale * there[SPEED], max_speed)
        path[j, PATH_KAPPA] = there[KAPPA]


# 3. The planner. Once it is registered, `parse_policy("cautious:pace=0.8")` makes one of its
# policies.
CAUTIOUS = Planner("cautious", PARAMETERS, plan=plan)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Larkmoor", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--rules", default="contest", help="rules: paper, contest or a YAML file")
    parser.add_argument(
        "--pace", type=float, default=0.6, help="pace of both planners, from 0 to 1"
    )
    parser.add_argument("--races", type=int, default=40, help="races of each row of the table")
    parser.add_argument("--seed", type=int, default=0, help="seed of start lines and noise")
    arguments = parser.parse_args()

    register_planner(CAUTIOUS)
    track = load_track(arguments.track)
    config = load_rules(arguments.rules)
    opponent = get_planner("lattice").policy({"pace": arguments.pace})
    print(
        f"{track.name}, {config.name}: {arguments.races} races against the lattice planner at pace"
        f" {arguments.pace:g}"
    )
    print(
        f"{'caution':>10}{'won':>8}{'lost':>8}{'own crash':>12}"
        f"{'lead at the end':>18}{'mean iTTC':>12}"
    )
    for caution in (0.0, 0.25, 0.5, 0.75, 1.0):
        ego = get_planner("cautious").policy({"pace": arguments.pace, "caution": caution})
        result = run_races(track, [ego] * arguments.races, opponent, config, seed=arguments.seed)
        ittc = result.state.sums[:, 0, ITTC].sum() / result.state.sums[:, 0, ITTC_SAMPLES].sum()
        print(
            f"{caution:10.2f}{np.mean(result.winner == 0):8.0%}{np.mean(result.winner == 1):8.0%}"
            f"{result.own_crash[:, 0].mean():12.0%}{result.lead.mean():+16.1f} m{ittc:10.2f} s"
        )

    # 4. A tournament of policies and agents. All pairs drive the same races.
    mine = {
        f"caution {c:g}": CAUTIOUS.policy({"pace": arguments.pace, "caution": c})
        for c in (0.0, 0.3, 1.0)
    }
    entrants = {
        **mine,
        "lattice": opponent,
        "never-switch": "never-switch",
        "random-moves": "random-moves",
    }
    tournament = play_tournament(
        track, entrants, config, races_per_pair=arguments.races, seed=arguments.seed
    )
    print(f"\n{tournament}")


if __name__ == "__main__":
    main()
