"""MO-CMA-ES, Algorithm 1 of the paper: one CMA-ES that hunts for points that add hypervolume to an archive.

The comments in :meth:`MOCMAES.ask` and :meth:`MOCMAES.tell` are the lines of the algorithm. Where it leaves room:

- Line 8: a point's loss is minus the hypervolume that it would add to the archive or, where it would add none, its
  distance to the nearest place where it would (``loss="uhvi"``). The literal reading, the hypervolume of archive and
  point together (``loss="total_hypervolume"``), does not tell one dominated point from another.
- Line 8: objectives are normalised by the front as it is then, this generation included, since no other range is known;
  the reference point lies a tenth of that range below its nadir.
- Line 13: the mean moves to the recombined elite of this generation, as in CMA-ES (``mean="generation"``). The literal
  reading is the mean of the archive's Pareto set (``mean="archive"``): where that set is no straight line, it is the
  mean of points far from each other.
- The paper never restarts. Here, once the step size has collapsed or the archive has stopped growing, the search starts
  again at a point of the front, the likelier the more hypervolume it contributes: there the front is thin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.errors import InputError
from pcs_racing.mapping.optional import require
from pcs_racing_agents.synthesis.explored import Explored, Scale
from pcs_racing_agents.synthesis.indicators import (
    contributions,
    hypervolume,
    total_hypervolume,
    uncrowded_improvement,
)

__all__ = ["LOSSES", "MEANS", "MOCMAES", "Setting", "cma_es", "hypervolume_loss"]

Floats = NDArray[np.float64]

LOSSES = ("uhvi", "total_hypervolume")
MEANS = ("generation", "archive")
SMALLEST_STEP = 1e-4  # of the range of the parameters
PATIENCE = 10  # generations
LEAST_GAIN = 1e-5  # of the normalised hypervolume, in a generation


@dataclass(frozen=True, eq=False)
class Setting:
    """What an optimiser knows beforehand. Optimisers work in the unit cube and maximise.

    Attributes
    ----------
    dimension : int
        Parameters, P.
    population : int
        Points of a generation, n.
    seed : SeedSequence
    elite_ratio : float
        Share of a generation that is recombined and added to the archive (lambda of Algorithm 1).
    loss, mean : str
        Reading of Algorithm 1.
    start : ndarray, shape (P,)
        First mean.
    step_size : float
        First standard deviation.
    reference : float or ndarray, shape (G,)
        Reference point in normalised objectives.
    ideal, nadir : ndarray, shape (G,), optional
        Fixed points for the normalisation.
    """

    dimension: int
    population: int
    seed: np.random.SeedSequence
    elite_ratio: float
    loss: str
    mean: str
    start: Floats
    step_size: float
    reference: float | Floats
    ideal: Floats | None
    nadir: Floats | None


class MOCMAES:
    """Algorithm 1, asked for points and told how good they are.

    Attributes
    ----------
    restarts : int
    """

    def __init__(self, setting: Setting) -> None:
        # Line 2: initialise lambda, mu, sigma, C = I, p_sigma = p_c = 0. The archive is empty.
        self.restarts = 0
        self._setting = setting
        self._elite = max(1, round(setting.elite_ratio * setting.population))
        self._rng = np.random.default_rng(setting.seed)
        self._stalled = 0
        self._es = self._started(setting.start, setting.step_size)
        self._asked: list[Floats] = []

    @property
    def step_size(self) -> float:
        """Largest standard deviation of a parameter, as a share of its range."""
        return float(self._es.sigma * np.sqrt(np.max(self._es.sm.variances)))

    def ask(self) -> Floats:
        """Return a generation of points, shape (n, P), in the unit cube."""
        # Lines 4-5: sample theta_i from N(mu, sigma^2 C). pycma wants the very same arrays back.
        self._asked = self._es.ask()
        return np.clip(np.stack(self._asked), 0.0, 1.0)

    def tell(self, points: Floats, objectives: Floats, violation: Floats, archive: Explored) -> Explored:
        """Learn from the generation that was asked for, and return the archive with its best points in it."""
        # Line 8: the hypervolume loss against the archive.
        scale = archive.joined(points, objectives, violation).scale(self._setting.ideal, self._setting.nadir)
        loss = hypervolume_loss(self._setting.loss, archive, objectives, violation, scale, self._setting.reference)
        # Line 9: sort. Infeasible points come last, by how much they violate.
        order = np.lexsort((loss, np.maximum(violation, 0.0)))
        # Line 10: the best lambda join the archive.
        elite = np.zeros(len(points), np.bool_)
        elite[order[: self._elite]] = True
        grown = archive.joined(points, objectives, violation, elite)
        # Lines 11-12: evolution paths, step size and covariance. CMA-ES asks for nothing but ranks.
        ranks = np.empty(len(points))
        ranks[order] = np.arange(len(points))
        self._es.tell(self._asked, ranks.tolist())
        # Line 13: the mean.
        if self._setting.mean == "archive" and len(grown.front):
            self._es.mean = grown.parameters[grown.front].mean(axis=0)
        self._restart_if_done(archive, grown, scale)
        return grown

    def _restart_if_done(self, before: Explored, after: Explored, scale: Scale) -> None:
        # As long as nothing feasible is known, there is no hypervolume to stand still.
        if len(after.front):
            old, new = (
                hypervolume(scale(known.objectives[known.front]), self._setting.reference) if len(known.front) else 0.0
                for known in (before, after)
            )
            self._stalled = 0 if new - old > LEAST_GAIN else self._stalled + 1
        collapsed = not SMALLEST_STEP < self.step_size < np.inf or self._es.condition_number > 1e14
        if not collapsed and self._stalled < PATIENCE:
            return
        self.restarts += 1
        self._stalled = 0
        setting = self._setting
        if len(after.front) == 0:
            self._es = self._started(self._rng.random(setting.dimension), setting.step_size)
            return
        share = contributions(scale(after.objectives[after.front]), setting.reference)
        share = share + max(1e-9, 1e-3 * float(share.mean()))  # points below the reference have a chance too
        chosen = self._rng.choice(after.front, p=share / share.sum())
        self._es = self._started(after.parameters[chosen], 0.5 * setting.step_size)

    def _started(self, mean: Floats, step_size: float) -> Any:
        return cma_es(mean, step_size, self._setting.population, self._elite, self._rng)


def hypervolume_loss(
    kind: str,
    archive: Explored,
    objectives: Floats,
    violation: Floats,
    scale: Scale,
    reference: float | Floats,
) -> Floats:
    """Loss of points against the Pareto front of an archive (line 8 of Algorithm 1), shape (n,).

    Infeasible points have no place among the others: infinite.

    Parameters
    ----------
    kind : {"uhvi", "total_hypervolume"}
    archive : Explored
    objectives : ndarray, shape (n, G)
    violation : ndarray, shape (n,)
    scale : Scale
    reference : float or ndarray, shape (G,)
        In units of the scale.
    """
    loss = np.full(len(objectives), np.inf)
    feasible = violation <= 0.0
    if feasible.any():
        front = scale(archive.objectives[archive.front]) if len(archive.front) else np.zeros((0, objectives.shape[1]))
        measure = uncrowded_improvement if kind == "uhvi" else total_hypervolume
        loss[feasible] = -measure(scale(objectives[feasible]), front, reference)
    return loss


def cma_es(
    mean: Floats,
    step_size: float,
    population: int,
    elite: int,
    rng: np.random.Generator,
    strategy: Callable[..., Any] | None = None,
) -> Any:
    """Return pycma's CMA-ES in the unit cube, drawing from a given generator instead of numpy's global one.

    Points outside are moved to the border and punished by their distance from it.

    Parameters
    ----------
    mean : ndarray, shape (P,)
    step_size : float
    population, elite : int
        Points of a generation, and how many of them are recombined.
    rng : Generator
    strategy : class, optional
        A subclass of ``cma.CMAEvolutionStrategy``.

    Raises
    ------
    InputError
        If there is only one parameter.
    """
    if len(mean) < 2:
        raise InputError("CMA-ES needs at least 2 parameters; there is 1")
    require("cma", extra="synthesis")
    import cma

    options = {
        "bounds": [0.0, 1.0],
        "BoundaryHandler": cma.BoundPenalty,
        "popsize": population,
        "CMA_mu": elite,
        "seed": np.nan,  # don't touch numpy's global generator
        "randn": lambda *shape: rng.standard_normal(shape),
        "verbose": -10,  # says nothing and reads no file of signals
        "verb_log": 0,
    }
    return (strategy or cma.CMAEvolutionStrategy)(mean, step_size, options)
