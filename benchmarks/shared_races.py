"""How many times as fast the races of several agents are if what they have in common is driven once.

    python benchmarks/shared_races.py [--track NAME_OR_FOLDER] [--lines 2] [--only paper contest]

The agents drive the same races against one opponent: 10 start policies, 10 variants of the opponent, some lines, both
sides. Processor time of one thread, each agent alone and all together; the results are compared.
"""

import argparse
import time

import numpy as np

from pcs_racing import load_archive, load_game_config, load_track
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.setting import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.tournament.pairings import cross_pairing

# The arms of the studies' first tables.
BLIND = ("never-switch", "best-fixed", "best-schedule", "best-lead-plan")
AGENTS = {
    "paper": (*BLIND, "always-aggressiveness+", "cfr-argmax", "response"),
    "contest": (*BLIND, "response", "cfr-argmax", "robust", "psro", "self-play"),
}
OPPONENTS = ("never-switch", "random-moves", "lane-switcher")
ARCHIVES = {"paper": "default", "contest": "contest"}


def same(first: Arrays, second: Arrays) -> bool:
    """Whether two batches of games have the same results, to the last bit."""
    return all(np.array_equal(first[name], second[name]) for name in first)


def shared(preset: str, track: str, lines: int) -> tuple[float, float]:
    """Processor time of the races of all agents one after the other, and together, s; all results are compared."""
    archive, rules = load_archive(ARCHIVES[preset]), load_game_config(preset)
    setting = make_setting(archive, rules)
    game = RaceGame(load_track(track), archive, rules, threads=1)
    agents = [build(name, setting) for name in AGENTS[preset]]
    spent = np.zeros(2)
    for name in OPPONENTS:
        races = cross_pairing(game, agents[0], build(name, setting), egos=10, opponents=10, lines=lines)
        races.take(range(4)).race(agents)  # compiles
        start = time.process_time()
        alone = [part for agent in agents for part in races.race([agent])]
        between = time.process_time()
        together = races.race(agents)
        spent += between - start, time.process_time() - between
        if not all(map(same, alone, together)):
            raise SystemExit(f"{preset}, against {name}: the results differ")
    return float(spent[0]), float(spent[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit")
    parser.add_argument("--lines", type=int, default=2, help="start lines of each pair of policies")
    parser.add_argument("--only", nargs="+", choices=AGENTS, default=list(AGENTS), help="rules (default: all)")
    given = parser.parse_args()
    for preset in given.only:
        agents = len(AGENTS[preset])
        races = agents * len(OPPONENTS) * 200 * given.lines
        alone, together = shared(preset, given.track, given.lines)
        print(
            f"{preset}: {races} races of {agents} agents, {alone:.1f} s one after the other, {together:.1f} s "
            f"together: {alone / together:.2f} times as fast, the same results"
        )


if __name__ == "__main__":
    main()
