"""MO-CMA-ES, Algorithm 1 of the paper, as a search with ``ask`` and ``tell``.

All objectives are maximised. The search knows nothing about racing. The same seed and the same
results lead to the same state: an interrupted search resumes when it receives the same results
again.

The comments in :meth:`Search.ask` and :meth:`Search.tell` are the lines of the algorithm. Choices
where the paper leaves room:

- Line 8: the loss of a point is minus the hypervolume that the point adds to the archive. If it
  adds none, the loss is the distance to the nearest place where a point adds hypervolume. (The
  literal reading, the hypervolume of archive and point together, is the same for all dominated
  points.)
- Line 8: objectives are normalised by the range of the initial sample or, without one, of the first
  generation. The reference point lies a tenth of that range below the nadir.
- Line 13: the mean moves to the recombined elite of this generation, as in CMA-ES. (The literal
  reading is the mean of the archive's Pareto set: if that set is no straight line, it is the mean
  of distant points.)
- Bounds of parameters are not in the paper. Samples outside the bounds are moved to the border, but
  CMA-ES learns from the original samples: so its mean can settle beyond a border and hold a
  parameter at its limit. The mean stays within three standard deviations of the box, and the step
  size within twice its first value.
- Restarts are not in the paper. Here, once the step size has collapsed or the archive has stopped
  growing, the search restarts at a random point of the front. Points that contribute more
  hypervolume, where the front is thin, are more likely.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import (
    InputError,
    check_array,
    check_number,
    check_seed,
    check_whole,
    require,
)
from pcs_racing.base.typing import Floats
from pcs_racing_agents.policies.pareto import (
    Scale,
    contributions,
    hypervolume,
    non_dominated,
    uncrowded_improvement,
)

MIN_STEP = 1e-4  # share of the range of the parameters
PATIENCE = 10  # generations
MIN_GAIN = 1e-5  # normalised hypervolume per generation


class _Front(NamedTuple):
    """Pareto front of the archive, in the order of discovery; of equal points the first."""

    unit: Floats  #: shape (K, P): Parameters in the unit cube.
    parameters: Floats  #: shape (K, P)
    objectives: Floats  #: shape (K, G)

    def joined(self, points: "_Front") -> "_Front":
        """Return the front of both sets of points."""
        both = [np.concatenate(arrays) for arrays in zip(self, points, strict=True)]
        kept = non_dominated(both[2])
        return _Front(*(array[kept] for array in both))


class Search:
    """Search for a Pareto set: ``ask`` returns points, ``tell`` takes their results.

    Parameters
    ----------
    bounds : array_like, shape (P, 2)
        Minimum and maximum value of each of at least 2 parameters.
    population : int
        Number of points per generation, 4 to 10,000.
    step_size : float
        First standard deviation, as a share of the bounds' range, above 0 to 1.
    start : array_like, shape (P,), optional
        First mean; the middle of the bounds by default.
    """

    def __init__(
        self,
        bounds: ArrayLike,
        *,
        population: int = 50,
        step_size: float = 0.2,
        start: ArrayLike | None = None,
        seed: int = 0,
    ) -> None:
        self._low, self._high = _checked_bounds(bounds)
        middle = 0.5 * (self._low + self._high) if start is None else start
        mean = self._to_cube(check_array("start", middle, (len(self._low),)))
        self.population = check_whole("population", population, 4, 10_000)
        self._step_size = check_number("step_size", step_size, maximum=1.0, above=0.0)
        # Lambda of Algorithm 1: points that are recombined and added to the archive.
        self._elite = round(0.5 * self.population)
        check_seed(seed, maximum=2**63 - 1)
        # Line 2: initialise lambda, mu, sigma, C = I, p_sigma = p_c = 0. The archive is empty.
        self._rng = np.random.default_rng(np.random.SeedSequence(int(seed)))
        self._es = self._started(mean, self._step_size)
        self._asked = np.zeros((0, len(self._low)))
        # The number of axes follows from the first results.
        self._front = _Front(self._asked, self._asked, np.zeros((0, 0)))
        self._scale = Scale(np.zeros(0), np.zeros(0))
        self._stalled = 0
        self.generation = 0  #: Number of generations so far.
        self.restarts = 0  #: Number of restarts so far.
        self.hypervolume = 0.0  #: Hypervolume of the archive's front, in units of the scale.

    @property
    def parameters(self) -> Floats:
        """Parameters of the archive's Pareto front, shape (K, P); empty without feasible points."""
        return self._front.parameters

    @property
    def objectives(self) -> Floats:
        """Objectives of the archive's Pareto front, shape (K, G)."""
        return self._front.objectives

    def ask(self) -> Floats:
        """Return the points to evaluate next, shape (n, P)."""
        # Lines 4-5: sample theta_i from N(mu, sigma^2 C).
        self._asked = np.clip(self._es.ask(), 0.0, 1.0)
        return self._from_cube(self._asked)

    def tell(self, objectives: ArrayLike, violation: ArrayLike | None = None) -> None:
        """Take the results of the points returned by the last ``ask``.

        Parameters
        ----------
        objectives : array_like, shape (n, G)
            Objectives, to maximise.
        violation : array_like, shape (n,), optional
            Violation, up to 0 for feasible points. Infeasible points never enter the archive and
            rank behind all feasible points, by increasing violation.
        """
        unit = self._asked
        if len(unit) == 0:
            raise InputError("no points were asked for; ask first")
        values, beyond = self._checked(len(unit), objectives, violation)
        self._asked = unit[:0]
        before = self.hypervolume
        # Line 8: the hypervolume loss against the archive.
        loss = self._loss(values, beyond)
        # Line 9: sort. Infeasible points come last, sorted by violation. The last key counts first.
        # All feasible points violate by 0, so among them the loss decides.
        order = np.lexsort((loss, np.maximum(beyond, 0.0)))
        # Line 10: the best lambda join the archive, in the order of the generation.
        elite = np.sort(order[: self._elite])
        self._join(unit[elite], self._from_cube(unit[elite]), values[elite], beyond[elite])
        self.generation += 1
        # Lines 11-13: evolution paths, step size, covariance and mean.
        ranks = np.empty(len(unit))
        ranks[order] = np.arange(len(unit))
        self._es.tell(ranks)
        self._restart_if_done(before)

    def add(
        self, parameters: ArrayLike, objectives: ArrayLike, violation: ArrayLike | None = None
    ) -> None:
        """Add points evaluated elsewhere to the archive, such as an initial sample.

        They are not recombined. The range of an initial sample is the scale of the search.
        """
        points = check_array("parameters", parameters, (None, len(self._low)))
        unit = self._to_cube(points)
        values, beyond = self._checked(len(points), objectives, violation)
        self._join(unit, points, values, beyond)

    def _to_cube(self, points: Floats) -> Floats:
        if not (np.all(points >= self._low) and np.all(points <= self._high)):
            raise InputError("parameters lie outside the bounds")
        return (points - self._low) / (self._high - self._low)

    def _from_cube(self, unit: Floats) -> Floats:
        # Rounding may lead beyond the upper bound.
        return np.minimum(self._low + unit * (self._high - self._low), self._high)

    def _checked(
        self, count: int, objectives: ArrayLike, violation: ArrayLike | None
    ) -> tuple[Floats, Floats]:
        """Return results of some points as arrays; the first ones set the scale."""
        axes = len(self._scale.ideal)
        values = check_array("objectives", objectives, (count, axes or None))
        beyond = check_array(
            "violation", np.zeros(count) if violation is None else violation, (count,)
        )
        if axes == 0:
            if values.shape[1] < 2:
                raise InputError(
                    f"objectives have shape {values.shape}; there must be at least 2 for each point"
                )
            self._scale = Scale.of(values)
            self._front = self._front._replace(objectives=values[:0])
        return values, beyond

    def _loss(self, objectives: Floats, violation: Floats) -> Floats:
        """Return the loss of n points against the archive's front; infinite for infeasible ones."""
        loss = np.full(len(objectives), np.inf)
        feasible = violation <= 0.0
        front = self._scale(self._front.objectives)
        loss[feasible] = -uncrowded_improvement(self._scale(objectives[feasible]), front)
        return loss

    def _join(
        self, unit: Floats, parameters: Floats, objectives: Floats, violation: Floats
    ) -> None:
        """Add the feasible points to the archive."""
        feasible = violation <= 0.0
        points = _Front(unit[feasible], parameters[feasible], objectives[feasible])
        self._front = self._front.joined(points)
        self.hypervolume = hypervolume(self._scale(self._front.objectives))

    def _restart_if_done(self, before: float) -> None:
        """Restart at a point of the front after a collapse or too many generations without gain."""
        # Without a feasible point there is no hypervolume that could stagnate.
        if len(self._front.unit):
            self._stalled = 0 if self.hypervolume - before > MIN_GAIN else self._stalled + 1
        if not self._es.degenerate and self._stalled < PATIENCE:
            return
        self.restarts += 1
        self._stalled = 0
        if len(self._front.unit) == 0:
            self._es = self._started(self._rng.random(len(self._low)), self._step_size)
            return
        share = contributions(self._scale(self._front.objectives))
        # Points below the reference have a chance, too.
        share = share + max(1e-9, 1e-3 * float(share.mean()))
        row = self._rng.choice(len(share), p=share / share.sum())
        self._es = self._started(self._front.unit[row], 0.5 * self._step_size)

    def _started(self, mean: Floats, step_size: float) -> "CubeCMAES":
        max_step = 2.0 * self._step_size
        return CubeCMAES(mean, step_size, max_step, self.population, self._elite, self._rng)


class CubeCMAES:
    """CMA-ES of pycma in the unit cube, with a given generator instead of numpy's global generator.

    The step size stays below ``max_step``; ``elite`` of ``population`` points per generation are
    recombined. With ``bounded``, points lie within the cube by pycma's smooth transformation, and
    the step size is left alone; without, a point outside of the cube is the caller's to clip.
    """

    def __init__(
        self,
        mean: Floats,
        step_size: float,
        max_step: float,
        population: int,
        elite: int,
        rng: np.random.Generator,
        *,
        bounded: bool = False,
    ) -> None:
        require("cma", extra="synthesis")
        import cma

        self._max_step = max_step
        self._samples: list[Floats] = []
        options = {
            "popsize": population,
            "CMA_mu": elite,
            "maxstd": 1.0 / 3.0,
            # pycma leaves numpy's global generator alone.
            "seed": np.nan,
            "randn": lambda *shape: rng.standard_normal(shape),
            # With -10 pycma prints nothing and reads no file of signals.
            "verbose": -10,
            "verb_log": 0,
        }
        self._bounded = bounded
        if bounded:
            options["bounds"] = [0.0, 1.0]
            mean = np.clip(mean, 0.0, 1.0)
        self._es = cma.CMAEvolutionStrategy(mean, step_size, options)

    @property
    def step_size(self) -> float:
        """Maximum standard deviation of a parameter."""
        return float(np.max(self._es.stds))

    @property
    def mean(self) -> Floats:
        """Mean of the distribution, shape (P,), within the bounds, if there are any."""
        return np.asarray(self._es.result.xfavorite, np.float64)

    @property
    def degenerate(self) -> bool:
        """True if the distribution has collapsed or diverged."""
        return not MIN_STEP < self.step_size < np.inf or self._es.condition_number > 1e14

    def ask(self) -> Floats:
        """Return a generation of points, shape (n, P); some may lie outside the cube."""
        self._samples = self._es.ask()
        return np.stack(self._samples)

    def tell(self, ranks: Floats) -> None:
        """Update the distribution from the points' ranks, the only input of CMA-ES."""
        self._es.tell(self._samples, ranks.tolist())
        if self._bounded:
            return
        # Without a limit the step size may grow until all points lie on the border.
        self._es.sigma = min(self._es.sigma, self._max_step)
        # Points are moved to the border before their evaluation, so nothing else limits the mean.
        room = 3.0 * self._es.stds
        self._es.mean = np.clip(self._es.mean, -room, 1.0 + room)


def latin_hypercube(count: int, dimension: int, rng: np.random.Generator) -> Floats:
    """Return a Latin hypercube sample of the unit cube, shape (count, dimension).

    Each of ``count`` equal parts of every axis holds one point.
    """
    intervals = np.stack([rng.permutation(count) for _ in range(dimension)], axis=1)
    return np.asarray((intervals + rng.random((count, dimension))) / count, np.float64)


def _checked_bounds(bounds: ArrayLike) -> tuple[Floats, Floats]:
    table = check_array("bounds", bounds, (None, 2))
    if len(table) < 2:
        raise InputError(f"bounds have {len(table)} parameters; there must be at least 2")
    low, high = table.T.copy()
    if not np.all(low < high):
        row = int(np.argmin(low < high))
        raise InputError(
            f"bounds of parameter {row} are {low[row]:g} and {high[row]:g}; the second must be"
            " larger"
        )
    return low, high
