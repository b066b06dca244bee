"""Strength of the learned planners against other planners, and the styles of ``line-ppo``.

    python dev/benchmarks/learned.py --out out/learned
    python dev/benchmarks/learned.py --out out/learned --only styles --picture styles.png

Circuits of the training, and circuits held out of it, are reported apart. Cars start from both
sides. Intervals of 95 % are clustered by circuit and start line. Each finished batch of races is a
file in the folder; a stopped run goes on from there.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from pcs_racing import load_track, run_races
from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.race.config import load_race_config
from pcs_racing_agents.agents.own_code import parse_own_policy
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.statistics import clustered_mean

SHIPPED = ("Saltmere", "Vellindra")
REAL = ("Austin", "Monza", "Sepang", "Zandvoort")
CIRCUITS = {
    "train": ("Brackwater", "Kestrelheim", "Larkmoor", "Pipkin", "Quillburg", "Tarnfjord"),
    "held out": SHIPPED + REAL,
}
SLOW = ("gap-follower", "disparity-extender", "residual")  # planners by lidar
RIVALS = {
    "line-ppo": (
        *("lattice", "lattice:early", "iterated-best-response", "pure-pursuit", *SLOW),
        *("alpha-racer", "frenet-sampling", "mppi"),
    ),
    "lidar-ppo": ("pure-pursuit", "residual", "gap-follower", "lattice:early"),
}
SLOW_TO_COMPUTE = ("mppi", "iterated-best-response")  # a quarter of the races
RULES = ("contest", "roboracer")
SEED = 4049
STYLES = {
    "risk": (0.0, 1.0),
    "assertiveness": (0.0, 1.0),
    "pace": (0.0, 2.0),
    "pace_behind": (-0.5, 0.5),
}
VALUES = 7  # values of each style, the others at their defaults
MIX = ("lattice", "lattice:early", "pure-pursuit", "gap-follower")
WON, OWN, WORSE, OVERTAKES, SPEED, LINE = range(6)


class Races:
    """Races of pairs, kept in a folder."""

    def __init__(self, folder: Path, maps: Path, threads: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.maps, self.threads = folder, maps, threads

    def on(
        self,
        track: str,
        ego: str,
        rival: str,
        rules: str,
        races: int,
        vehicles: tuple[VehicleParams, ...] = (),
    ) -> np.ndarray:
        """Return a row for each race: score, own crash, the rival's, overtakes, speed, line."""
        circuit = load_track(str(self.maps / track) if track in REAL else track)
        policies = [parse_own_policy(text) for text in (ego, rival)]
        config = load_race_config(rules)
        # Weights, rules, cars or circuits that changed are other races.
        mark = fingerprint(policies, config, circuit.content_hash, SEED, *vehicles)[:12]
        pair = f"{ego} {rival}".replace("/", "-")
        file = self.folder / f"{pair} {rules} {track} {races} {mark}.npy"
        if not file.exists():
            result = run_races(
                circuit,
                [policies[0]] * races,
                policies[1],
                config,
                seed=SEED,
                vehicle=vehicles or F1TENTH,
                threads=self.threads,
            )
            state = result.state
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            speed = state.progress[:, 0] / np.maximum(result.time, 0.1)
            line = np.arange(races) // 2 % config.start_lines
            columns = [won, *result.own_crash.T, state.overtakes[:, 0], speed, line]
            new = file.with_suffix(".new.npy")
            np.save(new, np.stack(columns, axis=1).astype(float))
            new.replace(file)
        return np.load(file)

    def everywhere(
        self, tracks: Sequence[str], ego: str, rival: str, rules: str, races: int
    ) -> list[np.ndarray]:
        """Return the rows on each circuit."""
        return [self.on(track, ego, rival, rules, races) for track in tracks]


def estimate(found: Sequence[np.ndarray], column: int, shares: bool = True) -> str:
    """Return the mean of a column, with its interval: of shares, or of differences of shares."""
    labels = [f"{k} {line}" for k, rows in enumerate(found) for line in rows[:, LINE]]
    mean = clustered_mean(np.concatenate(found)[:, column], labels)
    low, high = mean.low, mean.high
    if shares:
        low, high = max(low, 0.0), min(high, 1.0)
    return f"{mean.mean:.3f} [{low:.3f}, {high:.3f}]"


def pairs(kept: Races, races: int, egos: Sequence[str]) -> None:
    """Print scores and own crashes of each pair."""
    print("| rules | ego | against | circuits | score [95 %] | own crashes | worst | races |")
    print("|---|---|---|---|---|---|---|---|")
    for rules in RULES:
        for ego in egos:
            for rival in RIVALS[ego]:
                count = races // 4 if rival in SLOW_TO_COMPUTE else races
                for name, tracks in CIRCUITS.items():
                    found = kept.everywhere(tracks, ego, rival, rules, count)
                    own = [rows[:, OWN].mean() for rows in found]
                    score = estimate(found, WON)
                    print(
                        f"| {rules} | {ego} | {rival} | {name} | {score} | {np.mean(own):.3f}"
                        f" | {max(own):.3f} | {count * len(tracks)} |",
                        flush=True,
                    )


def styles(kept: Races, races: int, picture: Path | None) -> None:
    """Print what each style does on held-out circuits, against a mix of planners."""
    curves = {}
    for name, (low, high) in STYLES.items():
        values = np.linspace(low, high, VALUES)
        rows = []
        for value in values:
            found = np.concatenate(
                [
                    np.concatenate(
                        kept.everywhere(
                            SHIPPED + REAL, f"line-ppo:{name}={value:g}", rival, "contest", races
                        )
                    )
                    for rival in MIX
                ]
            )
            rows.append(found[:, [WON, OWN, OVERTAKES, SPEED]].mean(axis=0))
        curves[name] = values, np.array(rows)
        for k, what in enumerate(("score", "own crashes", "overtakes a race", "mean speed, m/s")):
            means = curves[name][1][:, k]
            rho = spearmanr(values, means)[0]
            shown = " ".join(f"{mean:.3f}" for mean in means)
            print(f"{name:14} {what:17} {shown}  rank correlation {rho:+.2f}", flush=True)
    if picture is not None:
        draw(curves, picture)


def draw(curves: dict[str, tuple[np.ndarray, np.ndarray]], picture: Path) -> None:
    """Draw what each style does, a row for each measure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(3, len(curves), sharex="col", sharey="row")
    labels = ("own crashes", "overtakes a race", "mean speed, m/s")
    for column, (name, (values, means)) in enumerate(curves.items()):
        for row, label in enumerate(labels):
            axes[row, column].plot(values, means[:, row + 1], "o-")
            axes[row, column].grid(alpha=0.3)
            axes[row, 0].set_ylabel(label)
        axes[-1, column].set_xlabel(name)
    figure.savefig(picture, dpi=110)


def maps_of(names: Sequence[str]) -> Path:
    """Return the folder of real circuits, which has these names."""
    maps = Path(os.environ.get("PCS_RACING_MAPS", "../shared/maps"))
    missing = [name for name in names if not (maps / name).is_dir()]
    if missing:
        raise SystemExit(f"{maps} lacks {', '.join(missing)}; set PCS_RACING_MAPS to the circuits")
    return maps


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of finished races")
    add("--only", nargs="+", choices=["pairs", "styles"], default=["pairs", "styles"])
    add("--egos", nargs="+", choices=sorted(RIVALS), default=sorted(RIVALS))
    add("--races", type=int, default=400, help="races of a pair on a circuit")
    add("--picture", type=Path, help="picture of the styles")
    add("--threads", type=int, default=os.cpu_count(), help="threads that share the races")
    arguments = parser.parse_args()
    if arguments.races < 8 or arguments.threads < 1:
        said = f"--races {arguments.races} must be at least 8"
        parser.error(f"{said}, --threads {arguments.threads} at least 1")
    kept = Races(arguments.out, maps_of(REAL), arguments.threads)
    if "pairs" in arguments.only:
        pairs(kept, arguments.races, arguments.egos)
    if "styles" in arguments.only:
        styles(kept, max(2, arguments.races // 10), arguments.picture)


if __name__ == "__main__":
    main()
