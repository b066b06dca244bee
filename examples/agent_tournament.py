"""Run a tournament between agents: scores with intervals, ratings and equilibrium.

    python examples/agent_tournament.py
    python examples/agent_tournament.py --track Saltmere --rules paper --agents never-switch ppo

Each pair of agents races on both sides of the start grid. A stopped tournament resumes from its
folder.
"""

import argparse
from pathlib import Path

from pcs_racing import load_track
from pcs_racing_agents.tournament import (
    make_executor,
    open_job,
    plan_tournament,
    play_plan,
    show_progress,
    tournament_settings,
    write_results,
)

# Agents without training; `pcs-racing agents` lists all agents.
AGENTS = [
    "never-switch",
    "random-moves",
    "always-aggressiveness+",
    "always-restraint+",
    "random-policy",
    "lane-switcher",
]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--rules", default="contest", help="rules: paper, contest or a YAML file")
    parser.add_argument("--archive", default="default", help="archive that the agents move in")
    parser.add_argument(
        "--agents", nargs="+", default=AGENTS, help="names, or name:option=value,..."
    )
    parser.add_argument("--races", type=int, default=60, help="races of each pair, even")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of start lines, start policies and noise"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/agent_tournament"), help="folder of the results"
    )
    arguments = parser.parse_args()

    # 1. The plan: all input is checked before the first race.
    plan = plan_tournament(
        load_track(arguments.track),
        arguments.agents,
        arguments.rules,
        archive=arguments.archive,
        races_per_pair=arguments.races,
        seed=arguments.seed,
    )

    # 2. The races. The folder saves them, and refuses races of other settings.
    with (
        open_job(arguments.out, "tournament", tournament_settings(plan)) as job,
        make_executor() as executor,
    ):
        tournament = play_plan(plan, job=job, executor=executor, progress=show_progress())
    print(tournament)
    print("results:", write_results(tournament.races, arguments.out / "results.csv"))


if __name__ == "__main__":
    main()
