"""Learning curves: as CSV, for TensorBoard, and as a picture."""

import csv
import io
from pathlib import Path
from typing import Any

from pcs_racing.base.files import write_atomically
from pcs_racing_agents.networks.training import Epoch, Fit

__all__ = ["write_curves", "write_picture", "write_tensorboard"]


def write_curves(fit: Fit, file: Path) -> Path:
    """Write one line for each epoch to a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Epoch._fields)
    for epoch in fit.epochs:
        writer.writerow([epoch.epoch, *(f"{value:.7g}" for value in epoch[1:])])
    write_atomically(file, lambda stream: stream.write(text.getvalue().encode("utf-8")))
    return file


def write_tensorboard(fit: Fit, folder: Path) -> Path:
    """Write the curves for ``tensorboard --logdir FOLDER``; earlier curves in the folder are replaced.

    Raises
    ------
    ModuleNotFoundError
        If torch or tensorboard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'curves for TensorBoard need torch and tensorboard: pip install "pcs-racing[learning]"'
        ) from None
    for old in folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(str(folder)) as writer:
        for epoch in fit.epochs:
            for key, value in epoch._asdict().items():
                if key != "epoch" and value == value:  # a NaN stands for "not known yet"
                    writer.add_scalar(key.replace("_", "/", 1), value, epoch.epoch)
    return folder


def write_picture(fit: Fit, file: Path, title: str) -> Path:
    """Draw losses and agreement over the epochs.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError('a picture needs matplotlib: pip install "pcs-racing[plots]"') from None
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    losses, choices = figure.subplots(1, 2)
    numbers = [epoch.epoch for epoch in fit.epochs]
    series: tuple[tuple[Any, str, str, str], ...] = (
        (losses, "training_loss", "training", "#8a94a3"),
        (losses, "validation_loss", "validation", "#1f6fd6"),
        (choices, "validation_agreement", "validation", "#1f6fd6"),
    )
    for axes, key, label, colour in series:
        axes.plot(numbers, [getattr(epoch, key) for epoch in fit.epochs], color=colour, label=label)
    for axes, what in ((losses, "loss"), (choices, "share of choices that are best")):
        axes.axvline(fit.epochs[fit.best].epoch, color="#f0a202", linewidth=1.0, label="kept")
        axes.set_xlabel("epoch")
        axes.set_title(what, fontsize=10, loc="left")
        axes.grid(color="#eef0f3")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    losses.set_yscale("log")
    losses.legend(frameon=False, fontsize=9)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    write_atomically(file, lambda stream: figure.savefig(stream, format="png", dpi=120))
    return file
