"""Make a small version of the paper's table: agents on train and test tracks.

    python examples/paper_table.py
    python examples/paper_table.py --egos 20 --variants 20 --lines 5  # 4,000 races a cell

All agents of a row drive the same races and are compared with the first agent; the intervals take
into account that races share ego policies, opponents and start lines. The shipped agents were
trained on Tarnfjord, not on Brackwater. ``pcs-racing study paper`` makes the whole table, with more
agents, opponents and tracks.
"""

import argparse
from pathlib import Path

from pcs_racing import make_game
from pcs_racing_agents import make, study
from pcs_racing_agents.tournament import (
    concatenate_races,
    cross_pairing,
    open_job,
    play_pairings,
    show_progress,
)

TRACKS = ["Tarnfjord", "Brackwater"]
TRAIN_TRACKS = {"Tarnfjord"}
# the paper's non-GT agent, random agent and held-out planner
OPPONENTS = ["never-switch", "random-policy", "lane-switcher:any"]
# cfr-argmax is the paper's game-theoretic agent
AGENTS = ["never-switch", "best-fixed", "cfr-argmax", "response"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tracks", nargs="+", default=TRACKS, help="names of shipped tracks or map folders"
    )
    parser.add_argument(
        "--agents", nargs="+", default=AGENTS, help="agents; the first one is the baseline"
    )
    parser.add_argument("--egos", type=int, default=6, help="start policies of the agents")
    parser.add_argument("--variants", type=int, default=6, help="variants of each opponent")
    parser.add_argument(
        "--lines", type=int, default=2, help="start lines of each pair, each on both sides"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of start policies, variants, lines and noise"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/paper_table"), help="folder of races and table"
    )
    arguments = parser.parse_args()

    # 1. The races of each agent against each opponent. Finished races are read from the folder.
    size = {"egos": arguments.egos, "opponents": arguments.variants, "lines": arguments.lines}
    games = {name: make_game(name, stay=True) for name in arguments.tracks}
    agents = {name: make(name) for name in {*arguments.agents, *OPPONENTS}}
    pairings = [
        cross_pairing(game, agents[agent], agents[opponent], **size, seed=arguments.seed + number)
        for game in games.values()
        for number, opponent in enumerate(OPPONENTS)
        for agent in arguments.agents
    ]
    with open_job(arguments.out / "races", "paper-table", {**size, "seed": arguments.seed}) as job:
        races = concatenate_races(play_pairings(pairings, job=job, progress=show_progress()))

    # 2. The table: differences from the first agent, race by race, and the results of the paper.
    table = study.make_table(races, train=TRAIN_TRACKS)
    print(study.table_text(table))
    print("table:", study.write_table(table, arguments.out / "table.csv"))


if __name__ == "__main__":
    main()
