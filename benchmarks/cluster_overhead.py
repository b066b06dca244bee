"""What a task of each kind costs, what a cluster adds to it, and what more nodes would do for a study.

python benchmarks/cluster_overhead.py
python benchmarks/cluster_overhead.py --study paper --serial 20

Tasks are measured in processor seconds of one thread, so that other work on the machine hardly matters. The overhead is
what this process, the scheduler in it included, spends on a task that does nothing. Tasks are counted from the study's
configuration; those that can run at the same time are one wave. What a configuration does not say (how many policies
are measured, how long a network learns, how many plans are tried) is taken from what is shipped.
"""

import argparse
import pickle
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, comb
from typing import Any, NamedTuple

import numpy as np

from pcs_racing import load_archive, make_game
from pcs_racing.game.identity import game_identity
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.fits import load_fit, shipped_fits
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.cli.estimates import LEAD_PLAN_ROUNDS
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.ppo.train import make_task, train_seed
from pcs_racing_agents.learning.responses import learner
from pcs_racing_agents.learning.responses.branches import BLOCK, GameBlock
from pcs_racing_agents.learning.responses.learner import ResponseSettings, load_response_settings
from pcs_racing_agents.networks import Rows, load_network, train_network
from pcs_racing_agents.networks.settings import TrainSettings, load_train_settings
from pcs_racing_agents.study import StudyConfig, load_study_config
from pcs_racing_agents.synthesis.archive_run import draw_policies, stage_scenarios
from pcs_racing_agents.synthesis.archive_search import BLOCK as POLICIES
from pcs_racing_agents.synthesis.config import load_archive_config
from pcs_racing_agents.synthesis.evaluate import race_policies
from pcs_racing_agents.tournament import runner
from pcs_racing_agents.tournament.pairings import cross_pairing
from pcs_racing_agents.trees.storage import _build, _TreeTask

CIRCUITS = ("Tarnfjord", "Vellindra", "Kestrelheim")
ROWS = 20_000  # that a network learns from, for the time of a row


class Cost(NamedTuple):
    """What a task costs: processor seconds, bytes sent with it, sent once with the function, and returned."""

    seconds: float
    sent: int
    once: int
    returned: int


class Wave(NamedTuple):
    """Tasks that can run at the same time: so many of a kind, each so many times as long as the one measured."""

    kind: str
    tasks: int
    times: float = 1.0


# What a task costs


def size(value: Any) -> int:
    """Bytes of what a task returned."""
    if isinstance(value, Mapping):
        return sum(size(item) for item in value.values())
    return int(np.asarray(value).nbytes) if isinstance(value, np.ndarray | np.generic) else len(pickle.dumps(value))


def cost(function: Callable[[Any], Any], tasks: Sequence[Any], *, loaded: bool = False) -> tuple[Cost, Any]:
    """Do some tasks of a kind; the first is done twice, the first time to load and compile what it needs."""
    if not loaded:
        function(tasks[0])
    begin = time.process_time()
    results = [function(task) for task in tasks]
    seconds = (time.process_time() - begin) / len(tasks)
    return Cost(seconds, len(pickle.dumps(tasks[0])), len(pickle.dumps(function)), size(results[0])), results[0]


def measure(moves: int) -> dict[str, Cost]:
    """Measure one task of every kind, of the sizes that the paper's study has."""
    found: dict[str, Cost] = {}
    print("task of        processor     sent with it     sent once      returned")

    def keep(kind: str, function: Callable[[Any], Any], tasks: Sequence[Any], *, loaded: bool = False) -> Any:
        found[kind], result = cost(function, tasks, loaded=loaded)
        seconds, sent, once, returned = found[kind]
        print(f"{kind:14} {seconds:8.2f} s  {sent:11,} B  {once:11,} B  {returned:11,} B", flush=True)
        return result

    stages = zip(("search", "choice", "measurement"), stage_scenarios(load_archive_config("default")), strict=True)
    policies = draw_policies(get_planner("lattice"), POLICIES, np.random.SeedSequence(0))
    for kind, scenarios in stages:
        keep(kind, partial(race_policies, threads=1), [(scenarios, policies)], loaded=kind != "search")

    games = [replace(make_game(track), threads=1) for track in CIRCUITS]
    game, setting = games[0], make_setting(games[0].archive, games[0].config)
    ego, never, random = (build(name, setting) for name in ("cfr-argmax", "never-switch", "random-moves"))
    pairing = cross_pairing(game, ego, never, lines=1)
    keep("games", runner.RaceWorker([pairing], False), [runner.RaceBlock("", 0, 0, runner.BLOCK)])

    pool = [never, random, build("lane-switcher", setting)]
    arenas = [[learner.game_between(game, random, opponent) for opponent in pool] for game in games]
    branch = partial(learner._branch, arenas, pool, [random], random, "win", len(setting.moves) - 1)
    steps = range(game.config.moves)
    keep("branch", branch, [GameBlock((0, 0, step, 0), 0, BLOCK, 1) for step in steps])

    tree_game = replace(make_game("Tarnfjord", moves=moves, stay=False), threads=1)
    small = replace(make_game("Tarnfjord", moves=1, stay=False), threads=1)
    _build(small, _TreeTask((0, 1), 0, 1, 0))  # loads the code
    keep("tree", partial(_build, tree_game), [_TreeTask((10, 20), 0, 1, 0)], loaded=True)

    rng = np.random.default_rng(0)
    shape = ROWS, len(game.observation_elements), len(game.move_names)
    rows = Rows(
        rng.random(shape[:2]),
        rng.normal(size=(ROWS, shape[2])),
        np.ones(ROWS),
        np.arange(ROWS) % 40,
        np.zeros(ROWS, int),
    )
    keep("learning", _Learn(rows, tree_game), [load_train_settings("study", epochs=4, patience=4)])

    ppo = load_ppo_settings("study-paper")
    rollout = ppo.envs * ppo.rollout * len(ppo.tracks)
    one, three = (
        cost(partial(train_seed, make_task(replace(ppo, steps=steps, evaluate_every=10**12)), None), [0])[0]
        for steps in (1, int(2.5 * rollout))
    )
    # Both are evaluated before the first update and after the last one.
    found["update"] = one._replace(seconds=(three.seconds - one.seconds) / 2)
    found["evaluation"] = one._replace(seconds=(one.seconds - found["update"].seconds) / 2)
    for kind in ("update", "evaluation"):
        print(f"{kind:14} {found[kind].seconds:8.2f} s  (a part of the training with a seed)", flush=True)
    return found


@dataclass(frozen=True, eq=False)
class _Learn:
    rows: Rows
    game: Any

    def __call__(self, settings: TrainSettings) -> Any:
        return train_network(self.rows, game_identity(self.game), settings, name="x")[0].layers


# What a cluster adds


@dataclass(frozen=True)
class Nothing:
    """A task that does nothing, of some bytes; known by its number."""

    content_hash: str
    load: bytes


def nothing(task: Nothing) -> dict[str, int]:
    """Do nothing."""
    return {"task": len(task.load)}


def overhead(kind: str, tasks: int, load: int) -> float:
    """Processor seconds that this process spends on a task of some bytes that does nothing, its chunk included."""
    with (
        tempfile.TemporaryDirectory() as folder,
        make_executor(kind, 2) as executor,
        open_job(folder, "overhead", {}) as job,
    ):
        job.run("warm", nothing, [Nothing(f"{i}", b"") for i in range(20)], executor=executor)
        made = [Nothing(f"{i}", np.random.default_rng(i).bytes(load)) for i in range(tasks)]
        begin = time.process_time()
        job.run("measured", nothing, made, executor=executor, keep=False)
        return (time.process_time() - begin) / tasks


# What a study is made of


def waves(config: StudyConfig, found: Mapping[str, Cost]) -> dict[str, list[Wave]]:
    """Return the waves of every stage; each waits for the one before."""
    circuits, moves = len(config.circuits), config.moves
    stages: dict[str, list[Wave]] = {"archive": _synthesis(config)}
    forest = [Wave("tree", circuits * config.pairs, config.seeds)] if config.pairs else []
    stages["trees"] = forest
    network = load_network("default-paper-regret").training
    training = load_train_settings(config.training)
    rows = int(network["rows"]) * circuits * config.pairs * config.seeds / int(network["trees"])
    drawn = min(rows, training.rows_per_epoch) * int(network["epochs"])
    stages["networks"] = [Wave("learning", len(config.targets), drawn / (4 * ROWS))] if forest else []
    each = Wave("games", 1, config.fitting_games / runner.BLOCK)
    places = circuits * len(config.fitting_opponents)
    tried = int(load_fit(shipped_fits() / "default-paper-best-schedule.yaml").training["candidates"])
    plans = [moves + 1] + [moves * moves] * ceil((tried - moves - 1) / (moves * moves))
    lead_plans = [config.fixed_targets, *[2 * config.fixed_targets - 2] * LEAD_PLAN_ROUNDS]
    stages["blind"] = [each._replace(tasks=places * count) for count in (config.fixed_targets, *plans, *lead_plans)]
    pool = len(config.response_pool)
    stages["responses"] = [
        wave for name in config.responses for wave in _response(config, load_response_settings(name), pool)
    ]
    stages["ppo"] = []
    if config.ppo is not None:
        ppo = load_ppo_settings(config.ppo)
        updates = ppo.steps / (ppo.envs * ppo.rollout * circuits)
        judged = 1 + ppo.steps // ppo.evaluate_every
        stages["ppo"] = [Wave("update", len(ppo.seeds), updates), Wave("evaluation", len(ppo.seeds), judged)]
    races = 2 * config.egos * config.variants
    cells = [(len(t) * len(o) * len(a), races * lines) for t, o, a, lines in config.tables.values()]
    stages["races"] = [Wave("games", sum(count * ceil(games / runner.BLOCK) for count, games in cells))]
    pairs = comb(len(config.rated), 2)
    again = Wave("games", pairs, config.rating_races / runner.BLOCK)
    stages["ratings"] = [again._replace(tasks=pairs * n) for n in (len(config.tracks), circuits)] if pairs else []
    reply = [*_response(config, load_response_settings(config.reply), 1), each._replace(times=1.0)]
    stages["best-replies"] = reply * len(config.replies)
    main = len(config.tracks) * len(config.opponents) * 2 * ceil(1000 / runner.BLOCK)
    stages["report"] = [Wave("games", main, 1)]
    return stages


def _synthesis(config: StudyConfig) -> list[Wave]:
    if config.synthesis is None:
        return []
    search = load_archive_config(config.synthesis)
    notes = load_archive("default").settings
    measured = int(notes["policies"]) + int(notes["measurement_over_crash_limit"]) + int(notes["measurement_beaten"])
    return [
        Wave("search", ceil(search.scouts / POLICIES)),
        *[Wave("search", ceil(search.population / POLICIES))] * search.generations,
        Wave("choice", ceil(search.candidates / POLICIES)),
        Wave("measurement", ceil(measured / POLICIES)),
    ]


def _response(config: StudyConfig, settings: ResponseSettings, opponents: int) -> list[Wave]:
    about = load_network("default-paper-gain").training
    found = []
    waves = settings.rounds * config.moves
    games = len(config.circuits) * opponents
    for wave in range(1, waves + 1):
        rows = min(50_000, games * settings.starts * wave) * int(about["epochs"])
        members = settings.members if wave == waves else min(settings.members, 2)
        found.append(Wave("branch", games * ceil(settings.starts / BLOCK)))
        found.append(Wave("learning", members, rows / (4 * ROWS)))
    return found


def table(
    stages: Mapping[str, list[Wave]], found: Mapping[str, Cost], added: Mapping[str, float], cores: int, serial: float
) -> None:
    """Print what more and more nodes would do."""
    nodes = (1, 4, 32, 1000)
    print(f"\nnodes of {cores} cores; times in s\n")
    print(f"{'stage':15}{'tasks':>7}{'waves':>7}{'largest':>9}{'one core':>10}" + "".join(f"{n:>9}" for n in nodes))
    totals, rest = np.zeros((2, len(nodes) + 1))

    def took(wave: Wave, workers: int) -> float:
        # As long as a worker's share of it, or as the scheduler needs.
        seconds, more = found[wave.kind].seconds * wave.times, added[wave.kind]
        return max(ceil(wave.tasks / workers) * (seconds + more), wave.tasks * more)

    for stage, made in stages.items():
        alone = serial if stage == "report" else 0.0
        row = np.array([sum(wave.tasks * wave.times * found[wave.kind].seconds for wave in made) + alone])
        row = np.append(row, [sum(took(wave, n * cores) for wave in made) + alone for n in nodes])
        totals += row
        rest += row if stage != "ppo" else 0.0
        tasks = [wave.tasks for wave in made]
        print(f"{stage:15}{sum(tasks):>7}{len(tasks):>7}{max(tasks, default=0):>9}{row[0]:>10.0f}"
              + "".join(f"{value:>9.1f}" for value in row[1:]))  # fmt: skip
    print(f"{'all':38}{totals[0]:>10.0f}" + "".join(f"{value:>9.1f}" for value in totals[1:]))
    print(f"{'times as fast as one core':48}" + "".join(f"{totals[0] / value:>9.1f}" for value in totals[1:]))
    if stages["ppo"]:
        print(f"{'without ppo':48}" + "".join(f"{rest[0] / value:>9.1f}" for value in rest[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", nargs="+", default=[], metavar="NAME", help="configurations, for the table")
    parser.add_argument(
        "--serial", type=float, default=0.0, metavar="S", help="of the report in one process (default: 0)"
    )
    parser.add_argument("--cores", type=int, default=16, help="of a node (default: 16)")
    parser.add_argument("--tasks", type=int, default=300, help="that do nothing, for the overhead (default: 300)")
    parser.add_argument("--moves", type=int, default=4, help="of the tree (default: 4)")
    arguments = parser.parse_args()
    found = measure(arguments.moves)
    large = 400_000
    for kind in ("serial", "threads", "processes", "dask"):
        least, most = (overhead(kind, arguments.tasks, load) for load in (0, large))
        print(f"{kind:12} {1e3 * least:8.2f} ms a task that does nothing, {1e3 * most:.2f} ms one of {large:,} B")
    added = {kind: least + (most - least) * one.sent / large for kind, one in found.items()}
    for kind, one in found.items():
        print(f"one scheduler keeps {one.seconds / added[kind]:.0f} workers busy with tasks of the kind {kind}")
    for name in arguments.study:
        config = load_study_config(name)
        print(f"\n{name}:", end="")
        table(waves(config, found), found, added, arguments.cores, arguments.serial)


if __name__ == "__main__":
    main()
