"""Processor time of a race of each planner, and of the parts of the study."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.config import CONTEST
from pcs_racing.race.races import run_races
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.tables import read_csv
from studies.field.entrants import AGENTS, POOL, Entrant, Size, tunable, tuning_races
from studies.field.races import ARCHIVE, OPPONENTS

REPEATS, RACES = 3, 2


def race_cost(policy: Policy) -> float:
    """Return milliseconds of one core for 40 s of a race of a policy against itself on Pipkin."""
    track = load_track("Pipkin")
    times = []
    for seed in range(REPEATS + 1):  # the first call compiles
        begun = time.process_time()
        result = run_races(track, [policy] * RACES, policy, CONTEST, seed=seed, threads=1)
        times.append((time.process_time() - begun) * 4e6 / float(result.state.tick.sum()))
    return min(times[1:])


def measure_costs(size: Size, entrants: Sequence[Entrant]) -> dict[str, float]:
    """Return the cost of a race for each planner of the study, ms."""
    texts = [one.text for one in entrants if one.kind == "default"]
    names = dict.fromkeys((*texts, *tunable(size), *POOL, *OPPONENTS))
    return {name: race_cost(parse_policy(name)) for name in names}


def minutes(
    costs: Mapping[str, float], size: Size, entrants: Sequence[Entrant], circuits: int
) -> dict[str, float]:
    """Return the estimated minutes of each part on one core: half of a race's cost for each car."""
    pool = sum(costs[name] for name in POOL) / len(POOL)
    opponents = sum(costs[name] for name in OPPONENTS) / len(OPPONENTS)
    agent = costs[load_archive(ARCHIVE).planner]
    search = sum(costs[name] + pool for name in tunable(size)) * tuning_races(size)
    found = {"tune": search}
    for rules, races in size.races.items():
        total = 0.0
        for one in entrants:
            count = 1 + (one.name in tunable(size))  # a default and a tuned policy
            total += count * races * (costs[one.text] + opponents)
        if rules == "contest":
            total += len(AGENTS) * ((agent + opponents) * races + 2.0 * agent * size.title / 5)
        found[rules] = total * (len(OPPONENTS) + 1) * circuits
    return {part: 0.5 * total / 60_000.0 for part, total in found.items()}


def read_costs(file: Path) -> dict[str, float]:
    """Return the costs of a file, ms by planner; nothing without the file."""
    if not file.is_file():
        return {}
    return {row["planner"]: float(row["ms"]) for row in read_csv(file).rows()}
