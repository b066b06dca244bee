"""Settings of counterfactual regret minimisation in self-play."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcs_racing.base.settings import Settings, choice, load_settings, number, setting, whole, wholes
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.learning.responses.branches import WORTH
from pcs_racing_agents.networks.settings import TrainSettings

__all__ = ["WEIGHTS", "SelfPlaySettings", "load_self_play_settings"]

WEIGHTS = ("linear", "uniform")
"""Weight of iteration t in regrets and in the average strategy: t (linear CFR), or 1 (vanilla CFR, as in the paper)."""


@dataclass(frozen=True)
class SelfPlaySettings(Settings):
    """Settings of the training in self-play."""

    iterations: int = setting(16, whole(1, 63), "Iterations of CFR; after each the network is fitted to all rows.")
    starts: int = setting(
        512, whole(4, 1_000_000), "Games branched in each iteration, at every step and on each circuit."
    )
    exploration: float = setting(
        0.1,
        number(0.0, 1.0),
        "Probability of a uniformly random move in place of one by regret matching, for both cars.",
    )
    weights: str = setting(
        "linear",
        choice(WEIGHTS),
        "Weight of iteration t in the regrets and in the average strategy: t (linear), or 1 (uniform).",
    )
    worth: str = setting("win", choice(WORTH), "Value of an outcome: a race won, or the game's utility.")
    members: int = setting(1, whole(1, 32), "Networks fitted in each iteration; their mean is used.")
    hidden: tuple[int, ...] = setting((64, 64), wholes(1, 4096, longest=8), "Units of each hidden layer of a network.")
    learning_rate: float = setting(3e-3, number(1e-8, 10.0), "Initial learning rate of Adam.")
    weight_decay: float = setting(1e-3, number(0.0, 10.0), "Weight decay of AdamW.")
    batch_size: int = setting(512, whole(1, 1_000_000), "Rows in the batch of a gradient step.")
    epochs: int = setting(60, whole(1, 100_000), "Maximum number of epochs.")
    patience: int = setting(12, whole(1, 100_000), "Epochs without a lower validation loss after which training stops.")
    seed: int = setting(0, whole(0, 2**50), "Seed of the games and of the networks.")

    def iteration_weight(self, iteration: int) -> float:
        """Return the weight of an iteration, counted from 1."""
        return float(iteration) if self.weights == "linear" else 1.0

    def train_settings(self, iteration: int, member: int) -> TrainSettings:
        """Return the settings of a network of an iteration, counted from 1."""
        return TrainSettings(
            hidden=self.hidden,
            learning_rate=self.learning_rate,
            weight_decay=self.weight_decay,
            batch_size=self.batch_size,
            epochs=self.epochs,
            patience=self.patience,
            rows_per_epoch=50_000,
            seed=(self.seed * 64 + iteration) * 32 + member,
        )


def load_self_play_settings(source: str | Path | SelfPlaySettings | None = None, **changes: Any) -> SelfPlaySettings:
    """Return settings from a name, a YAML file or settings, with some fields changed.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    UnknownNameError
        If the name is no configuration and no file.
    """
    return load_settings("self-play", SelfPlaySettings(), source, shipped_configs("self-play"), **changes)
