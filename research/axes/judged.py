"""How well learned characteristics estimate held-out policies, circuits and archives: R2 by number of segments.

    python -m research.axes.judged --out out/learned-r2        # about 4 processor minutes; resumes

A pool of 24 fresh policies that span speed (seed 101) races on four circuits; characteristics are learned from it, once
from all inputs and once from pace and restraint alone, linear and with products. They are judged on the four other
circuits and on two sets of held-out policies: 24 fresh ones (seed 202), and 16 of a shipped archive, evenly
spaced in the order of its first axis. The true coordinates of these come from their races against the pool on the
held-out circuits.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import load_archive, load_race_config
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.cli.commands import add_parameters, parameter_values
from pcs_racing_agents.cli.options import Workers
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.payoffs.policy_pool import PolicyPool, pool_payoffs, spanning_policies
from pcs_racing_agents.results.text_table import markdown
from research.axes.behaviour import measure_behaviour, measure_payoffs
from research.axes.coordinates import COORDINATES
from research.axes.learn import JUDGED, LearnSettings, fit_characteristics, spread_over
from research.axes.pools import draw_pool
from research.axes.validation import judge

LEARNED_ON = ("Pipkin", "Saltmere", "Vellindra", "Larkmoor")
JUDGED_ON = ("Brackwater", "Tarnfjord", "Kestrelheim", "Quillburg")
SETS: dict[str, dict[str, Any]] = {
    "all inputs, products": {},
    "all inputs, linear": {"degree": 1},
    "speed": {"inputs": ("speed",)},
    "pace and restraint, linear": {"inputs": ("pace", "restraint"), "degree": 1},
    "pace and restraint, products": {"inputs": ("pace", "restraint")},
}


def main() -> None:
    """Race, learn, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the races; a stopped run goes on")
    parser.add_argument("--race", default="contest")
    parser.add_argument("--archive", default="contest")
    parser.add_argument("--size", type=int, default=24, help="policies of a fresh pool")
    parser.add_argument("--races", type=int, default=16, help="races of each pair of the pool on each circuit")
    parser.add_argument("--seeds", type=int, nargs=2, default=(101, 202), help="of the pool and of the other policies")
    parser.add_argument(
        "--segments", type=int, default=LearnSettings().segments, help="segments of a row of the regression"
    )
    add_parameters(parser, Workers)
    arguments = parser.parse_args()
    workers = Workers(**parameter_values(Workers, arguments))
    config, planner = load_race_config(arguments.race), get_planner("lattice")
    settings = LearnSettings(segments=arguments.segments)
    stated = {"race": repr(config), "size": arguments.size, "races": arguments.races, "seeds": list(arguments.seeds)}
    archive = load_archive(arguments.archive)
    stated |= {"archive": archive.content_hash, "inputs": list(settings.inputs)}
    with workers.start() as executor, open_job(arguments.out, "learned-r2", stated) as job:
        run: dict[str, Any] = {"executor": executor, "progress": show_progress("blocks")}
        drawn = []
        for seed in arguments.seeds:  # each in a folder of its own: groups of tasks have the same names
            with open_job(arguments.out / f"pool-{seed}", "pool", {**stated, "seed": seed}) as own:
                drawn.append(draw_pool(planner, LEARNED_ON, config, arguments.size, seed=seed, job=own, **run))
        pool, fresh = drawn
        rivals = spread_over(pool, settings.opponents)

        def behaviour(policies: Any, tracks: Any, seed: int, name: str) -> np.ndarray:
            return measure_behaviour(
                policies,
                rivals,
                tracks,
                config,
                settings.inputs,
                starts=settings.starts,
                seed=seed,
                job=job,
                name=name,
                **run,
            )

        own_behaviour = behaviour(pool, LEARNED_ON, 1, "behaviour-pool")
        payoffs = pool_payoffs(
            PolicyPool(pool, LEARNED_ON, config, races=arguments.races, folds=8, seed=2), job=job, **run
        )
        others = {"fresh policies": fresh, f"archive {archive.name}": spanning_policies(archive, 16)[1]}
        raced = {}
        for i, (name, policies) in enumerate(others.items()):
            seen = behaviour(policies, JUDGED_ON, 10 + i, f"behaviour-{i}")
            won = measure_payoffs(
                policies,
                pool,
                JUDGED_ON,
                config,
                starts=arguments.races // 4,
                seed=20 + i,
                job=job,
                name=f"payoffs-{i}",
                **run,
            )
            raced[name] = seen, won
    head = ("policies", "made of", "segments", *(f"R2 {name}" for name in COORDINATES))
    rows: list[tuple[str, ...]] = []
    for label, changes in SETS.items():
        chosen = LearnSettings(**{"segments": arguments.segments, **changes})
        columns = [settings.inputs.index(name) for name in chosen.inputs]
        learning = fit_characteristics(payoffs, own_behaviour[..., columns], chosen, seed=0)
        if not rows:
            plane = learning.coordinates
            print(f"plane: strength {plane.strength:.2f}, noise {plane.noise:.2f}\n")
        scores = {"the pool, cross-validated": learning.scores}
        for name, (seen, won) in raced.items():
            scores[name] = judge(learning.characteristics, learning.coordinates, seen[..., columns], won, JUDGED)
            for t, track in enumerate(JUDGED_ON):
                scores[f"{name}, {track}"] = judge(
                    learning.characteristics, learning.coordinates, seen[[t]][..., columns], won[[t]], JUDGED
                )
        for name, by_count in scores.items():
            for count, score in by_count.items():
                cells = (f"{r2:+.2f} +- {error:.2f}" for r2, error in zip(score.r2, score.error, strict=True))
                rows.append((name, label, str(count), *cells))
    rows.sort(key=lambda row: row[0])
    print("\n".join(markdown([head, *rows])))


if __name__ == "__main__":
    main()
