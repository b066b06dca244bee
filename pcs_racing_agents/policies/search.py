"""Multi-objective search with an ask-and-tell interface.

All objectives are maximised. A search is replayable: the same seed and the same results lead to the
same state. So an interrupted search resumes when it receives the same results again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array, check_choice, check_number, check_seed, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.indicators import hypervolume
from pcs_racing_agents.policies.mo_cma_es import LOSSES, MEANS, OptimiserOptions
from pcs_racing_agents.policies.optimisers import Optimiser, make_optimiser
from pcs_racing_agents.policies.pareto_archive import ParetoArchive, Scale

Floats = NDArray[np.float64]


class Generation(NamedTuple):
    """Archive after a generation, with the points and results of the generation."""

    generation: int  #: Number of the generation, from 1; 0 for an initial sample.
    evaluations: int  #: Number of evaluations in all generations so far.
    #: Hypervolume of the archive's front in the normalisation of this generation. The range of the
    #: front changes unless ideal and nadir were stated, so these numbers are not comparable with
    #: each other: see :meth:`Synthesis.hypervolumes`.
    hypervolume: float
    archive_size: int  #: Number of points in the front, K.
    restarts: int  #: Number of restarts so far.
    #: Maximum standard deviation as a share of a parameter's range; NaN for methods without step
    #: size.
    step_size: float
    infeasible: int  #: Number of points of this generation that violate the constraint.
    front: Floats  #: shape (K, G): Objectives of the archive's front.
    front_parameters: Floats  #: shape (K, P): Points of the archive's front.
    parameters: Floats  #: shape (n, P): Evaluated points.
    objectives: Floats  #: shape (n, G)
    violation: Floats  #: shape (n,)


@dataclass(frozen=True, eq=False)
class Synthesis:
    """Result of a search."""

    #: shape (K, P): Pareto front of the archive, in the order of discovery; empty if no point was
    #: feasible.
    parameters: Floats
    objectives: Floats  #: shape (K, G)
    explored_parameters: Floats  #: shape (N, P): All evaluated points.
    explored_objectives: Floats  #: shape (N, G)
    explored_violation: Floats  #: shape (N,)
    generations: tuple[Generation, ...]
    #: shape (G,): ``ideal``, ``nadir``: Range of the final front, or the stated points.
    ideal: Floats
    nadir: Floats
    #: shape (G,): Reference point of hypervolumes in units of ideal (1) and nadir (0).
    reference: Floats

    def hypervolumes(self) -> Floats:
        """Return the front's hypervolume after each generation, in the final scale, shape (T,)."""
        scale = Scale(self.ideal, self.nadir)
        return np.array(
            [
                hypervolume(scale(generation.front), self.reference)
                for generation in self.generations
            ]
        )


class Search:
    """Search for a Pareto set: ``ask`` returns points, ``tell`` takes their objectives.

    Parameters
    ----------
    bounds : array_like, shape (P, 2)
        Minimum and maximum value of each parameter.
    population : int
        Number of points per generation, 4 to 10,000.
    elite_ratio : float
        Share of a generation that CMA-ES recombines and adds to its archive, above 0 to 1.
    loss : {"uhvi", "total_hypervolume"}
        Loss of CMA-ES: the uncrowded hypervolume improvement, or the literal reading of the paper.
    mean : {"generation", "archive"}
        Target of the mean of CMA-ES: the elite of the generation, or the mean of the archive's
        Pareto set.
    method : {"mo-cma-es", "nsga2", "random"} or callable
        The first method is the paper's. The options for CMA-ES have no effect on the other methods.
        A function makes a custom optimiser
        (:class:`pcs_racing_agents.policies.optimisers.Optimiser`) from the options.
    reference : float or array_like, shape (G,)
        Reference point of the hypervolume in normalised objectives; by default a tenth of the range
        below the nadir.
    ideal, nadir : array_like, shape (G,), optional
        Values that normalise to 1 and 0. By default the range of the current front in each
        generation.
    start : {"middle", "sample"} or array_like, shape (P,)
        First mean of CMA-ES: the middle of the bounds, a point, or for a sample the middle of the
        best points of a first generation sampled within the bounds.
    step_size : float
        First standard deviation of CMA-ES, as a share of the bounds' range, above 0 to 1; halved
        after a sample.
    """

    def __init__(
        self,
        bounds: ArrayLike,
        *,
        population: int = 50,
        elite_ratio: float = 0.5,
        loss: str = "uhvi",
        mean: str = "generation",
        seed: int = 0,
        method: str | Callable[[OptimiserOptions], Optimiser] = "mo-cma-es",
        reference: ArrayLike = -0.1,
        ideal: ArrayLike | None = None,
        nadir: ArrayLike | None = None,
        start: ArrayLike | str = "middle",
        step_size: float = 0.2,
    ) -> None:
        self._low, self._high = _checked_bounds(bounds)
        dimension = len(self._low)
        check_whole("population", population, 4, 10_000)
        check_seed(seed, maximum=2**63 - 1)
        check_number("elite_ratio", elite_ratio, maximum=1.0, above=0.0)
        check_number("step_size", step_size, maximum=1.0, above=0.0)
        check_choice("loss", loss, LOSSES)
        check_choice("mean", mean, MEANS)
        self._reference = check_array("reference", reference, (None,) * np.ndim(reference))
        self._scale_from = _checked_scale(ideal, nadir)
        first = self._first_mean(start)
        self.population = population
        root = np.random.SeedSequence(int(seed))
        spec = OptimiserOptions(
            dimension=dimension,
            population=population,
            seed=root,
            elite_ratio=float(elite_ratio),
            loss=loss,
            mean=mean,
            start=first,
            step_size=float(step_size),
            reference=self._reference if self._reference.ndim else float(self._reference),
            ideal=self._scale_from[0],
            nadir=self._scale_from[1],
        )
        self._optimiser = make_optimiser(method, spec)
        self._explored = ParetoArchive.empty(dimension)
        self._parameters = np.zeros((0, dimension))
        self._generations: list[Generation] = []
        self._evaluations = 0
        self._asked = np.zeros((0, dimension))
        self._unit = self._asked  # the same points in the unit cube, as the optimiser knows them

    @property
    def archive(self) -> Floats:
        """Parameters of the archive's current Pareto front, shape (K, P)."""
        return self._parameters[self._explored.front]

    def ask(self) -> Floats:
        """Return the points to evaluate next, shape (n, P)."""
        self._check_results_in()
        self._unit = np.clip(self._optimiser.ask(), 0.0, 1.0)
        # Rounding may lead beyond the upper bound.
        self._asked = np.minimum(self._low + self._unit * (self._high - self._low), self._high)
        return self._asked.copy()

    def tell(self, objectives: ArrayLike, violation: ArrayLike | None = None) -> Generation:
        """Take the results of the points returned by ``ask``.

        Parameters
        ----------
        objectives : array_like, shape (n, G)
            Objectives, to maximise.
        violation : array_like, shape (n,), optional
            Violation, up to 0 for feasible points. Infeasible points never enter the archive and
            rank behind all feasible points, by increasing violation.
        """
        asked = self._asked
        if len(asked) == 0:
            raise InputError("no points were asked for; ask first")
        values, violations = self._checked(objectives, violation, asked)
        self._explored = self._optimiser.tell(self._unit, values, violations, self._explored)
        self._parameters = np.concatenate([self._parameters, asked])
        self._asked = asked[:0]
        self._evaluations += len(asked)
        generation = self._generation(len(self._generations) + 1, asked, values, violations)
        self._generations.append(generation)
        return generation

    def add(
        self, parameters: ArrayLike, objectives: ArrayLike, violation: ArrayLike | None = None
    ) -> Generation:
        """Add points evaluated elsewhere to the archive, at any time between ``tell`` and ``ask``.

        Optimisers see these points as part of the archive and do not recombine them. Return the
        archive with the points, as a generation with the number of the last generation, 0 before
        the first.
        """
        points = self.check_points("parameters", parameters)
        self._check_results_in()
        values, violations = self._checked(objectives, violation, points)
        unit = (points - self._low) / (self._high - self._low)
        self._explored = self._explored.joined(unit, values, violations)
        self._parameters = np.concatenate([self._parameters, points])
        self._evaluations += len(points)
        return self._generation(len(self._generations), points, values, violations)

    def check_points(self, name: str, points: ArrayLike) -> Floats:
        """Return points, shape (n, P), all of them within the bounds."""
        values = check_array(name, points, (None, len(self._low)))
        if not (np.all(values >= self._low) and np.all(values <= self._high)):
            raise InputError(f"{name} lie outside the bounds")
        return values

    def result(self) -> Synthesis:
        """Return the archive and all evaluated points."""
        explored, front = self._explored, self._explored.front
        scale = explored.scale(*self._scale_from)
        return Synthesis(
            parameters=self._parameters[front],
            objectives=explored.objectives[front],
            explored_parameters=self._parameters,
            explored_objectives=explored.objectives,
            explored_violation=explored.violation,
            generations=tuple(self._generations),
            ideal=scale.ideal,
            nadir=scale.nadir,
            reference=np.array(np.broadcast_to(self._reference, scale.ideal.shape)),
        )

    def _generation(
        self, number: int, points: Floats, objectives: Floats, violation: Floats
    ) -> Generation:
        """Return the current archive with the points evaluated last."""
        front = self._explored.objectives[self._explored.front]
        scale = self._explored.scale(*self._scale_from)
        return Generation(
            generation=number,
            evaluations=self._evaluations,
            hypervolume=hypervolume(scale(front), self._reference) if len(front) else 0.0,
            archive_size=len(front),
            restarts=self._optimiser.restarts,
            step_size=self._optimiser.step_size,
            infeasible=int(np.sum(violation > 0.0)),
            front=front,
            front_parameters=self.archive,
            parameters=points,
            objectives=objectives,
            violation=violation,
        )

    def _first_mean(self, start: Any) -> Floats | None:
        """Return the first mean in the unit cube, or None for a sample."""
        if isinstance(start, str):
            if start not in ("middle", "sample"):
                raise InputError(f"start is {start!r}; it must be middle, sample, or a point")
            if start == "sample":
                return None
            start = (self._low + self._high) / 2.0
        first = check_array("start", start, (len(self._low),))
        if np.any(first < self._low) or np.any(first > self._high):
            raise InputError(f"start is {first.tolist()}; it must lie within the bounds")
        return (first - self._low) / (self._high - self._low)

    def _check_results_in(self) -> None:
        if len(self._asked):
            raise InputError(
                "the points asked for last were not told yet; tell their results first"
            )

    def _checked(
        self, objectives: ArrayLike, violation: ArrayLike | None, asked: Floats
    ) -> tuple[Floats, Floats]:
        try:
            values = np.array(objectives, np.float64)
            violations = (
                np.zeros(len(asked)) if violation is None else np.array(violation, np.float64)
            )
        except (TypeError, ValueError):
            raise InputError("objectives or violations hold something that is no number") from None
        axes = self._explored.objectives.shape[1] or None
        if (
            values.ndim != 2
            or len(values) != len(asked)
            or values.shape[1] < 2
            or axes not in (None, values.shape[1])
        ):
            wanted = f"({len(asked)}, {axes or '2 or more'})"
            raise InputError(
                f"objectives have shape {values.shape}; for {len(asked)} points they must have"
                f" {wanted}"
            )
        if violations.shape != (len(asked),):
            raise InputError(
                f"violations have shape {violations.shape}; they must have ({len(asked)},)"
            )
        for name, table in (("objective", values), ("violation", violations[:, None])):
            if not np.isfinite(table).all():
                row, axis = np.argwhere(~np.isfinite(table))[0]
                where = f"{name} {axis}" if name == "objective" else name
                raise InputError(
                    f"{where} of point {row} is {table[row, axis]}; it must be finite (parameters "
                    f"{np.array2string(asked[row], precision=6, separator=', ', max_line_width=10_000)})"
                )
        for name, vector in (
            ("reference", self._reference if self._reference.ndim else None),
            ("ideal", self._scale_from[0]),
        ):
            if vector is not None and len(vector) != values.shape[1]:
                raise InputError(
                    f"{name} has {len(vector)} numbers; there are {values.shape[1]} objectives"
                )
        return values, violations


def _checked_bounds(bounds: ArrayLike) -> tuple[Floats, Floats]:
    table = check_array("bounds", bounds, (None, 2))
    if len(table) == 0:
        raise InputError(
            f"bounds have shape {table.shape}; they must have (number of parameters, 2)"
        )
    low, high = table.T.copy()
    if not np.all(low < high):
        row = int(np.argmin(low < high))
        raise InputError(
            f"bounds of parameter {row} are {low[row]:g} and {high[row]:g}; the second must be"
            " larger"
        )
    return low, high


def _checked_scale(
    ideal: ArrayLike | None, nadir: ArrayLike | None
) -> tuple[Floats | None, Floats | None]:
    if ideal is None and nadir is None:
        return None, None
    if ideal is None or nadir is None:
        raise InputError("only one of ideal and nadir is stated; state both or none")
    best = check_array("ideal", ideal, (None,))
    worst = check_array("nadir", nadir, (len(best),))
    if not np.all(worst < best):
        raise InputError(
            f"ideal is {best.tolist()} and nadir {worst.tolist()}; the ideal must be larger on all"
            " axes"
        )
    return best, worst
