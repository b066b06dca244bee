"""Which optimiser finds more of a front? Hypervolume against evaluations, five methods with the same budget.

    python benchmarks/optimisers.py --picture docs/images/optimisers.png    # functions with known fronts
    python benchmarks/optimisers.py --race                                  # the race itself, on one circuit
    python benchmarks/optimisers.py --overhead                              # what an evaluation costs beside the race

Every method is given the bounds, the size of a generation (50) and the seed, and starts from points spread over all
that is within the bounds, not from their middle. None knows the ideal or the nadir point. The share of a front is its
hypervolume by that of the whole Pareto front, both normalised by the true ideal and nadir, reference a tenth below the
nadir: these points serve for scoring only. Under noise (standard deviation a tenth of the true range on every axis) the
*true* values of the archive's points count, and the bias is what their noisy values claim on top of that.

In the race, the front of each run is raced again in held-out scenarios before it is scored, and the range is that of
all fronts of all runs together.
"""

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from adapters.foreign_optimisers import ALL, FOREIGN
from numpy.typing import NDArray

from pcs_racing_agents.synthesis.indicators import hypervolume, non_dominated
from pcs_racing_agents.synthesis.search import Search

Floats = NDArray[np.float64]

REFERENCE = -0.1
POPULATION, GENERATIONS = 50, 40
DIMENSION = 10
NOISE = 0.1
REEVALUATION = 0.2
READINGS: dict[str, dict[str, Any]] = {
    "ours": {},
    'loss="total_hypervolume"': {"loss": "total_hypervolume"},
    'mean="archive"': {"mean": "archive"},
    "both, as the paper says": {"loss": "total_hypervolume", "mean": "archive"},
    "elite_ratio=0.25": {"elite_ratio": 0.25},
    'start="middle"': {"start": "middle"},
}


class Problem(NamedTuple):
    """Two objectives to maximise in the unit cube, and points of their whole Pareto front."""

    evaluate: Callable[[Floats], Floats]
    front: Floats
    noise: float

    def share(self, points: Floats) -> float:
        """Hypervolume of points by that of the whole front."""
        low, extent = self.front.min(axis=0), np.ptp(self.front, axis=0)
        return hypervolume((points - low) / extent, REFERENCE) / hypervolume((self.front - low) / extent, REFERENCE)

    def noisy(self, points: Floats, rng: np.random.Generator) -> Floats:
        """Objectives with noise."""
        return self.evaluate(points) + self.noise * np.ptp(self.front, axis=0) * rng.standard_normal((len(points), 2))


def zdt1(seed: int, noise: float = 0.0) -> Problem:
    """The Pareto set lies on the border (E. Zitzler, K. Deb, L. Thiele, 2000); the same for all seeds."""

    def evaluate(x: Floats) -> Floats:
        g = 1.0 + 9.0 * x[:, 1:].mean(axis=1)
        return -np.column_stack([x[:, 0], g * (1.0 - np.sqrt(x[:, 0] / g))])

    line = np.zeros((2001, DIMENSION))
    line[:, 0] = np.linspace(0.0, 1.0, 2001)
    return Problem(evaluate, evaluate(line), noise)


def ellipsoids(seed: int, noise: float = 0.0) -> Problem:
    """Two ellipsoids of condition 1,000 with the same random axes; centre points and axes depend on the seed."""
    rng = np.random.default_rng([11, seed])
    axes = np.linalg.qr(rng.standard_normal((DIMENSION, DIMENSION)))[0]
    hessian = (axes * 1000.0 ** (np.arange(DIMENSION) / (DIMENSION - 1))) @ axes.T
    centres = rng.uniform(0.15, 0.85, (2, DIMENSION))

    def evaluate(x: Floats) -> Floats:
        return -np.column_stack([np.einsum("ki,ij,kj->k", x - c, hessian, x - c) for c in centres])

    line = centres[0] + np.linspace(0.0, 1.0, 2001)[:, None] * (centres[1] - centres[0])
    return Problem(evaluate, evaluate(line), noise)


PROBLEMS: dict[str, Callable[[int], Problem]] = {
    "ZDT1": zdt1,
    "rotated ellipsoids": ellipsoids,
    "noisy ZDT1": lambda seed: zdt1(seed, NOISE),
    "noisy ellipsoids": lambda seed: ellipsoids(seed, NOISE),
}


class Task(NamedTuple):
    """A run: problem, method, seed, options of the search, share of the generations that evaluate points again."""

    problem: str
    method: str
    seed: int
    options: tuple[tuple[str, Any], ...] = ()
    again: float = 0.0


def run(task: Task) -> Floats:
    """Return the true share after each generation, and last of all the bias of the final front."""
    problem = PROBLEMS[task.problem](task.seed)
    rng = np.random.default_rng([12, task.seed])
    search = new_search(np.tile([0.0, 1.0], (DIMENSION, 1)), task.method, task.seed, POPULATION, **dict(task.options))
    shares = []
    for number in range(GENERATIONS):
        old = number >= GENERATIONS - round(task.again * GENERATIONS)
        asked = search.ask_again() if old else search.ask()
        search.tell(problem.noisy(asked, rng) if problem.noise else problem.evaluate(asked))
        shares.append(problem.share(problem.evaluate(search.archive)))
    return np.array([*shares, problem.share(search.result().objectives) - shares[-1]])


def new_search(bounds: Floats, method: str, seed: int, population: int, **options: Any) -> Search:
    return Search(
        bounds, method=FOREIGN.get(method, method), seed=seed, population=population, **{"start": "sample", **options}
    )


def spread(values: Any) -> str:
    """Median, and the smallest and largest in brackets."""
    low, middle, high = np.quantile(np.asarray(values), (0.0, 0.5, 1.0))
    return f"{middle:.3f} ({low:.3f} to {high:.3f})"


def functions(seeds: int, workers: int, picture: Path | None) -> None:
    """Print the tables of the functions with known fronts, and draw how hypervolume grows."""
    tasks = [Task(problem, method, seed) for problem in PROBLEMS for method in ALL for seed in range(seeds)]
    tasks += [t._replace(again=REEVALUATION) for t in tasks if PROBLEMS[t.problem](0).noise]
    readings = [
        Task(problem, "mo-cma-es", seed, tuple(options.items()))
        for options in READINGS.values()
        for problem in ("ZDT1", "rotated ellipsoids")
        for seed in range(seeds)
    ]
    todo = list(dict.fromkeys(tasks + readings))
    with ProcessPoolExecutor(workers) as executor:
        found = dict(zip(todo, executor.map(run, todo, chunksize=2), strict=True))

    def of(problem: str, method: str, again: float = 0.0, options: tuple[tuple[str, Any], ...] = ()) -> Floats:
        return np.array([found[Task(problem, method, seed, options, again)] for seed in range(seeds)])

    budget = POPULATION * GENERATIONS
    print(f"Share of the possible hypervolume after {budget} evaluations, median (range) of {seeds} seeds\n")
    print("| method | ZDT1 | rotated ellipsoids |\n|---|---|---|")
    for method in ALL:
        print(
            f"| `{method}` | " + " | ".join(spread(of(p, method)[:, -2]) for p in ("ZDT1", "rotated ellipsoids")) + " |"
        )
    print("\n| reading of Algorithm 1 | ZDT1 | rotated ellipsoids |\n|---|---|---|")
    for name, options in READINGS.items():
        cells = [of(p, "mo-cma-es", options=tuple(options.items()))[:, -2] for p in ("ZDT1", "rotated ellipsoids")]
        print(f"| {name} | " + " | ".join(map(spread, cells)) + " |")
    print(f"\nWith noise: true share, and bias, without and with {REEVALUATION:.0%} of the budget for re-evaluation\n")
    print("| method | re-evaluation | noisy ZDT1 | bias | noisy ellipsoids | bias |\n|---|---|---|---|---|---|")
    for method in ALL:
        for again in (0.0, REEVALUATION):
            cells = []
            for problem in ("noisy ZDT1", "noisy ellipsoids"):
                runs = of(problem, method, again)
                cells += [spread(runs[:, -2]), f"{np.median(runs[:, -1]):+.2f}"]
            print(f"| `{method}` | {again:.0%} | " + " | ".join(cells) + " |")
    if picture is not None:
        draw(
            {p: {m: of(p, m, REEVALUATION if "noisy" in p else 0.0)[:, :-1] for m in ALL} for p in PROBLEMS},
            picture,
        )


def draw(curves: dict[str, dict[str, Floats]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(curves), figsize=(3.6 * len(curves), 3.3), sharey=True, layout="constrained")
    evaluations = POPULATION * np.arange(1, GENERATIONS + 1)
    for axis, (problem, methods) in zip(axes, curves.items(), strict=True):
        for method, runs in methods.items():
            low, middle, high = np.quantile(runs, (0.25, 0.5, 0.75), axis=0)
            (line,) = axis.plot(evaluations, middle, label=method, lw=1.8)
            axis.fill_between(evaluations, low, high, color=line.get_color(), alpha=0.2, lw=0)
        axis.set_title(problem, fontsize=10)
        axis.set_xlabel("evaluations")
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("share of the possible hypervolume")
    axes[0].set_ylim(0.0, 1.02)
    axes[0].legend(fontsize=8, loc="center right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def race(seeds: int, track: str, generations: int) -> None:
    """Print the same comparison for policies of the lattice planner: aggressiveness and restraint."""
    from dataclasses import replace

    from pcs_racing.planners.registry import get_planner
    from pcs_racing.race.config import load_race_config
    from pcs_racing_agents.synthesis.evaluate import evaluate
    from pcs_racing_agents.synthesis.scenarios import draw_scenarios

    population, crashes = 25, 0.1
    family = get_planner("lattice")
    config = replace(load_race_config("paper"), duration=16.0)
    axes = ("aggressiveness", "restraint")
    fronts: dict[tuple[str, int], Floats] = {}
    for seed in range(seeds):
        rng = np.random.default_rng([14, seed])
        rivals, others = (np.stack([family.sample(rng) for _ in range(count)]) for count in (3, 6))
        seen = draw_scenarios([track], config, rivals, axes, starts=2, seed=2 * seed)
        held_out = draw_scenarios([track], config, others, axes, starts=2, seed=2 * seed + 1)
        for method in ALL:
            search = new_search(family.bounds, method, seed, population)
            for _ in range(generations):
                found = evaluate(seen, search.ask())
                search.tell(found.coordinates, found.own_crash - crashes)
            again = evaluate(held_out, search.archive)
            fronts[method, seed] = again.coordinates[again.own_crash <= 2.0 * crashes]
    everything = np.concatenate([front[non_dominated(front)] for front in fronts.values()])
    low, extent = everything.min(axis=0), np.ptp(everything, axis=0)
    print(
        f"Race on {track}: {population * generations} policies, {len(seen)} races of {config.duration:g} s each, at "
        f"most {crashes:.0%} own crashes in the search; hypervolume in {len(held_out)} held-out races, {seeds} seeds\n"
    )
    print("| method | hypervolume, median (range) | policies in the front | above random search |\n|---|---|---|---|")
    volumes = {key: hypervolume((front - low) / extent, REFERENCE) for key, front in fronts.items()}
    for method in ALL:
        own = [volumes[method, seed] for seed in range(seeds)]
        size = np.median([non_dominated(fronts[method, seed]).sum() for seed in range(seeds)])
        wins = sum(volumes[method, seed] > volumes["random", seed] for seed in range(seeds))
        versus = "" if method == "random" else f"{wins} of {seeds} seeds"
        print(f"| `{method}` | {spread(own)} | {size:.0f} | {versus} |")


def overhead() -> None:
    """Print what the methods themselves cost: 16 parameters, 2 objectives, generations of 50, 2,000 evaluations."""
    print("| method | processor time per evaluation, ms (best of 3) |\n|---|---|")
    centres = np.full(16, 0.3), np.full(16, 0.7)
    for method in ALL:
        times = []
        for repeat in range(4):  # the first one loads and compiles
            begin = time.process_time()
            search = new_search(np.tile([0.0, 1.0], (16, 1)), method, repeat, POPULATION)
            for _ in range(GENERATIONS):
                asked = search.ask()
                search.tell(-np.column_stack([((asked - centre) ** 2).sum(axis=1) for centre in centres]))
            times.append((time.process_time() - begin) / (POPULATION * GENERATIONS))
        print(f"| `{method}` | {1e3 * min(times[1:]):.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=7)
    parser.add_argument("--workers", type=int, default=2, help="processes for the functions (default: 2)")
    parser.add_argument("--picture", type=Path, default=None)
    parser.add_argument("--race", action="store_true", help="compare on the race instead")
    parser.add_argument("--track", default="Vellindra", help="circuit of --race")
    parser.add_argument("--generations", type=int, default=16, help="of 25 policies, in --race (default: 16)")
    parser.add_argument("--overhead", action="store_true", help="measure the methods' own time instead")
    arguments = parser.parse_args()
    if arguments.overhead:
        overhead()
    elif arguments.race:
        race(arguments.seeds, arguments.track, arguments.generations)
    else:
        functions(arguments.seeds, arguments.workers, arguments.picture)


if __name__ == "__main__":
    main()
