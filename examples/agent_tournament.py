"""Run a tournament between agents: table, payoff matrix, ratings and equilibrium.

    python examples/agent_tournament.py
    python examples/agent_tournament.py --track Saltmere --rules paper --agents never-switch ppo

Each pair of agents races on both sides of the start grid. A stopped tournament resumes from its
folder.
"""

import argparse
from pathlib import Path

import numpy as np

from pcs_racing import load_track
from pcs_racing_agents import solvers
from pcs_racing_agents.tournament import (
    excess,
    make_executor,
    open_job,
    plan_tournament,
    play_plan,
    rate,
    show_progress,
    tournament_settings,
    tournament_text,
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
    parser.add_argument(
        "--rules", default="contest", help="race rules: paper, contest or a YAML file"
    )
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
        make_executor("threads") as executor,
    ):
        tournament = play_plan(plan, job=job, executor=executor, progress=show_progress())
    print(tournament_text(tournament))
    print("results:", write_results(tournament.races, arguments.out / "results.csv"))

    # 3. Ratings, with intervals by resampling start lines.
    rows = [row for row in tournament.races if row.winner or not row.crash]
    result = [{"ego": 1, "opponent": -1, "": 0}[row.winner] for row in rows]
    lines = [row.race // 2 for row in rows]
    rng = np.random.default_rng(arguments.seed)
    ratings = rate(
        [row.ego for row in rows], [row.opponent for row in rows], result, unit=lines, rng=rng
    )
    print("\nrating (log-odds of winning) and 95 % interval")
    for i in np.argsort(-ratings.strength):
        print(
            f"  {ratings.names[i]:24s} {ratings.strength[i]:+.2f}  [{ratings.low[i]:+.2f},"
            f" {ratings.high[i]:+.2f}]"
        )

    # 4. An equilibrium of the game in which both sides choose an agent.
    weights = solvers.solve_matrix_games(excess(tournament.summary.scores)).rows[0]
    shares = zip(weights, plan.names, strict=True)
    print(
        "\nequilibrium: "
        + ", ".join(f"{weight:.2f} {name}" for weight, name in shares if weight > 0.005)
    )


if __name__ == "__main__":
    main()
