"""The rates behind what commands say of how long they will take: processor seconds for a unit of each kind of work.

One of them is a share: of the races of several agents, what is driven if they are driven together.

    python benchmarks/command_rates.py    # a few minutes; prints what pcs_racing_agents/cli/estimates.py holds

Needs torch and Stable-Baselines3: pip install ".[learning]". What is compiled is compiled before the clock starts.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from shared_races import shared

from pcs_racing import load_track, make_game, parse_policy, run_races
from pcs_racing_agents.cli import estimates
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.ppo.train import train_ppo
from pcs_racing_agents.networks.rows import Rows
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.networks.training import train_layers
from pcs_racing_agents.trees import build_tree, choose_pairs, play_ego
from pcs_racing_agents.trees.roots import draw_root


def processor_seconds(work: Callable[[], object]) -> float:
    """Processor time of a call, of all threads together, s."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def racing() -> float:
    """A second of a race, the best of five times; races that end early count as far as they were driven."""
    track = load_track("Tarnfjord")
    rivals = [parse_policy(f"lattice:pace={pace:g}") for pace in np.linspace(0.0, 1.0, 200)]
    run_races(track, rivals[:2], rivals[:2])
    driven: list[float] = []
    spent = [
        processor_seconds(lambda: driven.append(float(run_races(track, rivals, rivals[::-1], seed=1).time.sum())))
        for _ in range(5)
    ]
    return min(spent) / driven[0]


def share_driven() -> float:
    """The share of the races of several agents that is driven if they are driven together."""
    alone, together = shared("paper", "Tarnfjord", 1)
    return together / alone


def tree_segment(trees: int) -> float:
    """A step of 8 s of a game tree, counting every joint history once."""
    game = make_game("Tarnfjord")
    play_ego(replace(game, config=replace(game.config, moves=1)), 4)
    spent = shared = 0.0
    for i, pair in enumerate(choose_pairs(game.archive, trees, 0)):
        root = draw_root(game, pair, 1, np.random.default_rng([0, i]))
        found: list[int] = []

        def build(root=root, found=found) -> None:  # type: ignore[no-untyped-def]
            tree = build_tree(game, root.policies, (root.start_s, root.side), root.seeds)
            found.append(tree.statistics.shared)

        spent += processor_seconds(build)
        shared += found[0]
    return spent / shared


def ego_segment(roots: int) -> float:
    """A step of 8 s of an ego tree, counting every history once."""
    game = make_game("Tarnfjord")
    histories = sum(len(game.move_names) ** step for step in range(game.config.moves + 1))
    return processor_seconds(lambda: play_ego(game, roots)) / (roots * histories)


def ppo_step(name: str, steps: int) -> float:
    """A step that PPO learns from; as many races of evaluation for a step as in a whole training."""
    settings = load_ppo_settings(name)
    races = max(2, 2 * round(settings.evaluation_races * steps / settings.evaluate_every / 2))
    changes = {"steps": steps, "evaluate_every": steps, "evaluation_races": races}
    with tempfile.TemporaryDirectory() as folder:
        train_ppo(name, Path(folder) / "warm", **{**changes, "steps": 1, "evaluation_races": 2})
        return processor_seconds(lambda: train_ppo(name, Path(folder) / "timed", **changes)) / steps


def row() -> float:
    """A row that a network learns from, once."""
    rng = np.random.default_rng(0)
    number, epochs = 100_000, 4
    rows = Rows(
        observations=rng.normal(size=(number, 24)).astype(np.float32),
        targets=rng.normal(size=(number, 4)).astype(np.float32),
        weights=np.ones(number),
        pair=np.arange(number) % 100,
        step=np.zeros(number, np.int64),
    )
    train_layers(rows, TrainSettings(epochs=1, rows_per_epoch=1000))
    settings = TrainSettings(epochs=epochs, patience=epochs, rows_per_epoch=number, batch_size=512)
    return processor_seconds(lambda: train_layers(rows, settings)) / (epochs * number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trees", type=int, default=3, help="full trees to build")
    parser.add_argument("--roots", type=int, default=64, help="ego trees to play")
    arguments = parser.parse_args()
    measured = {
        "RACING": racing,
        "SHARED": share_driven,
        "TREE_SEGMENT": lambda: tree_segment(arguments.trees),
        "EGO_SEGMENT": lambda: ego_segment(arguments.roots),
        "DUEL_MOVE": lambda: ppo_step("duel-paper", 20_480),
        "DRIVE_STEP": lambda: ppo_step("drive", 122_880),
        "ROW": row,
    }
    for name, measure in measured.items():
        print(f"{name:13s} {measure():.2e} (estimates.py has {getattr(estimates, name):.2e})", flush=True)


if __name__ == "__main__":
    main()
