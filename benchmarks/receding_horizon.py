"""What looking ahead brings, and what it costs: the table of docs/reports/receding_horizon.md.

    nice python benchmarks/receding_horizon.py --out out/receding
    python benchmarks/receding_horizon.py --race contest --seconds 8 --starts 5
    python benchmarks/receding_horizon.py --seconds 8 --searches "depth 1, network" "depth 2, network"

Agents race never-switch, random-moves and "always more of the first axis" from the same start lines, start policies and
noise, on four circuits. Time is that of one core. With --out a stopped run goes on where it was.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing import RaceGame, make_game
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.config import load_game_config
from pcs_racing.game.state import GameState
from pcs_racing.race.races import draw_starts
from pcs_racing_agents.agents import Setting, make_setting
from pcs_racing_agents.agents.blind import always, never_switch, random_moves
from pcs_racing_agents.agents.receding_horizon import RecedingHorizon, receding_horizon
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.tournament import play_games

CIRCUITS = ("Kestrelheim", "Pipkin", "Saltmere", "Tarnfjord")
ARCHIVES = {"paper": "default", "contest": "contest"}
RACE_SECONDS = 40.0
SEED = 20

STATIC = {
    "depth 1, rollout": {"depth": 1},
    "depth 2, rollout": {"depth": 2},
    "depth 1, now": {"depth": 1, "leaf": "now"},
    "depth 2, now": {"depth": 2, "leaf": "now"},
    "depth 3, now": {"depth": 3, "leaf": "now"},
    "depth 1, network": {"depth": 1, "leaf": "network"},
    "depth 2, network": {"depth": 2, "leaf": "network"},
}
BOTH = {
    f"equilibrium, {name}": {**STATIC[name], "opponent": "equilibrium", "decision": "sample"}
    for name in ("depth 1, rollout", "depth 1, now", "depth 1, network")
}
SEARCHES: dict[str, dict[str, Any]] = {**STATIC, **BOTH}
LEFT_OUT = {
    ("paper", 4.0): ("depth 3, now",),
    ("paper", 2.0): ("depth 3, now", "equilibrium, depth 1, rollout"),
    ("contest", 8.0): ("depth 2, rollout", "depth 3, now", "depth 2, network", "equilibrium, depth 1, network"),
    ("contest", 4.0): ("depth 2, rollout", "depth 3, now", "equilibrium, depth 1, rollout"),
    ("contest", 2.0): ("depth 2, rollout", "depth 3, now", "equilibrium, depth 1, rollout"),
}
"""Searches that would take most of the time by themselves."""


class Task(NamedTuple):
    """Games of one agent against one opponent on one circuit."""

    race: str
    seconds: float
    circuit: str
    ego: str
    opponent: str
    starts: int


class Timed:
    """A search that counts what it takes."""

    def __init__(self, agent: RecedingHorizon) -> None:
        self.agent, self.name = agent, agent.name
        self.seconds, self.decisions = 0.0, 0

    def decide(self, game: RaceGame, state: GameState, car: int) -> Any:
        """Ask the search."""
        begin = time.process_time()
        moves = self.agent.decide(game, state, car)
        self.seconds += time.process_time() - begin
        self.decisions += state.games
        return moves


def rules(race: str, seconds: float) -> Any:
    return load_game_config(race, step_seconds=seconds, moves=round(RACE_SECONDS / seconds) - 1)


@cache
def arena(race: str, seconds: float, circuit: str) -> RaceGame:
    return replace(make_game(circuit, ARCHIVES[race], rules(race, seconds), stay=True), threads=1)


@cache
def setting_of(race: str, seconds: float) -> Setting:
    return make_setting(ARCHIVES[race], rules(race, seconds))


def agent(name: str, setting: Setting) -> Any:
    if name in SEARCHES:
        return Timed(receding_horizon(setting, **SEARCHES[name]))
    if name in ("never-switch", "random-moves"):
        return {"never-switch": never_switch, "random-moves": random_moves}[name](setting, seed=SEED)
    return always(setting, name.removeprefix("always "))


def play(task: Task) -> dict[str, Any]:
    """Scores of the games, crashes by own fault, and what the decisions took."""
    game, setting = arena(task.race, task.seconds, task.circuit), setting_of(task.race, task.seconds)
    root = SEED + CIRCUITS.index(task.circuit)
    given = {
        "policies": np.random.default_rng(root).integers(0, len(game.archive), (task.starts, 2)),
        "starts": draw_starts(game.track, game.setup.config, task.starts, root),
        "seeds": race_seeds(root, task.starts),
    }
    ego = agent(task.ego, setting)
    if isinstance(ego, Timed):  # compile before anything is timed
        ego.agent.decide(game, game.reset(games=2), 0)
    played = play_games(game, ego, agent(task.opponent, setting), **given)
    time_taken = (ego.seconds, ego.decisions) if isinstance(ego, Timed) else (0.0, 0)
    return {"score": played.score, "fault": played.fault[:, 0], "time": np.array(time_taken, np.float64)}


def tasks_of(race: str, seconds: float, starts: int, wanted: Sequence[str]) -> list[Task]:
    setting = setting_of(race, seconds)
    constant = [f"always {move}" for move in setting.moves[:-1]]
    searches = [name for name in wanted if name not in LEFT_OUT.get((race, seconds), ())]
    try:
        receding_horizon(setting, leaf="network")
    except UnknownNameError as error:
        print(f"{race}, {seconds:g} s: {error}")
        searches = [name for name in searches if "network" not in name]
    except ValueError:  # the shipped networks know games of four moves
        searches = [name for name in searches if "network" not in name]
    return [
        Task(race, seconds, circuit, ego, opponent, starts)
        for ego in ("never-switch", *constant, *searches)
        for opponent in ("never-switch", "random-moves", constant[0])
        for circuit in CIRCUITS
    ]


def table(tasks: list[Task], found: list[dict[str, Any]]) -> str:
    """Rows of the table: scores, differences on the same starts, and time."""
    egos = list(dict.fromkeys(task.ego for task in tasks))
    opponents = list(dict.fromkeys(task.opponent for task in tasks))
    results = dict(zip(tasks, found, strict=True))

    def joined(ego: str, opponent: str, key: str) -> np.ndarray:
        return np.concatenate([results[t][key] for t in tasks if (t.ego, t.opponent) == (ego, opponent)])

    scores = {ego: np.stack([joined(ego, opponent, "score") for opponent in opponents]) for ego in egos}
    best = max((ego for ego in egos if ego.startswith("always")), key=lambda ego: scores[ego].mean())
    head = ["agent", *(f"against {opponent}" for opponent in opponents), "mean", "over never-switch"]
    lines = [[*head, f"over {best}", "own crash", "ms a decision"]]
    lines.append(["---"] * len(lines[0]))
    for ego in egos:
        fault = np.mean([joined(ego, opponent, "fault") for opponent in opponents])
        taken = sum(results[task]["time"] for task in tasks if task.ego == ego)
        differences = []
        for other in ("never-switch", best):
            apart = (scores[ego] - scores[other]).mean(axis=0)  # a start is the unit: it meets all opponents
            error = apart.std(ddof=1) / len(apart) ** 0.5
            differences.append("" if ego == other else f"{apart.mean():+.3f} +- {error:.3f}")
        cost = f"{1e3 * taken[0] / taken[1]:.1f}" if taken[1] else ""
        by_opponent = [f"{row.mean():.3f}" for row in scores[ego]]
        lines.append([f"`{ego}`", *by_opponent, f"{scores[ego].mean():.3f}", *differences, f"{fault:.3f}", cost])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="What looking ahead brings, and what it costs.", allow_abbrev=False)
    parser.add_argument("--race", nargs="+", choices=tuple(ARCHIVES), default=list(ARCHIVES), help="rules")
    parser.add_argument("--seconds", nargs="+", type=float, default=[8.0, 4.0, 2.0], help="between two decisions")
    parser.add_argument("--starts", type=int, default=20, help="on each of four circuits (default: 20)")
    parser.add_argument(
        "--searches", nargs="+", choices=tuple(SEARCHES), default=list(SEARCHES), metavar="NAME",
        help="only these, beside agents that don't search",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="folder that keeps results, to go on with (default: none)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for race in options.race:
            for seconds in options.seconds:
                folder = (options.out or Path(scratch)) / f"{race}-{seconds:g}"
                tasks = tasks_of(race, seconds, options.starts, options.searches)
                about = {"archive": setting_of(race, seconds).archive.content_hash, "tasks": [list(t) for t in tasks]}
                with open_job(folder, "receding-horizon", about) as job:
                    found = job.run("games", partial(play), tasks, progress=show_progress("cells"))
                print(
                    f"\n{race}, {seconds:g} s between decisions, {4 * options.starts} starts\n\n{table(tasks, found)}"
                )


if __name__ == "__main__":
    main()
