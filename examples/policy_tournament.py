"""Run a tournament between four policies of the lattice planner.

    python examples/policy_tournament.py
    python examples/policy_tournament.py --track Brackwater --rules paper --races 100

It prints a table and the payoff matrix, and writes the results and a replay of the race with the
most overtakes.
"""

import argparse
from pathlib import Path

from pcs_racing import load_rules, load_track, save_replay
from pcs_racing.planners import Policy, get_planner
from pcs_racing_agents.tournament import (
    RaceRow,
    play_tournament,
    show_progress,
    write_results,
)


def policies() -> list[Policy]:
    """Return four policies of the lattice planner; other parameters have their defaults."""
    lattice = get_planner("lattice")
    return [
        lattice.policy({"pace": 0.1, "side_margin": 0.3, "walls": 0.5}, name="careful"),
        lattice.policy({"pace": 0.45}, name="steady"),
        lattice.policy(
            {"pace": 0.65, "overtaking": 0.7, "attack": 0.18, "side_margin": 0.25}, name="attacker"
        ),
        lattice.policy({"pace": 1.0, "walls": -1.5}, name="reckless"),
    ]


def main() -> None:
    arguments = parse()
    track = load_track(arguments.track)
    config = load_rules(arguments.rules, duration=arguments.duration)
    tournament = play_tournament(
        track,
        policies(),
        config,
        races_per_pair=arguments.races,
        seed=arguments.seed,
        progress=show_progress(),
    )
    print(tournament)

    arguments.out.mkdir(parents=True, exist_ok=True)
    print("\nresults:", write_results(tournament.races, arguments.out / "results.csv"))
    replay = tournament.record(max(tournament.races, key=liveliness)).replay
    print(
        "replay: ",
        save_replay(replay, arguments.out / "replay.html"),
        f"({replay.title}: {replay.outcome})",
    )


def liveliness(row: RaceRow) -> tuple[int, bool, float]:
    """Return overtakes, finish and closeness of a race, to sort by."""
    return row.ego_overtakes + row.opponent_overtakes, row.crash == "none", -abs(row.lead)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--track", default="Tarnfjord", help="name of a shipped track or a map folder")
    option("--rules", default="contest", help="rules: paper, contest or a YAML file")
    option("--races", type=int, default=60, help="races of each pair, even")
    option("--duration", type=float, default=40.0, help="length of a race in s")
    option("--seed", type=int, default=0, help="seed of start lines and noise")
    option(
        "--out",
        type=Path,
        default=Path("out/policy_tournament"),
        help="folder of results.csv and replay.html",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
