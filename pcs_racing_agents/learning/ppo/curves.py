"""Learning curves: as CSV, for TensorBoard, and as a picture."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.learning.ppo.scores import Cell, Score, total
from pcs_racing_agents.results.csv_files import read_csv

__all__ = ["Curve", "read_curve", "write_curve", "write_picture", "write_tensorboard"]

COLUMNS = ("seed", "steps", *Cell._fields, *Score._fields)
COLOURS = ("#1f6fd6", "#f0a202", "#2a9d5c", "#c43d3d", "#7a4fc0")


class Curve(NamedTuple):
    """How a learner was judged while it learned.

    Attributes
    ----------
    seed : int
    steps : tuple of int
        When.
    scores : tuple of mapping of Cell to Score
        What came of it.
    """

    seed: int
    steps: tuple[int, ...]
    scores: tuple[Mapping[Cell, Score], ...]


def write_curve(curves: Sequence[Curve], file: Path) -> Path:
    """Write a line for each seed, moment, circuit, rules and opponent."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for curve in curves:
        for steps, scores in zip(curve.steps, curve.scores, strict=True):
            for cell, score in scores.items():
                figures = [score.races, *(f"{value:.6g}" for value in score[1:])]
                writer.writerow([curve.seed, steps, *cell, *figures])
    write_atomically(file, lambda stream: stream.write(text.getvalue().encode("utf-8")))
    return file


def read_curve(file: Path) -> list[Curve]:
    """Read what :func:`write_curve` wrote.

    Raises
    ------
    InputError
        If it is something else.
    """
    found: dict[int, dict[int, dict[Cell, Score]]] = {}
    table = read_csv(file)
    if table.columns != COLUMNS:
        raise InputError(f"{file} has columns {', '.join(table.columns)}; a curve has {', '.join(COLUMNS)}")
    for number, row in table.lines():
        try:
            score = Score(int(row["races"]), *(float(row[key]) for key in Score._fields[1:]))
            cell = Cell(*(row[key] for key in Cell._fields))
            found.setdefault(int(row["seed"]), {}).setdefault(int(row["steps"]), {})[cell] = score
        except ValueError as error:
            raise InputError(f"{file}, line {number} is none of a learning curve: {error}") from None
    return [Curve(seed, tuple(moments), tuple(moments.values())) for seed, moments in found.items()]


def write_tensorboard(curves: Sequence[Curve], weights: Mapping[str, int], folder: Path) -> Path:
    """Write the curves for ``tensorboard --logdir FOLDER``; earlier curves in the folder are replaced.

    Raises
    ------
    ModuleNotFoundError
        If tensorboard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'curves for TensorBoard need torch and tensorboard: pip install "pcs-racing[learning]"'
        ) from None
    for old in folder.glob("seed-*/events.out.tfevents.*"):
        old.unlink()
    for curve in curves:
        with SummaryWriter(str(folder / f"seed-{curve.seed}")) as writer:
            for steps, scores in zip(curve.steps, curve.scores, strict=True):
                for key, value in total(scores, weights)._asdict().items():
                    writer.add_scalar(f"evaluation/{key}", value, steps)
    return folder


def write_picture(curves: Sequence[Curve], weights: Mapping[str, int], file: Path, title: str, unit: str) -> Path:
    """Draw worth, wins and faults over the steps, a line for each seed.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError('a picture needs matplotlib: pip install "pcs-racing[plots]"') from None
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    axes: Any = figure.subplots(1, 3)
    panels = (("worth", "worth of a race"), ("won", "races won"), ("at_fault", "crashes by own fault"))
    for k, curve in enumerate(curves):
        totals = [total(scores, weights) for scores in curve.scores]
        at = np.array(curve.steps) / 1e6
        for panel, (key, what) in zip(axes, panels, strict=True):
            values = np.array([getattr(score, key) for score in totals])
            panel.plot(at, values, color=COLOURS[k % len(COLOURS)], label=f"seed {curve.seed}")
            if key == "worth":
                error = np.array([score.error for score in totals])
                panel.fill_between(at, values - error, values + error, color=COLOURS[k % len(COLOURS)], alpha=0.2, lw=0)
            panel.set_title(what, fontsize=10, loc="left")
    for panel in axes:
        panel.set_xlabel(f"million {unit}")
        panel.grid(color="#eef0f3")
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    for panel in axes[1:]:
        panel.set_ylim(-0.02, 1.02)
    axes[0].legend(frameon=False, fontsize=9)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    write_atomically(file, lambda stream: figure.savefig(stream, format="png", dpi=120))
    return file
