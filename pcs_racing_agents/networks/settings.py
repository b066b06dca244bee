"""Configuration of network training."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from pcs_racing.base.settings import Layers, OneOf, Settings
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.networks.targets import TARGETS


@dataclass(frozen=True)
class TrainSettings(Settings):
    """Configuration of training rows from trees and of the training of a network."""

    target: Annotated[
        str,
        OneOf(TARGETS),
        "Target of the network (pcs_racing_agents.networks.targets.TARGETS).",
    ] = "regret"
    iterations: Annotated[
        int, Interval(ge=1, le=1_000_000), "Iterations of CFR for targets based on regrets."
    ] = 1000
    rows_per_step: Annotated[
        int,
        Interval(ge=0, le=1_000_000),
        "Maximum number of nodes of each step from a tree, selected at random; 0 for all.",
    ] = 0
    hidden: Annotated[Layers, "Units of each hidden layer."] = (64, 64)
    learning_rate: Annotated[
        float,
        Interval(ge=1e-8, le=10.0),
        "Initial learning rate of Adam; halved after a quarter of the patience without"
        " improvement.",
    ] = 1e-3
    weight_decay: Annotated[
        float, Interval(ge=0.0, le=10.0), "Weight decay of AdamW; 0 for plain Adam."
    ] = 0.01
    batch_size: Annotated[
        int, Interval(ge=1, le=1_000_000), "Rows in the batch of a gradient step."
    ] = 1024
    rows_per_epoch: Annotated[
        int,
        Interval(ge=1, le=100_000_000),
        "Rows drawn per epoch, with replacement, in proportion to their weights; at most as many as"
        " there are.",
    ] = 100_000
    epochs: Annotated[int, Interval(ge=1, le=100_000), "Maximum number of epochs."] = 200
    patience: Annotated[
        int,
        Interval(ge=1, le=100_000),
        "Max epochs without a lower validation loss.",
    ] = 20
    test_share: Annotated[
        float,
        Interval(ge=0.0, le=0.8),
        "Share of the starting pairs held out to evaluate the network.",
    ] = 0.15
    seed: Annotated[
        int, Interval(ge=0, le=2**63 - 1), "Seed of the initial weights and of all random draws."
    ] = 0


def load_train_settings(
    source: str | Path | TrainSettings | None = None, **changes: Any
) -> TrainSettings:
    """Return settings by shipped name, YAML file or object, with some fields changed.

    A YAML file is a mapping of the fields of :class:`TrainSettings`; a field that is absent takes
    the default.
    """
    return load_config("train", TrainSettings(), source, **changes)
