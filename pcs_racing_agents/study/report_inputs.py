"""What the stages of a study left behind, as the report wants it."""

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.jobs.folders import package_version
from pcs_racing_agents.pictures.curves import Curve
from pcs_racing_agents.results.csv_files import read_csv
from pcs_racing_agents.study.table import StudyTable

__all__ = [
    "Place",
    "TreeLoss",
    "mean_losses",
    "mean_scores",
    "places_of",
    "read_curves",
    "read_losses",
    "software",
]

Floats = NDArray[np.float64]


class Place(NamedTuple):
    """Where an agent stands between strong and safe.

    Attributes
    ----------
    name : str
    score, score_error : float
        Mean score and its standard error (0 where it is not known).
    loss, loss_error : float
        What it loses to an opponent that knows it, and the standard error.
    """

    name: str
    score: float
    score_error: float
    loss: float
    loss_error: float


class TreeLoss(NamedTuple):
    """What an agent loses on the held-out trees of a circuit.

    Attributes
    ----------
    track, agent : str
    trees : int
    columns : tuple of (mean, standard error)
        Lost to its best response, lost to the equilibrium, and what it gets from random moves; the errors are NaN for
        a single tree, and so is what was not found out.
    """

    track: str
    agent: str
    trees: int
    columns: tuple[tuple[float, float], ...]


LARGEST = 1e100
LOSSES = ("lost_to_best_response", "lost_to_equilibrium", "against_random")


def read_losses(path: str | Path) -> list[TreeLoss]:
    """Read what the stage "exploitability" wrote: a line for each circuit, agent and tree.

    Raises
    ------
    InputError
        If the file can't be read or lacks a column.
    """
    found: dict[tuple[str, str], list[list[float]]] = {}
    for row in _rows(path, ("track", "agent", *LOSSES)):
        found.setdefault((row["track"], row["agent"]), []).append([_number(row[name], path) for name in LOSSES])
    losses = []
    for (track, agent), rows in found.items():
        values = np.array(rows)
        errors = values.std(axis=0, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.full(3, np.nan)
        columns = tuple(zip(values.mean(axis=0).tolist(), errors.tolist(), strict=True))
        losses.append(TreeLoss(track, agent, len(values), columns))
    return losses


def read_curves(path: str | Path, *columns: str, x: str = "epoch") -> list[Curve]:
    """Read learning curves; by default training and validation loss, as they stand beside a trained network.

    Raises
    ------
    InputError
        If the file can't be read or lacks a column.
    """
    names = columns or ("training_loss", "validation_loss")
    rows = _rows(path, (x, *names))
    steps = np.array([_number(row[x], path) for row in rows])
    return [
        Curve(steps, np.array([_number(row[name], path) for row in rows]), name.removesuffix("_loss").replace("_", " "))
        for name in names
    ]


def mean_losses(losses: Sequence[TreeLoss]) -> dict[str, TreeLoss]:
    """Return what each agent loses, mean over circuits with equal weight; errors are those of the mean."""
    found = {}
    for agent in dict.fromkeys(loss.agent for loss in losses):
        own = [loss for loss in losses if loss.agent == agent]
        values = np.array([loss.columns for loss in own], np.float64)  # circuits, columns, (mean, error)
        errors = np.sqrt((values[:, :, 1] ** 2).sum(axis=0)) / len(own)
        columns = tuple(zip(values[:, :, 0].mean(axis=0).tolist(), errors.tolist(), strict=True))
        found[agent] = TreeLoss(", ".join(loss.track for loss in own), agent, sum(loss.trees for loss in own), columns)
    return found


def mean_scores(table: StudyTable | None) -> dict[str, float]:
    """Return each agent's score, mean over the rows of a table; without those that did not race in all of them."""
    if table is None:
        return {}
    rows = [{result.arm: result.score for result in row.arms} for row in table.rows]
    return {arm: float(np.mean([row[arm] for row in rows])) for arm in table.arms if all(arm in row for row in rows)}


def places_of(table: StudyTable | None, losses: Sequence[TreeLoss]) -> list[Place]:
    """Return where agents stand whose score and whose exploitability are known, means over rows and circuits."""
    scores = mean_scores(table)
    return [
        Place(agent, scores[agent], 0.0, loss.columns[0][0], float(np.nan_to_num(loss.columns[0][1])))
        for agent, loss in mean_losses(losses).items()
        if agent in scores
    ]


def software() -> dict[str, str]:
    """Return versions of what the results depend on, and the machine."""
    found = {"pcs-racing": package_version(), "Python": platform.python_version()}
    for library in ("numpy", "numba", "torch", "cma", "moocore", "scipy", "matplotlib"):
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            continue
    return {**found, "machine": f"{platform.system()} {platform.machine()}"}


def _rows(path: str | Path, wanted: Sequence[str]) -> list[dict[str, str]]:
    table = read_csv(path)
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        raise InputError(f"{path} has no column {missing[0]!r}")
    return table.rows()


def _number(text: str | None, path: str | Path) -> float:
    try:
        value = float(text) if text else np.nan
    except ValueError:
        value = np.inf
    if np.isinf(value) or abs(value) > LARGEST:
        raise InputError(f"{path} holds {text!r} where a number should be")
    return value
