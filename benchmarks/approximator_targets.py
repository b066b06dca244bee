"""Networks of different targets, judged on trees that none of them saw (table of docs/reports/approximator.md).

    python benchmarks/approximator_targets.py
    python benchmarks/approximator_targets.py --trees out/trees --splits 1

Plays trees of three moves (without --trees; some minutes), or takes those of a folder that "pcs-racing tree" wrote. For
every target a network is trained several times, each time with other starting pairs held out; the figures are means
over all trees that were held out. Needs torch: pip install ".[learning]".
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from pcs_racing import make_game
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.networks import TARGETS, load_train_settings
from pcs_racing_agents.networks.from_trees import train_on_trees
from pcs_racing_agents.trees import StoredTrees, build_trees, load_trees
from pcs_racing_agents.trees.storage import stored_identity

VARIANTS: dict[str, dict[str, object]] = {
    **{target: {"target": target} for target in TARGETS},
    "regret, every step the same weight": {"target": "regret", "row_weights": "random"},
    "normalised, every node the same weight": {"target": "normalised", "row_weights": "uniform"},
    "advantage, no floor": {"target": "advantage", "floor": 0.0},
    "static-q, plain squares": {"target": "static-q", "floor": 0.0, "differences": False},
}
"""Every target with its defaults, then what they do for it."""

BESIDE = ("always", "equilibrium", "random moves")
NETWORK = "the network"


def measure(stored: StoredTrees, changes: dict[str, object], splits: int) -> tuple[float, dict[str, np.ndarray], float]:
    """Agreement on held-out rows, scores (trees, 4) by strategy, and seconds of a training with its solving."""
    trees = list(stored)
    agreement, scores, begin = [], [], time.perf_counter()
    for seed in range(splits):
        settings = load_train_settings(seed=seed, test_share=0.25, validation_share=0.2, **changes)
        trained = train_on_trees(
            trees.__getitem__, stored.settings["pairs"], stored_identity(stored.settings), settings, name=NETWORK
        )
        agreement.append(trained.rows[0].agreement)
        scores.append(trained.scores)
    joined = {name: np.concatenate([each[name] for each in scores]) for name in scores[0]}
    return float(np.mean(agreement)), joined, (time.perf_counter() - begin) / splits


def main() -> None:
    parser = argparse.ArgumentParser(description="Networks of different targets on held-out trees.", allow_abbrev=False)
    parser.add_argument("--trees", type=Path, help="folder of trees (default: play some)")
    parser.add_argument("--archive", default="default", help="of the trees to play (default: default)")
    parser.add_argument("--track", default="Tarnfjord", help="of the trees to play (default: Tarnfjord)")
    parser.add_argument("--pairs", type=int, default=60, help="trees to play (default: 60)")
    parser.add_argument("--moves", type=int, default=3, help="moves in them (default: 3)")
    parser.add_argument("--splits", type=int, default=3, help="trainings of each target (default: 3)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.trees is None:
            game = make_game(options.track, options.archive, moves=options.moves)
            stored = build_trees(game, folder, pairs=options.pairs, progress=show_progress("trees"))
        else:
            stored = load_trees(options.trees)
        rules = stored.settings["rules"]
        print(
            f"{len(stored)} trees of {rules['moves']} moves on {stored.settings['track']['name']}, archive "
            f"{stored.settings['archive']['name']}, preset {stored.settings['preset']}, epsilon {rules['epsilon']}, "
            f"utility {rules['utility']}; {options.splits} splits"
        )
        print(f"{'target':40}  agrees   lost to a best response   lost to equilibrium   seconds")
        beside: dict[str, np.ndarray] = {}
        for name, changes in VARIANTS.items():
            agreement, scores, seconds = measure(stored, changes, options.splits)
            print(f"{name:40}  {agreement:6.1%}  {cells(scores.pop(NETWORK))}  {seconds:8.0f}", flush=True)
            beside = scores
        for name, values in beside.items():
            if name.startswith(BESIDE):
                print(f"{name:40}  {'':6}  {cells(values)}")


def cells(values: np.ndarray) -> str:
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return "  ".join(f"{m:10.2f} ({e:.2f})  " for m, e in zip(values.mean(axis=0)[:2], error[:2], strict=True))


if __name__ == "__main__":
    main()
