"""Does it help to replace random opponents by policies of the growing archive? Hypervolume on opponents held out.

    python benchmarks/opponent_refresh.py --out out/opponent_refresh            # goes on where it was stopped

Every variant races the same number of policies; racing the archive again against new opponents counts. Two sets of
opponents were seen by nobody: random ones, and competitive ones, spread over the archive of another run.
The hypervolume is in units of the range of 80 random policies in those very races, reference a tenth of it below their
worst. Seeds are paired: the same scouts, start lines and first opponents.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.synthesis.archive_run import draw_policies, make_archive
from pcs_racing_agents.synthesis.archive_search import REFERENCE
from pcs_racing_agents.synthesis.config import ArchiveConfig
from pcs_racing_agents.synthesis.diverse import select_diverse
from pcs_racing_agents.synthesis.evaluate import evaluate
from pcs_racing_agents.synthesis.indicators import hypervolume
from pcs_racing_agents.synthesis.pareto_archive import Scale
from pcs_racing_agents.synthesis.scenarios import draw_scenarios

VARIANTS: dict[str, tuple[float, ...]] = {  # parts of the generations after which opponents are replaced
    "fixed": (),
    "refreshed once": (1 / 2,),
    "refreshed three times": (1 / 4, 1 / 2, 3 / 4),
}
OTHER_RUN = 1000  # seed of the archive that the competitive opponents come from


def configuration(preset: str, seed: int, generations: int, refresh: tuple[float, ...] = ()) -> ArchiveConfig:
    return ArchiveConfig(
        preset=preset,
        tracks=("Tarnfjord", "Vellindra", "Kestrelheim"),
        generations=generations,
        population=20,
        scouts=40,
        opponents=4,
        starts=1,
        crash_limit=0.15 if preset == "paper" else 0.5,
        candidates=80,
        choice_opponents=4,
        choice_starts=1,
        final_duration=16.0,
        final_opponents=4,
        final_starts=1,
        fewest=10,
        most=60,
        refresh_generations=tuple(1 + int(part * generations) for part in refresh),
        seed=seed,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--race", default="paper", choices=("paper", "contest"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--generations", type=int, default=26, help="of 20 policies, after 40 at random (default: 26)")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    parser.add_argument("--out", type=Path, default=Path("out/opponent_refresh"))
    add_executor_options(parser)
    arguments = parser.parse_args()
    if "fixed" not in arguments.variants:
        parser.error("--variants must name fixed, which the others are compared with")
    family = get_planner("lattice")
    with executor_from(arguments) as executor:

        def made(seed: int, variant: str):  # type: ignore[no-untyped-def]
            folder = arguments.out / arguments.race / f"{variant.replace(' ', '-')}-{seed}"
            config = configuration(arguments.race, seed, arguments.generations, VARIANTS[variant])
            return make_archive(config, folder, executor=executor)

        other = made(OTHER_RUN, "fixed")
        first = configuration(arguments.race, OTHER_RUN, arguments.generations)
        held_out = {
            "random": draw_policies(family, 8, np.random.SeedSequence(OTHER_RUN + 1)),
            "competitive": other.complete(other.parameters[select_diverse(other, 8, "map")]),
        }
        random_policies = draw_policies(family, 80, np.random.SeedSequence(OTHER_RUN + 2))
        found: dict[tuple[str, str], list[float]] = {}
        sizes: dict[str, list[int]] = {variant: [] for variant in arguments.variants}
        for kind, opponents in held_out.items():
            rules = replace(first.rules, duration=16.0)
            races = draw_scenarios(first.tracks, rules, opponents, first.axes, starts=1, seed=OTHER_RUN + 3)
            alike = evaluate(races, random_policies, executor=executor).coordinates
            scale = Scale(alike.max(axis=0), alike.min(axis=0))
            for variant in arguments.variants:
                for seed in range(arguments.seeds):
                    archive = made(seed, variant)
                    points = evaluate(races, archive.complete(archive.parameters), executor=executor).coordinates
                    found.setdefault((kind, variant), []).append(hypervolume(scale(points), REFERENCE))
                    if kind == "random":
                        sizes[variant].append(len(archive.explored.parameters))
    print(f"preset {arguments.race}, {arguments.seeds} seeds, {arguments.generations} generations of 20\n")
    print("| opponents held out | variant | policies raced | median | lowest | highest | mean gain over fixed (95 %) |")
    print("|---|---|---|---|---|---|---|")
    for (kind, variant), volumes in found.items():
        gains = np.array(volumes) - np.array(found[kind, "fixed"])
        gain = "" if variant == "fixed" else f"{gains.mean():+.3f} ± {_half_width(gains):.3f}"
        low, middle, high = np.quantile(volumes, (0.0, 0.5, 1.0))
        raced = f"{np.median(sizes[variant]):.0f}"
        print(f"| {kind} | {variant} | {raced} | {middle:.3f} | {low:.3f} | {high:.3f} | {gain} |")


def _half_width(gains: NDArray[np.float64]) -> float:
    """Half of the 95 % confidence interval of a mean of paired differences (Student's t, up to 10 of them)."""
    quantile = {1: 12.71, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262}
    degrees = len(gains) - 1
    return float(quantile.get(degrees, 1.96) * gains.std(ddof=1) / np.sqrt(len(gains))) if degrees else float("nan")


if __name__ == "__main__":
    main()
