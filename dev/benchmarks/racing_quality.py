"""Is the racing good? Random policies in the PCS, and how races between good ones go, for each
preset and circuit.

    python dev/benchmarks/racing_quality.py  # all shipped circuits, both presets
    python dev/benchmarks/racing_quality.py --picture docs/images/racing_quality.png

Every policy races the same opponents from the same starts. "Non-dominated" are the policies of the
random sample that no other one beats in both aggressiveness and restraint.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing.race.races import RaceResult, RaceSetup, run_races
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track


def non_dominated(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points no other point beats in every coordinate (larger is better)."""
    beats = (points[:, None] >= points[None]).all(-1) & (points[:, None] > points[None]).any(-1)
    return ~beats.any(axis=0)


def coordinates(result: RaceResult, config: RaceConfig) -> NDArray[np.float64]:
    """PCS coordinates of car 0 in each race."""
    state = result.state
    segment = Segment(
        state.progress - np.where(result.starts.side[:, None] == [0, 1], 0.0, -config.start_gap),
        state.sums,
        result.time,
        config.seconds,
    )
    first = "aggressiveness" if config.aggressiveness == "lead" else config.aggressiveness
    return measure(segment, get_characteristics((first, "restraint")))[:, 0]


def sample_policies(count: int, seed: int) -> list[Policy]:
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return [LATTICE.policy(LATTICE.sample(rng), f"random {i}") for i in range(count)]


def study(
    track: Track, config: RaceConfig, policies: int, opponents: int, seed: int
) -> dict[str, object]:
    egos = sample_policies(policies, seed)
    # The same opponents for every policy: its points then differ by the policy alone.
    rivals = sample_policies(opponents, seed + 1)
    result = run_races(
        track, [e for e in egos for _ in rivals], rivals * policies, config, seed=seed
    )
    shape = (policies, opponents)
    points = coordinates(result, config).reshape(*shape, 2).mean(axis=1)
    crash = result.own_crash[:, 0].reshape(shape).mean(axis=1)
    wins = (result.winner == 0).reshape(shape).mean(axis=1)
    front = np.flatnonzero(non_dominated(points))
    front = front[np.argsort(points[front, 0])]
    good = [egos[i] for i in front]
    among = run_races(
        track,
        [a for a in good for _ in good for _ in range(4)],
        [b for _ in good for b in good for _ in range(4)],
        config,
        seed=seed + 2,
    )
    same = run_races(track, egos, egos, config, seed=seed + 3)
    pairs = np.repeat(np.repeat(np.arange(len(good)), len(good)), 4)
    # A policy's result against its peers, from the most restrained to the most aggressive.
    peer_wins = np.array([(among.winner[pairs == i] == 0).mean() for i in range(len(good))])
    peer_crash = np.array([among.own_crash[pairs == i, 0].mean() for i in range(len(good))])
    thirds = np.array_split(np.arange(len(good)), 3)
    half = max(1, len(good) // 2)
    return {
        "track": track.name,
        "preset": config.name,
        "speed range": RaceSetup(track, config, (LATTICE, LATTICE)).speed_range,
        "random: finish": float(1.0 - result.crashed.mean()),
        "random: overtakes": float((result.state.overtakes.sum(axis=1) > 0).mean()),
        "front: policies": len(front),
        "front: own crash vs random": float(crash[front].mean()),
        "front: finish": float(1.0 - among.crashed.mean()),
        "front: overtakes": float((among.state.overtakes.sum(axis=1) > 0).mean()),
        "front: own crash, safer half": float(peer_crash[:half].mean()),
        "front: own crash, top third": float(peer_crash[thirds[2]].mean()),
        "front: wins by third": [round(float(peer_wins[part].mean()), 3) for part in thirds],
        "identical: touch": float((same.state.crash == 2).any(axis=1).mean()),
        "left or front car wins": float(
            (result.winner == result.starts.side)[result.winner >= 0].mean()
        ),
        "points": points,
        "crash": crash,
        "wins": wins,
        "front": front,
    }


def draw(studies: list[dict[str, object]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = min(len(studies), 4)
    rows = -(-len(studies) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.2 * columns, 3.9 * rows), squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(studies) :]:
        axis.set_axis_off()
    for axis, item in zip(axes.flat, studies, strict=False):
        points, crash, front = item["points"], item["crash"], item["front"]
        assert isinstance(points, np.ndarray)
        dots = axis.scatter(
            points[:, 1], points[:, 0], c=crash, cmap="viridis_r", vmin=0.0, vmax=0.6, s=14
        )
        axis.plot(
            points[front, 1],
            points[front, 0],
            "-o",
            color="#c2410c",
            mfc="none",
            ms=6,
            lw=1.2,
            label="non-dominated",
        )
        axis.set_title(f"{item['track']}, {item['preset']}", fontsize=10)
        axis.set_xlabel("restraint: mean minimum iTTC, s")
        axis.set_ylabel(
            "aggressiveness: "
            + ("mean lead, m" if item["preset"] == "paper" else "speed, in parts of the profile")
        )
        axis.grid(alpha=0.25)
    figure.colorbar(dots, ax=axes, label="share of races ended by an own crash", shrink=0.8)
    axes.flat[0].legend(loc="lower left", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tracks", nargs="+", default=None, help="names or folders (default: all shipped circuits)"
    )
    parser.add_argument("--rules", nargs="+", default=["paper", "contest"])
    parser.add_argument("--policies", type=int, default=300)
    parser.add_argument(
        "--opponents",
        type=int,
        default=20,
        help="races per policy, an even number plays both sides",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", type=Path, default=None)
    parser.add_argument("--json", action="store_true", help="end with one JSON line")
    arguments = parser.parse_args()
    studies = []
    for preset in arguments.rules:
        for name in arguments.tracks or list_tracks():
            item = study(
                load_track(name),
                load_race_config(preset),
                arguments.policies,
                arguments.opponents,
                arguments.seed,
            )
            studies.append(item)
            for key, value in item.items():
                if not isinstance(value, np.ndarray):
                    print(
                        f"  {key:30s} {value:.3f}"
                        if isinstance(value, float)
                        else f"  {key:30s} {value}"
                    )
            print(flush=True)
    if arguments.picture:
        draw(studies, arguments.picture)
    if arguments.json:
        print(
            json.dumps(
                [{k: v for k, v in s.items() if not isinstance(v, np.ndarray)} for s in studies]
            )
        )


if __name__ == "__main__":
    main()
