"""MO-CMA-ES, Algorithm 1 of the paper: CMA-ES on the hypervolume that points add to an archive.

The comments in :meth:`MOCMAES.ask` and :meth:`MOCMAES.tell` are the lines of the algorithm. Choices
where the paper leaves room:

- Line 8: the loss of a point is minus the hypervolume that the point adds to the archive. If it
  adds none, the loss is the distance to the nearest place where a point adds hypervolume
  (``loss="uhvi"``). The literal reading, the hypervolume of archive and point together
  (``loss="total_hypervolume"``), is the same for all dominated points.
- Line 8: objectives are normalised by the current front, this generation included, since no other
  range is known. The reference point lies a tenth of that range below the nadir.
- Line 13: the mean moves to the recombined elite of this generation, as in CMA-ES
  (``mean="generation"``). The literal reading is the mean of the archive's Pareto set
  (``mean="archive"``): if that set is no straight line, it is the mean of distant points.
- Bounds of parameters are not in the paper. Samples outside the bounds are moved to the border, but
  CMA-ES learns from the original samples: so its mean can settle beyond a border and hold a
  parameter at its limit. The mean stays within three standard deviations of the box, and the step
  size within twice its first value.
- Restarts are not in the paper. Here, once the step size has collapsed or the archive has stopped
  growing, the search restarts at a random point of the front. Points that contribute more
  hypervolume, where the front is thin, are more likely.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing_agents.policies.indicators import (
    contributions,
    hypervolume,
    total_hypervolume,
    uncrowded_improvement,
)
from pcs_racing_agents.policies.pareto_archive import ParetoArchive, Scale

Floats = NDArray[np.float64]

LOSSES = ("uhvi", "total_hypervolume")
MEANS = ("generation", "archive")
SMALLEST_STEP = 1e-4  # share of the range of the parameters
PATIENCE = 10  # generations
LEAST_GAIN = 1e-5  # normalised hypervolume per generation


@dataclass(frozen=True, eq=False)
class OptimiserOptions:
    """Options of an optimiser. Optimisers work in the unit cube and maximise."""

    dimension: int  #: Number of parameters, P.
    population: int  #: Number of points per generation, n.
    seed: np.random.SeedSequence
    #: Share of a generation that is recombined and added to the archive (lambda of Algorithm 1).
    elite_ratio: float
    loss: str  #: ``loss``, ``mean``: Reading of Algorithm 1.
    mean: str
    #: shape (P,): First mean. Without a first mean the first generation is a sample of the whole
    #: cube (:func:`latin_hypercube`), and the search starts in the middle of its best points, with
    #: half the step size.
    start: Floats | None
    step_size: float  #: First standard deviation.
    reference: float | Floats  #: shape (G,): Reference point in normalised objectives.
    ideal: Floats | None  #: shape (G,): ``ideal``, ``nadir``: Fixed points for the normalisation.
    nadir: Floats | None


class CubeCMAES:
    """CMA-ES of pycma in the unit cube, with a given generator instead of numpy's global generator.

    The step size stays below ``largest``; ``elite`` of ``population`` points per generation are
    recombined.
    """

    def __init__(
        self,
        mean: Floats,
        step_size: float,
        largest: float,
        population: int,
        elite: int,
        rng: np.random.Generator,
    ) -> None:
        if len(mean) < 2:
            raise InputError("CMA-ES needs at least 2 parameters; there is 1")
        require("cma", extra="synthesis")
        import cma

        self._largest = largest
        self._samples: list[Floats] = []
        self._es = cma.CMAEvolutionStrategy(
            mean,
            step_size,
            {**cma_options(rng), "popsize": population, "CMA_mu": elite, "maxstd": 1.0 / 3.0},
        )

    @property
    def step_size(self) -> float:
        """Maximum standard deviation of a parameter."""
        return float(np.max(self._es.stds))

    @property
    def degenerate(self) -> bool:
        """True if the distribution has collapsed or diverged."""
        return not SMALLEST_STEP < self.step_size < np.inf or self._es.condition_number > 1e14

    def ask(self) -> Floats:
        """Return a generation of points, shape (n, P); some may lie outside the cube."""
        self._samples = self._es.ask()
        return np.stack(self._samples)

    def tell(self, ranks: Floats) -> None:
        """Update the distribution from the points' ranks, the only input of CMA-ES."""
        self._es.tell(self._samples, ranks.tolist())
        # Without a limit the step size may grow until all points lie on the border.
        self._es.sigma = min(self._es.sigma, self._largest)
        self.move(self._es.mean)

    def move(self, mean: Floats) -> None:
        """Set the mean."""
        # Points are moved to the border before their evaluation, so nothing else limits the mean.
        room = 3.0 * self._es.stds
        self._es.mean = np.clip(mean, -room, 1.0 + room)


def cma_options(rng: np.random.Generator) -> dict[str, Any]:
    """Return pycma options for draws from a generator, without output.

    pycma then leaves numpy's global generator alone.
    """
    return {
        "seed": np.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        # With -10 pycma prints nothing and reads no file of signals.
        "verbose": -10,
        "verb_log": 0,
    }


class MOCMAES:
    """Algorithm 1 of the paper, with the ask-and-tell protocol."""

    def __init__(self, spec: OptimiserOptions) -> None:
        # Line 2: initialise lambda, mu, sigma, C = I, p_sigma = p_c = 0. The archive is empty.
        self.restarts = 0
        self._spec = spec
        self._elite = max(1, round(spec.elite_ratio * spec.population))
        self._rng = np.random.default_rng(spec.seed)
        self._stalled = 0
        self._es = None if spec.start is None else self._started(spec.start, spec.step_size)

    @property
    def step_size(self) -> float:
        """Maximum standard deviation as a share of a parameter's range; NaN without a mean."""
        return np.nan if self._es is None else self._es.step_size

    def ask(self) -> Floats:
        """Return a generation of points, shape (n, P), in the unit cube."""
        # Lines 4-5: sample theta_i from N(mu, sigma^2 C).
        if self._es is None:
            return latin_hypercube(self._spec.population, self._spec.dimension, self._rng)
        return self._es.ask()

    def tell(
        self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive
    ) -> ParetoArchive:
        """Learn from the results of ``ask``, and return the archive with the best points added."""
        if self._es is None:
            grown = archive.joined(points, objectives, violation)
            self._es = self._started(middle_of_the_best(grown), 0.5 * self._spec.step_size)
            return grown
        # Line 8: the hypervolume loss against the archive.
        scale = archive.joined(points, objectives, violation).scale(
            self._spec.ideal, self._spec.nadir
        )
        loss = hypervolume_loss(
            self._spec.loss, archive, objectives, violation, scale, self._spec.reference
        )
        # Line 9: sort. Infeasible points come last, sorted by violation. The last key counts first.
        # All feasible points violate by 0, so among them the loss decides.
        order = np.lexsort((loss, np.maximum(violation, 0.0)))
        # Line 10: the best lambda join the archive.
        elite = np.zeros(len(points), np.bool_)
        elite[order[: self._elite]] = True
        grown = archive.joined(points, objectives, violation, elite)
        # Lines 11-12: evolution paths, step size and covariance.
        ranks = np.empty(len(points))
        ranks[order] = np.arange(len(points))
        self._es.tell(ranks)
        # Line 13: the mean.
        if self._spec.mean == "archive" and len(grown.front):
            self._es.move(grown.parameters[grown.front].mean(axis=0))
        self._restart_if_done(archive, grown, scale)
        return grown

    def _restart_if_done(self, before: ParetoArchive, after: ParetoArchive, scale: Scale) -> None:
        assert self._es is not None
        # Without a feasible point there is no hypervolume that could stagnate.
        if len(after.front):
            old, new = (
                hypervolume(scale(archive.objectives[archive.front]), self._spec.reference)
                if len(archive.front)
                else 0.0
                for archive in (before, after)
            )
            self._stalled = 0 if new - old > LEAST_GAIN else self._stalled + 1
        if not self._es.degenerate and self._stalled < PATIENCE:
            return
        self.restarts += 1
        self._stalled = 0
        spec = self._spec
        if len(after.front) == 0:
            self._es = self._started(self._rng.random(spec.dimension), spec.step_size)
            return
        share = contributions(scale(after.objectives[after.front]), spec.reference)
        # Points below the reference have a chance, too.
        share = share + max(1e-9, 1e-3 * float(share.mean()))
        row = self._rng.choice(after.front, p=share / share.sum())
        self._es = self._started(after.parameters[row], 0.5 * spec.step_size)

    def _started(self, mean: Floats, step_size: float) -> CubeCMAES:
        largest = 2.0 * self._spec.step_size
        return CubeCMAES(mean, step_size, largest, self._spec.population, self._elite, self._rng)


def latin_hypercube(count: int, dimension: int, rng: np.random.Generator) -> Floats:
    """Return a Latin hypercube sample of the unit cube, shape (count, dimension).

    Each of ``count`` equal parts of every axis holds one point.
    """
    intervals = np.stack([rng.permutation(count) for _ in range(dimension)], axis=1)
    return np.asarray((intervals + rng.random((count, dimension))) / count, np.float64)


def middle_of_the_best(explored: ParetoArchive) -> Floats:
    """Return the mean of the front's parameters.

    If no point is feasible, return the point with the minimum violation.
    """
    if len(explored.front):
        return np.asarray(explored.parameters[explored.front].mean(axis=0), np.float64)
    return explored.parameters[int(np.argmin(explored.violation))]


def hypervolume_loss(
    kind: str,
    archive: ParetoArchive,
    objectives: Floats,
    violation: Floats,
    scale: Scale,
    reference: float | Floats,
) -> Floats:
    """Return the loss of n points against an archive's Pareto front, shape (n,).

    This is line 8 of Algorithm 1. The loss of infeasible points is infinite. The reference point is
    in units of the scale; ``kind`` is one of :data:`LOSSES`.
    """
    loss = np.full(len(objectives), np.inf)
    feasible = violation <= 0.0
    if feasible.any():
        front = (
            scale(archive.objectives[archive.front])
            if len(archive.front)
            else np.zeros((0, objectives.shape[1]))
        )
        measure = uncrowded_improvement if kind == "uhvi" else total_hypervolume
        loss[feasible] = -measure(scale(objectives[feasible]), front, reference)
    return loss
