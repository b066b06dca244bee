"""What a network is trained on, and how: a dataclass, from YAML if need be."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import ConfigError
from pcs_racing_agents.jobs.configuration import check_numbers, check_wholes, load_settings
from pcs_racing_agents.networks.targets import OPPONENTS, ROW_WEIGHTS, TARGETS
from pcs_racing_agents.solvers import VARIANTS

__all__ = ["TrainSettings", "load_train_settings", "settings_for_trees"]

_CHOICES: dict[str, tuple[str | None, ...]] = {
    "target": tuple(TARGETS),
    "opponent": tuple(OPPONENTS),
    "row_weights": (None, *ROW_WEIGHTS),
    "variant": tuple(VARIANTS),
    "continuation": ("learned", "best"),
}


@dataclass(frozen=True)
class TrainSettings:
    """How rows are made from trees and how a network learns them.

    Attributes
    ----------
    target : str
        What is learned: one of :data:`pcs_racing_agents.networks.targets.TARGETS`.
    iterations : int
        Iterations of CFR behind the targets that are made of regrets.
    variant : str
        Kind of CFR behind them; "vanilla" is the paper's, whose cumulative regrets can be negative.
    opponent : str
        Opponent of the target "static-q": one of :data:`pcs_racing_agents.networks.targets.OPPONENTS`.
    continuation : str
        What follows a move in the targets of ego trees: "learned", what the network learned of the later moves says, or
        "best", what would have been best in hindsight.
    row_weights : str, optional
        How much each node of a tree counts: one of :data:`pcs_racing_agents.networks.targets.ROW_WEIGHTS`. By
        default "uniform" for "regret", since at a tree's root cumulative regrets are a hundred times as large as at its
        ends, and "random" for all other targets.
    rows_per_step : int
        Most nodes of each step that are taken from a tree, drawn at random; 0 for all.
    hidden : tuple of int
        Widths of the hidden layers, each 1 to 4096; at most 8 layers.
    learning_rate : float
        Of Adam, at the beginning; halved whenever a quarter of the patience has brought nothing.
    weight_decay : float
        Decoupled from the gradient (AdamW); 0 for plain Adam.
    floor : float, optional
        Targets far below the best of their row are raised, so that the network need not tell bad moves from worse ones:
        none is left further below than this many times what random moves lose on average; 0 for no such floor. Where
        targets carry much noise it would favour moves of much noise; by default it is 0.25 for trees and ego trees, and
        0 for rows of any other source. Clipped targets have their own.
    differences : bool, optional
        Whether the mean of a row's moves, and how they differ from it, are learned each in units of its own spread.
        Situations differ much more than the moves in one of them; otherwise a network learns the former first. By
        default true for trees and ego trees, and false for rows of any other source. Not for clipped targets.
    below_zero : float
        For clipped targets: weight of the errors below 0 in rows that have no positive target. There the paper allows
        any move; with this above 0 the network learns which is the least bad.
    batch_size : int
    rows_per_epoch : int
        Rows drawn per epoch, with replacement, in proportion to their weights; at most as many as there are.
    epochs : int
        At most.
    patience : int
        Stop after so many epochs without a lower loss on the validation rows.
    validation_share : float
        Share of the starting pairs that decides when to stop, in [0.01, 0.9].
    test_share : float
        Share of the starting pairs kept away from both, to judge the network by, in [0, 0.9].
    seed : int

    Raises
    ------
    ConfigError
        If a value is impossible.
    """

    target: str = "regret"
    iterations: int = 1000
    variant: str = "vanilla"
    opponent: str = "fixed-sequence"
    continuation: str = "learned"
    row_weights: str | None = None
    rows_per_step: int = 0
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    weight_decay: float = 0.01
    floor: float | None = None
    differences: bool | None = None
    below_zero: float = 1.0
    batch_size: int = 1024
    rows_per_epoch: int = 100_000
    epochs: int = 200
    patience: int = 20
    validation_share: float = 0.15
    test_share: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        for key, choices in _CHOICES.items():
            if getattr(self, key) not in choices:
                raise ConfigError(
                    f"{key} is {getattr(self, key)!r}; it must be one of {', '.join(filter(None, choices))}"
                )
        if self.differences is not None and not isinstance(self.differences, bool):
            raise ConfigError(f"differences is {self.differences!r}; it must be true or false")
        check_wholes(
            self,
            iterations=(1, 1_000_000),
            rows_per_step=(0, 1_000_000),
            batch_size=(1, 1_000_000),
            rows_per_epoch=(1, 100_000_000),
            epochs=(1, 100_000),
            patience=(1, 100_000),
            seed=(0, 2**63 - 1),
        )
        check_numbers(
            self,
            learning_rate=(1e-8, 10.0),
            weight_decay=(0.0, 10.0),
            below_zero=(0.0, 1000.0),
            validation_share=(0.01, 0.9),
            test_share=(0.0, 0.9),
        )
        if self.floor is not None:
            check_numbers(self, floor=(0.0, 1000.0))
        if self.validation_share + self.test_share > 0.95:
            raise ConfigError(
                f"validation_share and test_share are {self.validation_share:g} and {self.test_share:g}; together they "
                "must leave 5 % of the starting pairs to learn from"
            )
        hidden = self.hidden
        whole = isinstance(hidden, list | tuple) and all(isinstance(n, int) and not isinstance(n, bool) for n in hidden)
        if not whole or len(hidden) > 8 or not all(1 <= n <= 4096 for n in hidden):
            raise ConfigError(f"hidden is {hidden!r}; it must be a list of at most 8 whole numbers from 1 to 4096")
        object.__setattr__(self, "hidden", tuple(hidden))


def settings_for_trees(settings: TrainSettings) -> TrainSettings:
    """Return settings whose open choices are made for rows of trees or ego trees."""
    weights = "uniform" if settings.target == "regret" else "random"
    values = settings.target != "nash"  # which are probabilities
    return replace(
        settings,
        row_weights=weights if settings.row_weights is None else settings.row_weights,
        floor=0.25 * values if settings.floor is None else settings.floor,
        differences=values if settings.differences is None else settings.differences,
    )


def load_train_settings(source: str | Path | TrainSettings | None = None, **changes: Any) -> TrainSettings:
    """Return settings from a shipped configuration's name, a YAML file or settings, with some fields changed.

    A YAML file is a mapping of the fields of :class:`TrainSettings`; a field that is absent takes the default.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    UnknownNameError
        If the name is no configuration and no file.
    """
    return load_settings("train", TrainSettings(), source, **changes)
