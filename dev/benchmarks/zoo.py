"""Measure the strength of every agent of the zoo, and the cost of a decision.

    python dev/benchmarks/zoo.py                     # measures and prints
    python dev/benchmarks/zoo.py --write             # and writes data/measured.csv

Every agent with its defaults, and three planners, race six others on a training track and on a test
track, with the archive "default" in the paper's race and with the archive "contest" in the contest.
All drive the same races. Races in --out of an earlier call are not driven again, unless an agent
has changed.
"""

import argparse
import re
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import load_track, make_game, run_races
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.players import ask_moves, competitor
from pcs_racing.game.state import take_games
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.agents import Agent, names
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.describe import Measured
from pcs_racing_agents.base.jobs import open_job, show_progress
from pcs_racing_agents.tournament.pairings import draw_schedule, play_pairings, schedule_pairing
from pcs_racing_agents.tournament.races import concatenate_races, series_of
from pcs_racing_agents.tournament.ratings import round_robin

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
import zoo_page

TRACKS = {"paper": ("Tarnfjord", "Saltmere"), "contest": ("Pipkin", "Saltmere")}
PLANNERS = ("lattice", "lattice:early", "line-ppo")  # planners of the archives
FIELD = (
    "never-switch",
    "random-moves",
    "best-fixed",
    "cfr-argmax",
    "lane-switcher:any",
    "random-policy",
)
SEED = 8_000_000  # other races than in any study


def measure(archive: str, race: str, races: int, out: Path) -> list[Measured]:
    """Everything about the agents of one game."""
    spec = make_game(None, archive, race)
    wanted = dict.fromkeys((*names(archive, race), *PLANNERS, *FIELD))
    agents = {}
    for name in wanted:
        try:
            agents[name] = competitor(name, spec)
        except UnknownNameError as error:
            print(f"not measured: {error}")
    games = [make_game(load_track(track), spec.archive, spec.rules) for track in TRACKS[race]]
    # The same starts and seeds for every agent, so that differences of scores are differences of
    # agents.
    schedules = [draw_schedule(game.track, spec.rules.for_game, races, SEED) for game in games]
    settings = {"archive": spec.archive.content_hash, "race": race, "races": races, "seed": SEED}
    tables = []
    with open_job(out / f"{archive}-{race}", "zoo", settings) as job:
        for name, agent in agents.items():
            pairings = [
                schedule_pairing(game, agent, agents[rival], schedule, SEED)
                for (game, schedule), rival in product(zip(games, schedules, strict=True), FIELD)
                if rival != name
            ]
            told = show_progress(f"races: {name}, {race}")
            # Kept by name: a new agent leaves the races of the others as they are.
            kept = (
                name.replace("+", "-plus")
                if name.endswith("+")
                else f"{name}minus"
                if name.endswith("-")
                else name
            )
            kept = re.sub("[^a-z0-9-]+", "-", kept)
            tables += play_pairings(pairings, name=kept, job=job, progress=told)
    scored = series_of(concatenate_races(tables), spec.rules)
    together = round_robin(list(agents), scored)
    found = []
    for name, agent in agents.items():
        own = concatenate_races(table for table in tables if table[0].ego == name)
        units = series_of(own, spec.rules)
        rivals = np.array(units.agents.words)[units.agents.codes[:, 1]]
        scores = {
            rival: float(units.score[rivals == rival].mean()) for rival in FIELD if rival != name
        }
        found.append(
            Measured(
                archive,
                race,
                name,
                competitor_hash(agent),
                ", ".join(TRACKS[race]),
                len(own),
                float(np.mean(list(scores.values()))),
                *together.rating(name),
                float(own.fault[:, 0].mean()),
                *cost(games[0], agent),
                scores,
            )
        )
    return sorted(found, key=lambda one: -one.score)


def cost(game: Any, agent: Any) -> tuple[float, float]:
    """Microseconds of processor time of a decision: for one observation, and for each of 1,000 at
    once.
    """
    if isinstance(agent, PolicySet):
        # A fixed policy plans within the race: cost of whole races, divided by their plans.
        policies = [agent.policies[i % len(agent.policies)] for i in range(16)]
        rules = game.setup.rules
        spent = _seconds(lambda: run_races(game.track, policies, policies[::-1], rules, threads=1))
        return 1e6 * spent / (2 * len(policies) * rules.seconds / 0.1), np.nan
    state = game.reset(games=500, seed=0)
    state = game.step(state, np.tile([0, 2], (500, 1)))
    rows = game.observation(state).reshape(1000, -1)
    if isinstance(agent, Agent):
        one, many = (
            _seconds(lambda seen=seen: agent.act(seen)) / len(seen) for seen in (rows[:1], rows)
        )
        return 1e6 * one, 1e6 * many
    # Agents that simulate take milliseconds for a decision: a thousand games would take minutes.
    few = take_games(state, np.arange(10))
    return 1e6 * _seconds(lambda: ask_moves(agent, game, few, 0)) / len(few.step), np.nan


def _seconds(work: Callable[[], Any], enough: float = 0.05) -> float:
    """Processor seconds of a call, the mean of so many seconds of calls after a first one."""
    work()
    begin, calls = time.process_time(), 0
    while time.process_time() - begin < enough:
        work()
        calls += 1
    return (time.process_time() - begin) / calls


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--races", type=int, default=30, help="races against each of six opponents on each circuit"
    )
    parser.add_argument("--out", type=Path, default=Path("out/zoo"), help="folder of the races")
    parser.add_argument(
        "--write",
        action="store_true",
        help="write measured.csv of this checkout, the source of the page of the zoo",
    )
    arguments = parser.parse_args()
    found = []
    for archive, race in zoo_page.SHIPPED_GAMES:
        found += measure(archive, race, arguments.races, arguments.out)
    for one in found:
        print(
            f"{one.rules:8s} {one.agent:24s} {one.score:.3f} {one.rating:+5.0f} {one.one_us:8.1f}"
            f" us {one.sha256[:12]}"
        )
    if arguments.write:
        print(zoo_page.write_measurements(found))


if __name__ == "__main__":
    main()
