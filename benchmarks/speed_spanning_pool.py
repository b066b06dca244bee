"""An archive of policies of all speeds, each the best rated of its speed: a pool for matches and for headroom.

    python benchmarks/speed_spanning_pool.py out/pool --track Brackwater Pipkin [--seed 0]

Policies are drawn by a Latin hypercube over the lattice planner's parameters and race policies of its defaults at five
paces. Their speeds, relative to the fastest, are divided into equal intervals from 0.45 to 1; the policy that wins most
of each interval is kept. Coordinates are measured in races of their own.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from pcs_racing import PolicyArchive, get_planner, load_race_config, load_track, save_archive
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.race.races import RaceSetup, advance, draw_starts, start_races, winners

AXES = ("speed", "restraint")
PACES = (0.1, 0.3, 0.5, 0.7, 0.9)
SLOWEST = 0.45
SEGMENT = 8.0  # s, the step of the game, to which coordinates that grow with time refer


def race_all(theta: np.ndarray, rivals: np.ndarray, tracks, config, races: int, seed: int):
    """Mean score and coordinates of policies against rivals, shape (K,) and (K, G)."""
    planner, axes = get_planner("lattice"), get_characteristics(AXES)
    score, seen = np.zeros(len(theta)), np.zeros((len(theta), len(axes)))
    for number, track in enumerate(tracks):
        setup = RaceSetup(track, replace(config, start_lines=races // 2), (planner, planner))
        starts = draw_starts(track, setup.config, races, seed + number)
        keys = race_seeds(seed + number, races * len(rivals)).reshape(len(rivals), races)
        for k, own in enumerate(theta):
            for rival, noise in zip(rivals, keys, strict=True):
                state = start_races(setup, starts, noise)
                before = state.copy()
                both = np.ascontiguousarray(np.broadcast_to(np.stack([own, rival]), (races, 2, len(own))))
                advance(setup, state, both, setup.config.ticks)
                won = winners(setup.config, state)
                score[k] += np.where(won == 0, 1.0, np.where((won < 0) & ~state.crashed, 0.5, 0.0)).mean()
                segment = Segment.between(before, state, SEGMENT)
                seen[k] += measure(segment, axes)[:, 0].mean(axis=0)
    count = len(tracks) * len(rivals)
    return score / count, seen / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the archive is written")
    parser.add_argument("--track", nargs="+", default=["Brackwater", "Pipkin"], help="circuits that choose")
    parser.add_argument("--race", default="contest")
    parser.add_argument("--draws", type=int, default=96, help="policies that are drawn")
    parser.add_argument("--intervals", type=int, default=14, help="intervals of speed, a policy from each")
    parser.add_argument("--races", type=int, default=16, help="races against each rival on each circuit, even")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    planner, config = get_planner("lattice"), load_race_config(given.preset)
    tracks = [load_track(name) for name in given.track]
    bounds = planner.bounds
    drawn = qmc.LatinHypercube(len(bounds), seed=given.seed).random(given.draws)
    theta = bounds[:, 0] + drawn * (bounds[:, 1] - bounds[:, 0])
    rivals = np.array([planner.policy({"pace": pace}).parameters for pace in PACES])
    score, seen = race_all(theta, rivals, tracks, config, given.races, 1000 * given.seed + 1)
    relative = seen[:, 0] / seen[:, 0].max()
    interval = np.floor((relative - SLOWEST) / (1.0 - SLOWEST) * given.intervals)
    interval = np.minimum(interval, given.intervals - 1).astype(int)
    kept = []
    for each in range(given.intervals):
        inside = np.flatnonzero((interval == each) & (relative >= SLOWEST))
        if len(inside):
            kept.append(int(inside[score[inside].argmax()]))
            print(
                f"interval {each:2}: {len(inside):2} policies, best {kept[-1]} speed {relative[kept[-1]]:.2f} ", end=""
            )
            print(f"score {score[kept[-1]]:.2f}")
    _, coordinates = race_all(theta[kept], rivals, tracks, config, 2 * given.races, 1000 * given.seed + 501)
    archive = PolicyArchive(
        "speeds",
        planner.name,
        planner.parameter_names,
        theta[kept],
        AXES,
        coordinates,
        settings={"segment_seconds": SEGMENT, "tracks": ", ".join(given.track), "seed": given.seed},
        preset=given.preset,
    )
    print(f"correlation of the axes {np.corrcoef(coordinates.T)[0, 1]:+.2f}")
    print(f"written: {save_archive(archive, given.folder)}")


if __name__ == "__main__":
    main()
