"""Configuration of network training."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Layers, OneOf, Settings
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.networks.targets import ROW_WEIGHTS, TARGETS
from pcs_racing_agents.solvers import VARIANTS


@dataclass(frozen=True)
class TrainSettings(Settings):
    """Configuration of training rows from trees and of the training of a network.

    With noisy targets, a ``floor`` favours noisy moves. Situations differ much more than the moves
    in one situation: without ``differences`` a network learns the situations first. Neither option
    is for clipped targets.
    """

    target: Annotated[
        str,
        OneOf(TARGETS),
        "Target of the network (pcs_racing_agents.networks.targets.TARGETS).",
    ] = "regret"
    iterations: Annotated[
        int, Interval(ge=1, le=1_000_000), "Iterations of CFR for targets based on regrets."
    ] = 1000
    variant: Annotated[
        str,
        OneOf(VARIANTS),
        'Variant of CFR; "vanilla" is that of the paper, whose cumulative regrets can be negative.',
    ] = "vanilla"
    row_weights: Annotated[
        str | None,
        OneOf(ROW_WEIGHTS),
        'Weight of each node of a tree; None takes "uniform" for "regret", because at a tree\'s'
        ' root cumulative regrets are a hundred times as large as at its leaves, and "random" for'
        " all other targets.",
    ] = None
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
    floor: Annotated[
        float | None,
        Interval(ge=0.0, le=1000.0),
        "Targets are raised to at most this many times what random moves lose on average below the"
        " best of their row; 0 for no floor. None takes 0.25 for trees, and 0 for rows of any other"
        " source.",
    ] = None
    differences: Annotated[
        bool | None,
        "Whether the mean of a row's moves, and how they differ from it, are learned each in units"
        " of its own spread. None takes true for trees, and false for rows of any other source.",
    ] = None
    below_zero: Annotated[
        float,
        Interval(ge=0.0, le=1000.0),
        "For clipped targets: weight of the errors below 0 in rows that have no positive target."
        " There the paper allows any move; with this above 0 the network learns which is the least"
        " bad.",
    ] = 1.0
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
        "Epochs without a lower validation loss after which training stops.",
    ] = 20
    validation_share: Annotated[
        float,
        Interval(ge=0.01, le=0.9),
        "Share of the starting pairs used for early stopping.",
    ] = 0.15
    test_share: Annotated[
        float,
        Interval(ge=0.0, le=0.9),
        "Share of the starting pairs held out to evaluate the network.",
    ] = 0.15
    seed: Annotated[
        int, Interval(ge=0, le=2**63 - 1), "Seed of the initial weights and of all random draws."
    ] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.validation_share + self.test_share > 0.95:
            raise ConfigError(
                f"validation_share and test_share are {self.validation_share:g} and"
                f" {self.test_share:g}; together they must leave 5 % of the starting pairs to learn"
                " from"
            )


def settings_for_trees(settings: TrainSettings) -> TrainSettings:
    """Return settings with the defaults for rows of trees in place of None."""
    weights = "uniform" if settings.target == "regret" else "random"
    values = settings.target != "nash"  # nash targets are probabilities
    return replace(
        settings,
        row_weights=weights if settings.row_weights is None else settings.row_weights,
        floor=0.25 * values if settings.floor is None else settings.floor,
        differences=values if settings.differences is None else settings.differences,
    )


def load_train_settings(
    source: str | Path | TrainSettings | None = None, **changes: Any
) -> TrainSettings:
    """Return settings by shipped name, YAML file or object, with some fields changed.

    A YAML file is a mapping of the fields of :class:`TrainSettings`; a field that is absent takes
    the default.
    """
    return load_config("train", TrainSettings(), source, **changes)
