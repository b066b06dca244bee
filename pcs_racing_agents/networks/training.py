"""Training of a network on rows: AdamW, validation on held-out starting pairs, early stopping.

The same settings and rows give the same network: initial weights and draws come from numpy
generators of the settings' seed, torch runs in one thread, and its own random state is neither read
nor changed.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.settings import Layers, OneOf, Settings, plain_settings
from pcs_racing.base.typing import Singles
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Progress
from pcs_racing_agents.base.tables import write_csv
from pcs_racing_agents.networks.goals import Goals, Scaling, row_goals, scale_rows
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import TARGETS, Rows, best_moves, split_by_pair


@dataclass(frozen=True)
class TrainSettings(Settings):
    """Configuration of training rows from trees and of the training of a network."""

    target: Annotated[
        str,
        OneOf(TARGETS),
        "Target of the network (pcs_racing_agents.networks.rows.TARGETS).",
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


VALIDATION_SHARE = 0.15
"""Share of the starting pairs used for early stopping."""


_TURN = threading.RLock()


@contextmanager
def torch_alone() -> Iterator[Any]:
    """Provide torch, limited to one thread, to one thread of this process at a time.

    Several threads gain nothing for networks of this size, and would change the order of sums.
    """
    require("torch", extra="learning")
    import torch

    with _TURN:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield torch
        finally:
            torch.set_num_threads(before)


class Epoch(NamedTuple):
    """Learning rate, losses and scores of an epoch."""

    epoch: int  #: Number of the epoch, from 1; 0 is the network before any training.
    learning_rate: float  #: Learning rate at the end of the epoch.
    training_loss: float  #: Mean over the epoch's draws during their updates; NaN for epoch 0.
    #: Mean over the validation rows. Both losses are mean squared errors in units of the targets'
    #: root mean square.
    validation_loss: float
    #: Weighted share of the validation rows whose chosen move has the highest target.
    validation_agreement: float


class TrainingResult(NamedTuple):
    """Layers of a trained network, and history of its training."""

    #: ``layers``, ``mean``, ``scale``: Fields of :class:`pcs_racing_agents.networks.RegretNetwork`.
    layers: DenseLayers
    mean: Singles
    scale: Singles
    epochs: tuple[Epoch, ...]
    best: int  #: Index of the epoch of the weights, with the minimum validation loss.
    validation_pairs: NDArray[np.int64]  #: Starting pairs held out from training.


def train_network(
    rows: Rows,
    identity: GameIdentity,
    settings: TrainSettings,
    *,
    name: str,
    target: str | None = None,
    clipped: bool = False,
    relative: bool = False,
    progress: Progress | None = None,
) -> tuple[RegretNetwork, TrainingResult]:
    """Train a network on rows of its game, from any source.

    Parameters
    ----------
    target : str, optional
        Kind of the rows' targets; by default the settings' target.
    clipped : bool
        True if the network learns and returns targets below 0 as 0.
    relative : bool
        True if the differences between a row's moves are learned apart from their mean
        (:mod:`pcs_racing_agents.networks.goals`); not for clipped targets.
    progress : callable, optional
        Called after every epoch as ``progress(epoch, epochs, label)``; an early stop reduces
        ``epochs``.
    """
    for key, names in (("observations", identity.elements), ("targets", identity.moves)):
        size = getattr(rows, key).shape[1]
        if size != len(names):
            raise InputError(f"the rows' {key} have {size} numbers; the game has {len(names)}")
    result = train_layers(rows, settings, clipped, relative, progress)
    network = RegretNetwork(
        name=name,
        identity=identity,
        target=settings.target if target is None else target,
        clipped=clipped,
        layers=result.layers,
        mean=result.mean,
        scale=result.scale,
        training=_summary(rows, settings, result),
    )
    return network, result


def _summary(
    rows: Rows, settings: TrainSettings, result: TrainingResult
) -> dict[str, str | int | float | bool]:
    """Return the facts about a training that its network states."""
    best = result.epochs[result.best]
    losses = {
        key: float(f"{value:.6g}")
        for key, value in best._asdict().items()
        if key != "epoch" and np.isfinite(value)  # epoch 0 has no training loss
    }
    options = {f"setting_{key}": value for key, value in plain_settings(settings).items()}
    return {
        "rows": len(rows),
        "starting_pairs": len(np.unique(rows.pair)),
        "validation_pairs": len(result.validation_pairs),
        "epochs": result.epochs[-1].epoch,
        **losses,
        "best_epoch": best.epoch,
        **options,
        "setting_hidden": ", ".join(str(width) for width in settings.hidden),
    }


def train_layers(
    rows: Rows,
    settings: TrainSettings,
    clipped: bool = False,
    relative: bool = False,
    progress: Progress | None = None,
) -> TrainingResult:
    """Train a network on rows of any game; see :func:`train_network`."""
    with torch_alone() as torch:
        held_out, pairs = split_by_pair(rows, VALIDATION_SHARE, settings.seed)
        training, validation = rows.take(~held_out), rows.take(held_out)
        # The scaling comes from the training rows alone, so that validation stays independent.
        by = scale_rows(training, clipped, relative)
        training_goals, validation_goals = (
            Goals(*map(torch.from_numpy, row_goals(part, by, clipped)))
            for part in (training, validation)
        )
        draws, start = (
            np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(key,)))
            for key in (1, 2)
        )
        sizes = [rows.observations.shape[1], *settings.hidden, rows.targets.shape[1]]
        model = _make_model(torch, sizes, start)
        optimiser = torch.optim.AdamW(
            model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        odds = np.cumsum(training.weights) / training.weights.sum()
        count = min(settings.rows_per_epoch, len(training))
        with torch.no_grad():
            scores = _score(model, validation, validation_goals, by)
        epochs, best, since = [Epoch(0, settings.learning_rate, float("nan"), *scores)], 0, 0
        kept = _layers_of(model)
        for number in range(1, settings.epochs + 1):
            # Inverse transform sampling, in proportion to the weights; rounding may leave the last
            # sum below 1.
            drawn = np.searchsorted(odds, draws.random(count), side="right")
            drawn = torch.from_numpy(np.minimum(drawn, len(training) - 1))
            total = 0.0
            for batch in drawn.split(settings.batch_size):
                losses = _losses(model, Goals(*(part[batch] for part in training_goals)), by)
                optimiser.zero_grad()
                losses.mean().backward()
                optimiser.step()
                total += float(losses.detach().sum())
            with torch.no_grad():
                scores = _score(model, validation, validation_goals, by)
            rate = optimiser.param_groups[0]["lr"]
            # The training loss is a mean over draws while the weights changed; only the validation
            # loss is a loss of fixed weights.
            epoch = Epoch(number, rate, total / count, *scores)
            epochs.append(epoch)
            if not np.isfinite(epoch.validation_loss):
                raise InputError(
                    f"the loss is {epoch.validation_loss} after epoch {number}; take a"
                    f" learning_rate below {settings.learning_rate:g}"
                )
            since += 1
            if epoch.validation_loss < epochs[best].validation_loss:
                best, since, kept = number, 0, _layers_of(model)
            elif since % max(settings.patience // 4, 1) == 0:
                optimiser.param_groups[0]["lr"] *= 0.5
            stopped = since == settings.patience
            if progress is not None:
                total_epochs = number if stopped else settings.epochs
                progress(number, total_epochs, f"validation loss {epoch.validation_loss:.4f}")
            if stopped:
                break
        return TrainingResult(_in_units(kept, by), by.mean, by.scale, tuple(epochs), best, pairs)


def _make_model(torch: Any, sizes: Sequence[int], rng: np.random.Generator) -> Any:
    """Return untrained layers with ReLUs between: weights as in He et al. 2015, biases 0."""
    parts: list[Any] = []
    for i, (below, above) in enumerate(pairwise(sizes)):
        gain = 2.0 if i < len(sizes) - 2 else 1.0  # no ReLU follows the last layer
        weight = rng.normal(0.0, np.sqrt(gain / below), (above, below)).astype(np.float32)
        linear = torch.nn.utils.skip_init(torch.nn.Linear, below, above)
        linear.weight.data, linear.bias.data = torch.from_numpy(weight), torch.zeros(above)
        parts += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*parts[:-1])


def _layers_of(model: Any) -> DenseLayers:
    """Return a copy of the weights and biases of a model."""
    arrays = [parameter.detach().numpy() for parameter in model.parameters()]
    return DenseLayers(tuple(arrays[::2]), tuple(arrays[1::2]))


def _losses(model: Any, goals: Goals, by: Scaling) -> Any:
    """Return the loss of each row, a tensor of shape (R,)."""
    error = model(goals.inputs) - goals.values
    # For a regret clipped to 0, any value below 0 is as good as 0.
    error = error.where(~goals.one_sided, error.clamp(min=0.0))
    if by.level is None:
        return (goals.weights * error * error).sum(dim=1)
    # Mean of a row's moves, and differences from it, each in units of its own spread.
    mean = (goals.weights * error).sum(dim=1, keepdim=True)
    difference = error - mean
    return (goals.weights * difference * difference).sum(dim=1) + (by.level * mean[:, 0]) ** 2


def _score(model: Any, rows: Rows, goals: Goals, by: Scaling) -> tuple[float, float]:
    """Return loss and agreement on rows."""
    losses = _losses(model, goals, by).numpy().astype(np.float64)
    predicted = model(goals.inputs).numpy() * by.size + by.centre
    choice = np.argmax(predicted, axis=1)
    agrees = best_moves(rows.targets)[np.arange(len(rows)), choice]
    share = rows.weights / rows.weights.sum()
    return float(share @ losses), float(share @ agrees)


def _in_units(layers: DenseLayers, by: Scaling) -> DenseLayers:
    """Return layers whose outputs are in units of the targets, not of the training."""
    weights = (*layers.weights[:-1], layers.weights[-1] * by.size)
    biases = (*layers.biases[:-1], layers.biases[-1] * by.size + by.centre)
    return DenseLayers(weights, biases)


def write_epochs(result: TrainingResult, file: Path) -> Path:
    """Write a line for each epoch to a CSV file."""
    rows = [(str(epoch.epoch), *(f"{value:.7g}" for value in epoch[1:])) for epoch in result.epochs]
    return write_csv([Epoch._fields, *rows], file)
