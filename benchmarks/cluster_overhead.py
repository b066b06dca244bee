"""What a task of each kind costs, what a cluster adds to it, and what more nodes would do for a study.

python benchmarks/cluster_overhead.py
python benchmarks/cluster_overhead.py --study out/paper

Tasks are measured in processor seconds of one thread, so that other work on the machine hardly matters. The overhead is
what this process, the scheduler in it included, spends on a task that does nothing. A study's folder tells how many
tasks there were and which of them could run at the same time: those of one wave. With several folders each stage is
counted where it has most tasks.
"""

import argparse
import pickle
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from pcs_racing import make_game
from pcs_racing_agents.jobs import make_executor, open_job
from pcs_racing_agents.rollouts import learner
from pcs_racing_agents.strategies import make_setting
from pcs_racing_agents.strategies.zoo import build
from pcs_racing_agents.synthesis.archive_run import draw_policies, stage_scenarios
from pcs_racing_agents.synthesis.archive_search import BLOCK
from pcs_racing_agents.synthesis.config import load_archive_config
from pcs_racing_agents.synthesis.evaluate import blocks, race_block
from pcs_racing_agents.tournament import runner
from pcs_racing_agents.tournament.cells import draw_units
from pcs_racing_agents.trees.storage import NAME, _Builder, _Task

CIRCUITS = ("Tarnfjord", "Vellindra", "Kestrelheim")
KINDS = {
    "archive": "evaluation",
    "trees": "tree",
    "networks": None,  # one process
    "blind": "games",
    "responses": "branch",
    "races": "games",
    "rivals": "games",
    "exploitability": "tree",
    "report": None,
}
"""What the tasks of a study's stages are."""


class Cost(NamedTuple):
    """What a task costs: processor seconds, bytes sent with it, sent once with the function, and returned."""

    seconds: float
    sent: int
    once: int
    returned: int


def cost(function: Callable[[Any], Mapping[str, Any]], tasks: Sequence[Any]) -> Cost:
    """Do some tasks of a kind; the first is done twice, the first time to load and compile what it needs."""
    function(tasks[0])
    begin = time.process_time()
    results = [function(task) for task in tasks]
    seconds = (time.process_time() - begin) / len(tasks)
    returned = sum(np.asarray(value).nbytes for value in results[0].values())
    return Cost(seconds, len(pickle.dumps(tasks[0])), len(pickle.dumps(function)), returned)


def measure(moves: int) -> dict[str, Cost]:
    """Measure one task of every kind, of the sizes that the paper's study has."""
    found = {}

    def keep(kind: str, function: Callable[[Any], Mapping[str, Any]], tasks: Sequence[Any]) -> None:
        found[kind] = cost(function, tasks)
        seconds, sent, once, returned = found[kind]
        print(f"{kind:12} {seconds:8.2f} s  {sent:11,} B  {once:11,} B  {returned:11,} B", flush=True)

    print("task of      processor     sent with it     sent once      returned")
    config = load_archive_config("default")
    search = stage_scenarios(config)[0]
    policies = draw_policies(build_family(), BLOCK, np.random.SeedSequence(0))
    keep("evaluation", partial(race_block, threads=1), blocks(search, policies, BLOCK))

    games = [replace(make_game(track), threads=1) for track in CIRCUITS]
    game, setting = games[0], make_setting(games[0].archive, games[0].config)
    ego, never = build("cfr-argmax", setting), build("never-switch", setting)
    units = draw_units(game, ego, never, lines=1)
    pairing = runner.Pairing(game.track, ego, never, units.variants, units.starts, units.seeds)
    with make_executor("processes", 1) as executor:
        task = runner._task(pairing, np.arange(runner.BLOCK), game.archive, game.config, executor, kept=True)
    keep("games", runner._play, [task])

    random = build("random-moves", setting)
    pool = [never, random, build("lane-switcher", setting)]
    arenas = [[learner.game_between(game, random, opponent) for opponent in pool] for game in games]
    branch = partial(learner._branch, arenas, pool, [random], random, "win", len(setting.moves) - 1)
    keep("branch", branch, [learner.BranchTask(0, 0, 2, 0, 0, learner.BLOCK, 1)])

    tree_game = replace(make_game("Tarnfjord", moves=moves, stay=False), threads=1)
    small = replace(make_game("Tarnfjord", moves=1, stay=False), threads=1)
    _Builder(small)(_Task((0, 1), 0, 1, 0))  # loads the code
    begin = time.process_time()
    arrays = _Builder(tree_game)(_Task((10, 20), 0, 1, 0))
    seconds = time.process_time() - begin
    builder = _Builder(tree_game)
    sizes = len(pickle.dumps(_Task((10, 20), 0, 1, 0))), len(pickle.dumps(builder))
    found["tree"] = Cost(seconds, *sizes, sum(array.nbytes for array in arrays.values()))
    print(f"{NAME:12} {seconds:8.2f} s  {sizes[0]:11,} B  {sizes[1]:11,} B  {found['tree'].returned:11,} B", flush=True)
    return found


def build_family() -> Any:
    """The planner of the default archive."""
    from pcs_racing.registry import get_planner

    return get_planner("lattice")


def nothing(task: int) -> dict[str, int]:
    """A task that does nothing."""
    return {"task": task}


def overhead(kind: str, tasks: int) -> float:
    """Processor seconds that this process spends on a task that does nothing, its chunk included."""
    with (
        tempfile.TemporaryDirectory() as folder,
        make_executor(kind, 2) as executor,
        open_job(folder, "overhead", {}) as job,
    ):
        job.run("warm", nothing, range(20), executor=executor)
        begin = time.process_time()
        job.run("measured", nothing, range(tasks), executor=executor, keep=False)
        return (time.process_time() - begin) / tasks


def waves(folders: Sequence[Path]) -> tuple[dict[str, list[int]], dict[str, float]]:
    """Return for every stage the number of tasks of its waves, and its seconds where it is one process."""
    found: dict[str, list[int]] = {}
    alone = {}
    for stage, kind in KINDS.items():
        counted = []
        for folder in folders:
            chunks = (folder / stage).rglob("chunks/*.npz")
            names = Counter(re.sub(r"-\d{5}$", "", str(chunk.with_suffix(""))) for chunk in chunks)
            counted.append(list(names.values()))
            done = folder / stage / "done.yaml"
            if kind is None and done.is_file():
                seconds = float(yaml.safe_load(done.read_text())["seconds"])
                alone[stage] = min(seconds, alone.get(stage, seconds))
        found[stage] = max(counted, key=sum)
    return found, alone


def stage_seconds(tasks: Sequence[int], cost: Cost, workers: int, added: float) -> float:
    """How long a stage takes: wave after wave, each as long as a worker's share of it, or as the scheduler needs."""
    return sum(max(ceil(count / workers) * (cost.seconds + added), count * added) for count in tasks)


def table(found: Mapping[str, Cost], folders: Sequence[Path], added: float, cores: int) -> None:
    """Print what one, 32 and 1,000 nodes would do."""
    counted, alone = waves(folders)
    nodes = (1, 32, 1000)
    print(f"\nnodes of {cores} cores, {1e3 * added:.2f} ms of the scheduler's for every task; times in s\n")
    print(f"{'stage':15}{'tasks':>7}{'waves':>7}{'largest':>9}{'one core':>10}" + "".join(f"{n:>9}" for n in nodes))
    totals = np.zeros(len(nodes) + 1)
    for stage, kind in KINDS.items():
        tasks = counted[stage]
        if kind is None:
            row = [alone.get(stage, 0.0)] * (len(nodes) + 1)
        else:
            row = [sum(tasks) * found[kind].seconds]
            row += [stage_seconds(tasks, found[kind], n * cores, added) for n in nodes]
        totals += row
        print(f"{stage:15}{sum(tasks):>7}{len(tasks):>7}{max(tasks, default=0):>9}{row[0]:>10.0f}"
              + "".join(f"{value:>9.1f}" for value in row[1:]))  # fmt: skip
    print(f"{'all':38}{totals[0]:>10.0f}" + "".join(f"{value:>9.1f}" for value in totals[1:]))
    print(f"{'times as fast as one core':48}" + "".join(f"{totals[0] / value:>9.1f}" for value in totals[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", type=Path, nargs="+", help="folders of studies that are done, for the table")
    parser.add_argument("--cores", type=int, default=16, help="of a node (default: 16)")
    parser.add_argument("--tasks", type=int, default=500, help="that do nothing, for the overhead (default: 500)")
    parser.add_argument("--moves", type=int, default=4, help="of the tree (default: 4)")
    arguments = parser.parse_args()
    found = measure(arguments.moves)
    added = {}
    for kind in ("serial", "threads", "processes", "dask"):
        added[kind] = overhead(kind, arguments.tasks)
        print(f"{kind:12} {1e3 * added[kind]:8.2f} ms a task that does nothing", flush=True)
    for kind, one in found.items():
        print(f"one scheduler keeps {one.seconds / added['dask']:.0f} workers busy with tasks of the kind {kind}")
    if arguments.study:
        table(found, arguments.study, added["dask"], arguments.cores)


if __name__ == "__main__":
    main()
