"""The paper's table in small: circuits seen and unseen, three kinds of opponents, and what
switching brings.

    python examples/paper_table.py
    python examples/paper_table.py --egos 20 --variants 20 --lines 5  # 4,000 races a cell

Every agent drives the same races of a row, so that their differences can be told from luck; the
intervals know that races share ego policies, opponents and start lines. The shipped agents learned
on Tarnfjord, none on Brackwater. `pcs-racing study paper` does all of it from nothing, with more
agents, opponents and circuits.
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
SEEN = {"Tarnfjord"}
# the paper's non-GT, random and unseen ones
OPPONENTS = ["never-switch", "random-policy", "lane-switcher"]
# cfr-argmax is the paper's game-theoretic agent
ARMS = ["never-switch", "best-fixed", "cfr-argmax", "response"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tracks", nargs="+", default=TRACKS, help="names of shipped circuits or map folders"
    )
    parser.add_argument(
        "--arms", nargs="+", default=ARMS, help="agents to compare with the first of them"
    )
    parser.add_argument("--egos", type=int, default=6, help="start policies of the agents")
    parser.add_argument("--variants", type=int, default=6, help="variants of each kind of opponent")
    parser.add_argument(
        "--lines", type=int, default=2, help="start lines of each pair; each from both sides"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="root of start policies, variants, lines and noise"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/paper_table"), help="folder for races and table"
    )
    arguments = parser.parse_args()

    # 1. The races of each agent against each kind of opponent. What was driven before is read from
    # the folder.
    size = {"egos": arguments.egos, "opponents": arguments.variants, "lines": arguments.lines}
    games = {name: make_game(name, stay=True) for name in arguments.tracks}
    agents = {name: make(name) for name in {*arguments.arms, *OPPONENTS}}
    pairings = [
        cross_pairing(game, agents[arm], agents[opponent], **size, seed=arguments.seed + number)
        for game in games.values()
        for number, opponent in enumerate(OPPONENTS)
        for arm in arguments.arms
    ]
    with open_job(arguments.out / "races", "paper-table", {**size, "seed": arguments.seed}) as job:
        races = concatenate_races(play_pairings(pairings, job=job, progress=show_progress()))

    # 2. The table: each agent minus the first, race by race; beside it what the paper found.
    table = study.make_table(races, seen=SEEN)
    print(study.table_text(table))
    print("table:", study.write_table(table, arguments.out / "table.csv"))


if __name__ == "__main__":
    main()
