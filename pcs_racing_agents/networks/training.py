"""Training of a network on rows: AdamW, validation on held-out starting pairs, early stopping.

The same settings and rows give the same network: initial weights and draws come from numpy
generators of the settings' seed, torch runs in one thread, and its own random state is neither read
nor changed.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.tables import write_csv
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import Rows, split_by_pair
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.networks.targets import best_moves
from pcs_racing_agents.networks.torch_layers import (
    initial_layers,
    layers_from_torch,
    relu_forward,
    torch_alone,
)

Floats = NDArray[np.float32]


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
    #: Weighted mean of the highest target minus the target of the chosen move, in units of the
    #: target.
    validation_shortfall: float


class TrainingResult(NamedTuple):
    """Layers of a trained network, and history of its training."""

    #: ``layers``, ``mean``, ``scale``: Fields of :class:`pcs_racing_agents.networks.RegretNetwork`.
    layers: DenseLayers
    mean: Floats
    scale: Floats
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
    progress: Progress | None = None,
) -> tuple[RegretNetwork, TrainingResult]:
    """Train a network on rows of its game, from any source.

    Parameters
    ----------
    target : str, optional
        Kind of the rows' targets; by default the settings' target.
    clipped : bool
        True if the network learns and returns targets below 0 as 0.
    progress : callable, optional
        Called after every epoch as ``progress(epoch, epochs, label)``; an early stop reduces
        ``epochs``.
    """
    for key, names in (("observations", identity.elements), ("targets", identity.moves)):
        size = getattr(rows, key).shape[1]
        if size != len(names):
            raise InputError(f"the rows' {key} have {size} numbers; the game has {len(names)}")
    result = train_layers(rows, settings, clipped=clipped, progress=progress)
    best = result.epochs[result.best]
    summary: dict[str, str | int | float | bool] = {
        "rows": len(rows),
        "starting_pairs": len(np.unique(rows.pair)),
        "validation_pairs": len(result.validation_pairs),
        "epochs": result.epochs[-1].epoch,
        # Epoch 0 has no training loss.
        **{
            k: v if k == "epoch" else float(f"{v:.6g}")
            for k, v in best._asdict().items()
            if np.isfinite(v)
        },
    }
    summary["best_epoch"] = summary.pop("epoch")
    hidden = ", ".join(str(width) for width in settings.hidden)
    for key, value in plain_settings(settings).items():
        if value is not None:
            summary[f"setting_{key}"] = hidden if key == "hidden" else value
    network = RegretNetwork(
        name=name,
        identity=identity,
        target=settings.target if target is None else target,
        clipped=clipped,
        layers=result.layers,
        mean=result.mean,
        scale=result.scale,
        training=summary,
    )
    return network, result


def train_layers(
    rows: Rows, settings: TrainSettings, *, clipped: bool = False, progress: Progress | None = None
) -> TrainingResult:
    """Train a network on rows of any game; see :func:`train_network`."""
    with torch_alone() as torch:
        return _train(torch, rows, settings, clipped, progress)


def _train(
    torch: Any, rows: Rows, settings: TrainSettings, clipped: bool, progress: Progress | None
) -> TrainingResult:
    held_out, pairs = split_by_pair(rows, settings.validation_share, settings.seed)
    training, validation = rows.take(~held_out), rows.take(held_out)
    # The scaling comes from the training rows alone, so that validation stays independent.
    by = scale_rows(training, settings, clipped)
    draws, start = (
        np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(key,)))
        for key in (1, 2)
    )

    def tensors(rows_used: Rows) -> tuple[Any, Any, Any, Any]:
        x = (rows_used.observations - by.mean) / by.scale
        arrays = (x, *row_goals(rows_used, by, clipped, settings.below_zero))
        return tuple(torch.from_numpy(array) for array in arrays)

    def loss(x: Any, goal: Any, weight: Any, one_sided: Any) -> Any:
        error = relu_forward(layers, x) - goal
        # Where the goal is a regret clipped to 0, any value below 0 is as good as 0.
        error = torch.where(one_sided, error.clamp(min=0.0), error)
        if not settings.differences or clipped:
            return (weight * error * error).sum(dim=1)
        # Mean of a row's moves, and differences from it, each in units of its own spread.
        mean = (weight * error).sum(dim=1, keepdim=True)
        difference = error - mean
        return (weight * difference * difference).sum(dim=1) + (by.level * mean[:, 0]) ** 2

    def judge(number: int, training_loss: float) -> Epoch:
        with torch.no_grad():
            each = loss(*validation_tensors).numpy().astype(np.float64)
            predicted = relu_forward(layers, validation_tensors[0]).numpy() * by.size + by.centre
        share = validation.weights / validation.weights.sum()
        choice = np.argmax(np.where(validation.mask, predicted, -np.inf), axis=1)
        highest = np.where(validation.mask, validation.targets, -np.inf).max(axis=1)
        chosen = np.arange(len(validation)), choice
        return Epoch(
            number,
            optimiser.param_groups[0]["lr"],
            training_loss,
            float(share @ each),
            float(share @ best_moves(validation.targets, validation.mask)[chosen]),
            float(share @ (highest - validation.targets[chosen]).astype(np.float64)),
        )

    layers = initial_layers(
        [rows.observations.shape[1], *settings.hidden, rows.targets.shape[1]], start
    )
    optimiser = torch.optim.AdamW(
        layers, lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    training_tensors, validation_tensors = tensors(training), tensors(validation)
    odds = np.cumsum(training.weights) / training.weights.sum()
    count = min(settings.rows_per_epoch, len(training))
    epochs, best, since = [judge(0, float("nan"))], 0, 0
    kept = [layer.detach().clone() for layer in layers]
    for number in range(1, settings.epochs + 1):
        # Inverse transform sampling, in proportion to the weights; rounding may leave the last sum
        # below 1.
        drawn = np.minimum(
            np.searchsorted(odds, draws.random(count), side="right"), len(training) - 1
        )
        total = 0.0
        for first in range(0, count, settings.batch_size):
            batch = torch.from_numpy(drawn[first : first + settings.batch_size])
            each = loss(*(tensor[batch] for tensor in training_tensors))
            optimiser.zero_grad()
            each.mean().backward()
            optimiser.step()
            total += float(each.detach().sum())
        # The training loss is a mean over draws while the weights changed; only the validation loss
        # is a loss of fixed weights.
        epochs.append(judge(number, total / count))
        if not np.isfinite(epochs[-1].validation_loss):
            raise InputError(
                f"the loss is {epochs[-1].validation_loss} after epoch {number}; take a"
                f" learning_rate below {settings.learning_rate:g}"
            )
        since += 1
        if epochs[-1].validation_loss < epochs[best].validation_loss:
            best, since = number, 0
            # The optimiser changes the tensors in place, so the best weights are copied.
            kept = [layer.detach().clone() for layer in layers]
        elif since % max(settings.patience // 4, 1) == 0:
            optimiser.param_groups[0]["lr"] *= 0.5
        if progress is not None:
            total_epochs = number if since == settings.patience else settings.epochs
            progress(number, total_epochs, f"validation loss {epochs[-1].validation_loss:.4f}")
        if since == settings.patience:
            break
    scaled = layers_from_torch(kept)
    # The last layer's outputs are in units of training, the network's outputs in units of targets.
    weights = (*scaled.weights[:-1], scaled.weights[-1] * by.size)
    biases = (*scaled.biases[:-1], scaled.biases[-1] * by.size + by.centre)
    return TrainingResult(
        DenseLayers(weights, biases), by.mean, by.scale, tuple(epochs), best, pairs
    )


# Goals of the outputs, in units of order 1


class Scaling(NamedTuple):
    """Scaling of inputs and targets to order 1."""

    mean: Floats  #: shape (D,): ``mean``, ``scale``: Scaling of the inputs.
    scale: Floats
    #: Maximum distance of a target below the highest of its row; infinite without a floor.
    depth: float
    centre: Floats  #: shape (A,): Mean target of each move; 0 for clipped targets.
    size: np.float32  #: Unit of the targets.
    #: Mean square, in units of ``size``, of targets in rows without a positive target.
    hopeless: float
    level: float  #: ``size`` in units of the spread of the rows' means, at most 1.


def scale_rows(rows: Rows, settings: TrainSettings, clipped: bool) -> Scaling:
    """Return the scaling of rows from their weighted means and spreads.

    Inputs get mean 0 and deviation 1 (a constant input retains its unit). Targets are measured
    around every move's mean (around 0 if clipped: 0 must stay 0), in units of their root mean
    square.
    """
    share = rows.weights / rows.weights.sum()
    mean = share @ rows.observations.astype(np.float64)
    deviation = np.sqrt(share @ (rows.observations - mean) ** 2)
    known_share = share[:, None] * rows.mask
    total = known_share.sum(axis=0)
    depth = np.inf
    if settings.floor and not clipped:
        # The floor is in units of the mean loss of random moves, so that it is comparable for all
        # targets.
        below_highest = _highest(rows) - rows.targets
        depth = settings.floor * np.sum(known_share * below_highest) / total.sum() or np.inf
    targets = _raised(rows, depth).astype(np.float64)
    if clipped:
        centre, values = np.zeros(targets.shape[1]), np.maximum(targets, 0.0)
        level = size = np.sqrt(np.sum(known_share * values**2) / total.sum()) or 1.0
    else:
        centre = np.sum(known_share * targets, axis=0) / np.where(total > 0.0, total, 1.0)
        values = np.where(rows.mask, targets - centre, 0.0)
        means = values.sum(axis=1, keepdims=True) / rows.mask.sum(axis=1, keepdims=True)
        if settings.differences:
            values = np.where(rows.mask, values - means, 0.0)
        size = np.sqrt(np.sum(known_share * values**2) / total.sum()) or 1.0
        # The mean never counts more than the differences: means of advantages hold no information.
        level = max(np.sqrt(share @ means[:, 0] ** 2), size)
    # Depth below 0 of the targets in rows without a positive target, in units of ``size``.
    known_share = known_share * ~(targets > 0.0).any(axis=1, keepdims=True)
    hopeless = (
        np.sum(known_share * (targets / size) ** 2) / known_share.sum()
        if known_share.any()
        else 1.0
    )
    return Scaling(
        mean.astype(np.float32),
        # A constant input has no information; divided by its deviation it would be noise.
        np.where(deviation > 1e-6, deviation, 1.0).astype(np.float32),
        float(depth),
        centre.astype(np.float32),
        np.float32(size),
        float(hopeless),
        float(size / level),
    )


def _highest(rows: Rows) -> Floats:
    return np.where(rows.mask, rows.targets, -np.inf).max(axis=1, keepdims=True)


def _raised(rows: Rows, depth: float) -> Floats:
    """Return targets, raised to at most ``depth`` below the highest target of their row."""
    if np.isinf(depth):
        return rows.targets
    return np.where(
        rows.mask, np.maximum(rows.targets, _highest(rows) - np.float32(depth)), np.float32(0.0)
    )


def row_goals(
    rows: Rows, by: Scaling, clipped: bool, below_zero: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return goals of the outputs, weights of their errors, and a mask of one-sided errors.

    Of one-sided errors only errors upwards count.
    """
    goal = (_raised(rows, by.depth) - by.centre) / by.size
    weight = (rows.mask / rows.mask.sum(axis=1, keepdims=True)).astype(np.float32)
    if not clipped:
        return goal, weight, np.zeros(goal.shape, np.bool_)
    one_sided = goal <= 0.0
    if below_zero > 0.0:
        # In a row without a positive regret clipped values do not identify the least bad move. Such
        # rows can lie far below 0: they count in units of their own spread.
        hopeless = ~(goal > 0.0).any(axis=1, keepdims=True)
        one_sided &= ~hopeless
        weight = np.where(hopeless, np.float32(below_zero / max(by.hopeless, 1.0)) * weight, weight)
    return np.where(one_sided, np.float32(0.0), goal), weight, one_sided


# Reports


def write_epochs(result: TrainingResult, file: Path) -> Path:
    """Write a line for each epoch to a CSV file."""
    rows = [(str(epoch.epoch), *(f"{value:.7g}" for value in epoch[1:])) for epoch in result.epochs]
    return write_csv([Epoch._fields, *rows], file)


def epoch_curves(result: TrainingResult) -> dict[str, list[Curve]]:
    """Return losses and agreement over the epochs, as panels of a picture."""
    columns = dict(zip(Epoch._fields, np.array(result.epochs, np.float64).T, strict=True))

    def curve(key: str) -> Curve:
        return Curve(columns["epoch"], columns[key], key.partition("_")[0])

    return {
        "loss": [curve("training_loss"), curve("validation_loss")],
        "share of choices that are best": [curve("validation_agreement")],
    }
