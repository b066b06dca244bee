"""Settings of counterfactual regret minimisation in self-play."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcs_racing.base.settings import choice, number, setting, whole
from pcs_racing_agents.jobs.configuration import load_config
from pcs_racing_agents.learning.responses.learner import LearnerSettings
from pcs_racing_agents.networks.settings import TrainSettings

WEIGHTS = ("linear", "uniform")
"""Weight of iteration t in regrets and in the average strategy: t (linear CFR), or 1 (vanilla CFR, as in the paper)."""


@dataclass(frozen=True)
class SelfPlaySettings(LearnerSettings):
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
    members: int = setting(1, whole(1, 32), "Networks fitted in each iteration; their mean is used.")
    seed: int = setting(0, whole(0, 2**50), "Seed of the games and of the networks.")

    def iteration_weight(self, iteration: int) -> float:
        """Return the weight of an iteration, counted from 1."""
        return float(iteration) if self.weights == "linear" else 1.0

    def train_settings(self, iteration: int, member: int) -> TrainSettings:
        """Return the settings of a network of an iteration, counted from 1."""
        return self.fit_settings((self.seed * 64 + iteration) * 32 + member)


def load_self_play_settings(source: str | Path | SelfPlaySettings | None = None, **changes: Any) -> SelfPlaySettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("self-play", SelfPlaySettings(), source, **changes)
