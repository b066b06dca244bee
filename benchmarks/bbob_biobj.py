"""COCO's bi-objective functions: five optimisers, the same small budget, COCO's own hypervolume indicator.

    python benchmarks/bbob_biobj.py                                             # a few minutes on two cores
    python benchmarks/bbob_biobj.py --dimensions 2 3 5 10 20 --instances 1-5    # more of it

Protocol: suite ``bbob-biobj`` (D. Brockhoff and others, Using well-understood single-objective functions in
multiobjective black-box optimization test suites, 2022), 55 functions, dimensions 2, 5 and 10, instances 1 to 3, budget
100 times the dimension. Every method is given the box [-5, 5] in every dimension, generations of 20, and a seed that
depends on the problem. Nobody is given COCO's ideal and nadir points, known optima or starting points, and nobody
starts in the middle of the box, where the suite's optima gather. Otherwise the methods' options are their defaults.

The score is COCO's. Its observer keeps an archive of everything evaluated, normalises it by the problem's ideal and
nadir, and compares its hypervolume with the best known one: the precision is what is missing. Where no point dominates
the nadir it is the best known hypervolume and the distance from the nadir together. A problem counts by the share of
the 58 targets of the COCO platform, precisions from -1e-4 to 1, that were reached: within the budget, and on average
over it (the area under the runtime profile, evaluations on a linear scale).
"""

import argparse
import re
import shutil
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from adapters.foreign_optimisers import ALL, FOREIGN
from numpy.typing import NDArray

from pcs_racing_agents.synthesis.search import Search

Floats = NDArray[np.float64]

POPULATION = 20
BOX = 5.0
TARGETS = np.concatenate(
    [-(10.0 ** np.arange(-4.0, -5.01, -0.2)), [0.0], 10.0 ** np.arange(-5.0, 0.01, 0.1)]
)  # of cocopp, bi-objective


class Task(NamedTuple):
    """One method on all functions and instances of one dimension."""

    method: str
    dimension: int
    instances: str
    budget: int


class Outcome(NamedTuple):
    """Results on P problems: precision at the end, whether the nadir was dominated, when each target was reached."""

    precision: Floats
    dominated: NDArray[np.bool_]
    reached: Floats


def run(task: Task) -> Outcome:
    """Run a method and read COCO's log."""
    import cocoex

    cocoex.log_level("warning")
    suite = cocoex.Suite("bbob-biobj", f"instances: {task.instances}", f"dimensions: {task.dimension}")
    folder = Path(tempfile.mkdtemp(prefix="bbob-biobj-"))
    observer = cocoex.Observer("bbob-biobj", f"outer_folder: {folder} result_folder: log log_nondominated: none")
    budget = task.budget * task.dimension
    for index, problem in enumerate(suite):
        problem.observe_with(observer)
        box = np.tile([-BOX, BOX], (problem.dimension, 1))
        search = Search(
            box, method=FOREIGN.get(task.method, task.method), population=POPULATION, seed=index, start="sample"
        )
        while problem.evaluations < budget:
            points = search.ask()
            search.tell([-np.asarray(problem(point)) for point in points])
        problem.free()
    found = read_log(folder)
    shutil.rmtree(folder)
    return found


def read_log(folder: Path) -> Outcome:
    """Read what the observer wrote: for every problem its precision whenever that improved."""
    precision, dominated, reached = [], [], []
    for file in sorted(folder.rglob("*_hyp.dat")):
        for block in re.split(r"(?m)^% index = .*$", file.read_text())[1:]:
            best = re.search(r"reference value = (\S+)", block)
            assert best is not None
            lines = [line.split() for line in block.splitlines() if line.strip() and not line.startswith("%")]
            course = np.array(lines, np.float64)
            precision.append(course[-1, 1])
            dominated.append(course[-1, 1] < float(best[1]))
            hit = course[None, :, 1] <= TARGETS[:, None]
            reached.append(np.where(hit.any(axis=1), course[np.argmax(hit, axis=1), 0], np.inf))
    return Outcome(np.array(precision), np.array(dominated), np.array(reached))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dimensions", type=int, nargs="+", default=[2, 5, 10])
    parser.add_argument("--instances", default="1-3")
    parser.add_argument("--budget", type=int, default=100, help="evaluations by dimension (default: 100)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--methods", nargs="+", default=list(ALL), choices=ALL)
    arguments = parser.parse_args()
    tasks = [
        Task(method, dimension, arguments.instances, arguments.budget)
        for dimension in sorted(arguments.dimensions, reverse=True)  # the long ones first
        for method in arguments.methods
    ]
    with ProcessPoolExecutor(arguments.workers) as executor:
        found = dict(zip(tasks, executor.map(run, tasks), strict=True))

    def of(method: str, dimension: int) -> Outcome:
        return found[Task(method, dimension, arguments.instances, arguments.budget)]

    problems = sum(len(of(arguments.methods[0], dimension).precision) for dimension in arguments.dimensions)
    print(f"{problems} problems, instances {arguments.instances}, budget {arguments.budget} x dimension\n")
    columns = " | ".join(f"dimension {dimension}" for dimension in arguments.dimensions)
    bars = "|---" * (len(arguments.dimensions) + 1) + "|"
    for title, value in (
        ("Share of the 58 targets reached within the budget", lambda o, b: np.isfinite(o.reached).mean()),
        ("The same on average over the budget", lambda o, b: np.maximum(1.0 - o.reached / b, 0.0).mean()),
        ("Median precision at the end", lambda o, b: np.median(o.precision)),
        ("Share of the problems whose nadir was dominated", lambda o, b: o.dominated.mean()),
    ):
        print(f"{title}:\n\n| method | {columns} |\n{bars}")
        for method in arguments.methods:
            cells = [
                f"{value(of(method, dimension), arguments.budget * dimension):.3f}"
                for dimension in arguments.dimensions
            ]
            print(f"| `{method}` | " + " | ".join(cells) + " |")
        print()
    if {"mo-cma-es", "random"} <= set(arguments.methods):
        print("Share of the problems on which `mo-cma-es` ended with a better precision:\n")
        print(f"| than | {columns} |\n{bars}")
        for method in arguments.methods:
            if method != "mo-cma-es":
                cells = [
                    f"{np.mean(of('mo-cma-es', d).precision < of(method, d).precision):.2f}"
                    for d in arguments.dimensions
                ]
                print(f"| `{method}` | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
