"""Searching the Pareto set of any function: a generation of points at a time, all objectives maximised.

:func:`synthesize` runs the whole search with a function; :class:`Search` is the same search turned inside out, for
whoever evaluates points elsewhere: ask for points, tell what came of them. Both are replayable: the same seed and the
same values told lead to the same state, so a search that stopped is taken up by telling it again what it was told.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.synthesis.explored import Explored, Scale
from pcs_racing_agents.synthesis.indicators import contributions, hypervolume
from pcs_racing_agents.synthesis.mo_cma_es import LOSSES, MEANS, Setting
from pcs_racing_agents.synthesis.optimisers import make_optimiser

__all__ = ["Evaluated", "Generation", "Search", "Synthesis", "synthesize"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

PARTS = 16  # of a generation, when an executor evaluates them


class Evaluated(NamedTuple):
    """What came of evaluating n points.

    Attributes
    ----------
    objectives : ndarray, shape (n, G)
        To maximise.
    violation : ndarray, shape (n,), optional
        By how much a constraint is violated: up to 0 where the point is feasible, which all are if it is left out.
    parameters : ndarray, shape (n, P), optional
        The points themselves. Where stored results carry them, they are compared with the points asked for.
    """

    objectives: ArrayLike
    violation: ArrayLike | None = None
    parameters: ArrayLike | None = None


class Generation(NamedTuple):
    """What is known after a generation, and what was told in it.

    Attributes
    ----------
    generation : int
        Its number, from 1.
    evaluations : int
        Of all generations so far.
    hypervolume : float
        Of the archive's front in the normalisation of this generation. The range of the front changes unless ideal and
        nadir were stated, so these numbers can't be compared with each other: see :meth:`Synthesis.hypervolumes`.
    archive_size : int
        Points in the front, K.
    restarts : int
        So far.
    step_size : float
        Largest standard deviation of a parameter, as a share of its range; NaN for methods without one.
    infeasible : int
        Points of this generation that violate the constraint.
    front : ndarray, shape (K, G)
        Objectives of the archive's front.
    parameters : ndarray, shape (n, P)
        The points evaluated.
    repeats : ndarray, shape (n,)
        How often each had been evaluated before.
    objectives : ndarray, shape (n, G)
    violation : ndarray, shape (n,)
    """

    generation: int
    evaluations: int
    hypervolume: float
    archive_size: int
    restarts: int
    step_size: float
    infeasible: int
    front: Floats
    parameters: Floats
    repeats: Indices
    objectives: Floats
    violation: Floats


@dataclass(frozen=True, eq=False)
class Synthesis:
    """Result of a search.

    Attributes
    ----------
    parameters : ndarray, shape (K, P)
        The archive's Pareto front, in the order in which its points were found. It is empty if nothing feasible was.
    objectives : ndarray, shape (K, G)
    evaluations : ndarray, shape (K,)
        How often each was evaluated; objectives are means.
    explored_parameters : ndarray, shape (N, P)
        Everything evaluated.
    explored_objectives : ndarray, shape (N, G)
    explored_violation : ndarray, shape (N,)
    explored_evaluations : ndarray, shape (N,)
    generations : tuple of Generation
    ideal, nadir : ndarray, shape (G,)
        Of the final front, or what was stated.
    reference : ndarray, shape (G,)
        Reference point of hypervolumes in units of ideal (1) and nadir (0).
    """

    parameters: Floats
    objectives: Floats
    evaluations: Indices
    explored_parameters: Floats
    explored_objectives: Floats
    explored_violation: Floats
    explored_evaluations: Indices
    generations: tuple[Generation, ...]
    ideal: Floats
    nadir: Floats
    reference: Floats

    def hypervolumes(self) -> Floats:
        """Hypervolume of the archive's front after each generation, all in the final normalisation, shape (T,)."""
        scale = Scale(self.ideal, self.nadir)
        return np.array([hypervolume(scale(news.front), self.reference) for news in self.generations])


class Search:
    """A search to ask and tell.

    Parameters
    ----------
    bounds : array_like, shape (P, 2)
        Smallest and largest value of each parameter.
    population : int
        Points of a generation, 4 to 10,000.
    elite_ratio : float
        Share of a generation that CMA-ES recombines and adds to its archive, above 0 to 1.
    loss : {"uhvi", "total_hypervolume"}
        Loss of CMA-ES: the uncrowded hypervolume improvement, or the paper's words taken literally.
    mean : {"generation", "archive"}
        Where the mean of CMA-ES moves: to its generation's elite, or to the mean of the archive's Pareto set.
    seed : int
    method : {"mo-cma-es", "nsga2", "comocma", "cma-mae", "random"}
        The first is the paper's. The options for CMA-ES do nothing in ``nsga2`` and ``random``.
    reference : float or array_like, shape (G,)
        Reference point of the hypervolume in normalised objectives; by default a tenth of the range below the nadir.
    ideal, nadir : array_like, shape (G,), optional
        Values that normalise to 1 and 0. By default the range of the front, as it is in each generation.
    start : {"middle", "sample"} or array_like, shape (P,)
        First mean of CMA-ES: the middle of the bounds, a point, or the middle of the best of a first generation that is
        a sample of everything within the bounds.
    step_size : float
        First standard deviation of CMA-ES, as a share of the bounds' range, above 0 to 1; half of it after a sample.

    Attributes
    ----------
    repeats : ndarray, shape (n,)
        How often each of the points asked for last had been evaluated before.

    Raises
    ------
    InputError
        If one of them is impossible.
    UnknownNameError
        If there is no such method.
    ModuleNotFoundError
        If a library is missing; the message says how to install it.
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
        method: str = "mo-cma-es",
        reference: ArrayLike = -0.1,
        ideal: ArrayLike | None = None,
        nadir: ArrayLike | None = None,
        start: ArrayLike | str = "middle",
        step_size: float = 0.2,
    ) -> None:
        self._low, self._high = _checked_bounds(bounds)
        dimension = len(self._low)
        _check_whole("population", population, 4, 10_000)
        _check_whole("seed", seed, 0, 2**63 - 1)
        _check_share("elite_ratio", elite_ratio, 0.0, 1.0, open_below=True)
        _check_share("step_size", step_size, 0.0, 1.0, open_below=True)
        for name, value, choices in (("loss", loss, LOSSES), ("mean", mean, MEANS)):
            if value not in choices:
                raise InputError(f"{name} is {value!r}; it must be one of {', '.join(choices)}")
        self._reference = _checked_vector("reference", reference)
        self._scale_from = _checked_scale(ideal, nadir)
        first = self._first_mean(start)
        self._population = population
        root = np.random.SeedSequence(int(seed))
        setting = Setting(
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
        self._optimiser = make_optimiser(method, setting)
        self._explored = Explored.nothing(dimension)
        self._parameters = np.zeros((0, dimension))
        self._generations: list[Generation] = []
        self._evaluations = 0
        self._asked = np.zeros((0, dimension))
        self._new: Floats | None = None  # the points asked for in the unit cube; None where they are old ones
        self._rows = np.zeros(0, np.int64)
        self.repeats: Indices = self._rows

    @property
    def archive(self) -> Floats:
        """Parameters of the archive's Pareto front as it is now, shape (K, P)."""
        return self._parameters[self._explored.front]

    def ask(self) -> Floats:
        """Return the points to evaluate next, shape (n, P).

        Raises
        ------
        InputError
            If the last points were not told yet.
        """
        self._check_told()
        self._new = self._optimiser.ask()
        self._asked = np.clip(self._low + self._new * (self._high - self._low), self._low, self._high)
        self.repeats = np.zeros(len(self._asked), np.int64)
        return self._asked.copy()

    def ask_again(self) -> Floats:
        """Return points of the archive's front to evaluate once more, shape (n, P), for noisy objectives.

        As many as a generation has, the front's points in turn: those evaluated least often first, and of these the
        ones that contribute most hypervolume, which are the likeliest to be there by luck. Their objectives become
        means; the optimiser is told nothing of it.

        Raises
        ------
        InputError
            If the last points were not told yet, or there is no feasible point.
        """
        self._check_told()
        known, front = self._explored, self._explored.front
        if len(front) == 0:
            raise InputError("no point of the archive is feasible; there is nothing to evaluate again")
        lost = contributions(known.scale(*self._scale_from)(known.objectives[front]), self._reference)
        order = front[np.lexsort((-lost, known.evaluations[front]))]
        places = np.arange(self._population)
        self._rows = order[places % len(order)]
        self.repeats = known.evaluations[self._rows] + places // len(order)
        self._asked = self._parameters[self._rows]
        return self._asked.copy()

    def tell(self, objectives: ArrayLike, violation: ArrayLike | None = None) -> Generation:
        """Tell what came of the points asked for.

        Parameters
        ----------
        objectives : array_like, shape (n, G)
            To maximise.
        violation : array_like, shape (n,), optional
            Up to 0 where a point is feasible. Infeasible points never enter the archive and rank behind all others, the
            more the larger it is. Of points evaluated several times it is averaged, so let it be negative where a
            constraint is kept with room to spare.

        Raises
        ------
        InputError
            If nothing was asked for, or the values have another shape or are not finite.
        """
        asked = self._asked
        if len(asked) == 0:
            raise InputError("no points were asked for; ask first")
        values, violations = self._checked(objectives, violation, asked)
        if self._new is None:
            self._explored = self._explored.averaged(self._rows, values, violations)
        else:
            self._explored = self._optimiser.tell(self._new, values, violations, self._explored)
            self._parameters = np.concatenate([self._parameters, asked])
        self._new, self._asked = None, asked[:0]
        self._evaluations += len(asked)
        front = self._explored.objectives[self._explored.front]
        scale = self._explored.scale(*self._scale_from)
        news = Generation(
            generation=len(self._generations) + 1,
            evaluations=self._evaluations,
            hypervolume=hypervolume(scale(front), self._reference) if len(front) else 0.0,
            archive_size=len(front),
            restarts=self._optimiser.restarts,
            step_size=self._optimiser.step_size,
            infeasible=int(np.sum(violations > 0.0)),
            front=front,
            parameters=asked,
            repeats=self.repeats,
            objectives=values,
            violation=violations,
        )
        self._generations.append(news)
        return news

    def add(self, parameters: ArrayLike, objectives: ArrayLike, violation: ArrayLike | None = None) -> None:
        """Add points that were evaluated elsewhere to the archive, at any time between ``tell`` and ``ask``.

        The optimisers see them as what is there already; none of them recombines these points.

        Raises
        ------
        InputError
            If the points lie outside the bounds, or values have another shape or are not finite.
        """
        given = np.array(parameters, np.float64)
        if given.ndim != 2 or given.shape[1] != len(self._low):
            raise InputError(f"parameters have shape {given.shape}; they must have (n, {len(self._low)})")
        if not (np.all(given >= self._low) and np.all(given <= self._high)):
            raise InputError("parameters lie outside the bounds")
        self._check_told()
        values, violations = self._checked(objectives, violation, given)
        unit = (given - self._low) / (self._high - self._low)
        self._explored = self._explored.joined(unit, values, violations)
        self._parameters = np.concatenate([self._parameters, given])

    def replace(self, objectives: ArrayLike, violation: ArrayLike | None = None) -> None:
        """State other values of the archive's front (``archive``, in its order), between ``tell`` and ``ask``.

        For objectives that change their meaning during the search, such as results against other opponents. Everything
        else evaluated so far stays explored, but can't return to the archive: its values are of the old kind.

        Raises
        ------
        InputError
            If values have another shape or are not finite.
        """
        self._check_told()
        values, violations = self._checked(objectives, violation, self.archive)
        self._explored = self._explored.replaced(values, violations)

    def result(self) -> Synthesis:
        """Return what was found so far."""
        known, front = self._explored, self._explored.front
        scale = known.scale(*self._scale_from)
        return Synthesis(
            parameters=self._parameters[front],
            objectives=known.objectives[front],
            evaluations=known.evaluations[front],
            explored_parameters=self._parameters,
            explored_objectives=known.objectives,
            explored_violation=known.violation,
            explored_evaluations=known.evaluations,
            generations=tuple(self._generations),
            ideal=scale.ideal,
            nadir=scale.nadir,
            reference=np.array(np.broadcast_to(self._reference, scale.ideal.shape)),
        )

    def _first_mean(self, start: Any) -> Floats | None:
        """Return the first mean in the unit cube, or None for a sample."""
        if isinstance(start, str):
            if start not in ("middle", "sample"):
                raise InputError(f"start is {start!r}; it must be middle, sample, or a point")
            if start == "sample":
                return None
            start = (self._low + self._high) / 2.0
        first = _checked_vector("start", start, len(self._low))
        if np.any(first < self._low) or np.any(first > self._high):
            raise InputError(f"start is {first.tolist()}; it must lie within the bounds")
        return (first - self._low) / (self._high - self._low)

    def _check_told(self) -> None:
        if len(self._asked):
            raise InputError("the points asked for last were not told yet; tell what came of them first")

    def _checked(self, objectives: ArrayLike, violation: ArrayLike | None, asked: Floats) -> tuple[Floats, Floats]:
        try:
            values = np.array(objectives, np.float64)
            violations = np.zeros(len(asked)) if violation is None else np.array(violation, np.float64)
        except (TypeError, ValueError):
            raise InputError("objectives or violations hold something that is no number") from None
        axes = self._explored.objectives.shape[1] or None
        if values.ndim != 2 or len(values) != len(asked) or values.shape[1] < 2 or axes not in (None, values.shape[1]):
            wanted = f"({len(asked)}, {axes or '2 or more'})"
            raise InputError(f"objectives have shape {values.shape}; for {len(asked)} points they must have {wanted}")
        if violations.shape != (len(asked),):
            raise InputError(f"violations have shape {violations.shape}; they must have ({len(asked)},)")
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
                raise InputError(f"{name} has {len(vector)} numbers; there are {values.shape[1]} objectives")
        return values, violations


def synthesize(
    evaluate: Callable[..., Any],
    bounds: ArrayLike,
    *,
    generations: int = 40,
    executor: Executor | None = None,
    evaluated: Sequence[Any] = (),
    callback: Callable[[Generation], object] | None = None,
    reevaluation: float = 0.0,
    **options: Any,
) -> Synthesis:
    """Search the Pareto set of a function: Algorithm 1 of the paper, or another method behind the same call.

    Parameters
    ----------
    evaluate : callable
        ``evaluate(parameters)`` takes points, shape (n, P), and returns their objectives, shape (n, G), all to be
        **maximised**; or ``(objectives, violation)`` with a violation for each, up to 0 where the point is feasible
        (:meth:`Search.tell`). With ``reevaluation`` it is called as ``evaluate(parameters, repeats)``, where
        ``repeats``, shape (n,), says how often each point was evaluated before: draw other noise for each. A row's
        result must not depend on the other rows.
    bounds : array_like, shape (P, 2)
        Smallest and largest value of each parameter.
    generations : int
        1 to 1,000,000.
    executor : Executor, optional
        Evaluates a generation in up to 16 parts at once. It has no influence on the result.
    evaluated : sequence
        Results of the first generations, where they are known from an earlier run with the same arguments: objectives,
        ``(objectives, violation)`` or :class:`Evaluated` each, such as a :class:`Generation` holds. They are told
        instead of calling ``evaluate``, and the search goes on from there as if it had never stopped.
    callback : callable, optional
        Called with the :class:`Generation` after each.
    reevaluation : float
        Share of the generations, the last ones, that evaluate the archive's points once more instead of new ones
        (:meth:`Search.ask_again`), 0 to 0.9: for noisy objectives.
    **options
        Of :class:`Search`: ``population``, ``elite_ratio``, ``loss``, ``mean``, ``seed``, ``method``, ``reference``,
        ``ideal``, ``nadir``, ``start``, ``step_size``.

    Returns
    -------
    Synthesis

    Raises
    ------
    InputError
        If an argument is impossible, a result has another shape or is not finite, or stored results belong to other
        points than this search asks for.
    UnknownNameError
        If there is no such method.
    ModuleNotFoundError
        If a library is missing; the message says how to install it.
    """
    _check_whole("generations", generations, 1, 1_000_000)
    if len(evaluated) > generations:
        raise InputError(f"evaluated holds {len(evaluated)} generations; at most the {generations} asked for")
    _check_share("reevaluation", reevaluation, 0.0, 0.9)
    search = Search(bounds, **options)
    proposing = generations - round(reevaluation * generations)
    for number in range(generations):
        old = number >= max(proposing, 1) and len(search.archive) > 0
        asked = search.ask_again() if old else search.ask()
        if number < len(evaluated):
            found = _evaluated(evaluated[number])
            if found.parameters is not None and not np.array_equal(np.asarray(found.parameters), asked):
                raise InputError(
                    f"the stored results of generation {number + 1} belong to other points: they were made with other "
                    "arguments, another seed or other versions of the libraries"
                )
        else:
            arguments = (asked, search.repeats) if reevaluation > 0.0 else (asked,)
            found = _evaluate(evaluate, arguments, executor)
        news = search.tell(found.objectives, found.violation)
        if callback is not None:
            callback(news)
    return search.result()


def _evaluate(evaluate: Callable[..., Any], arguments: tuple[Any, ...], executor: Executor | None) -> Evaluated:
    if executor is None:
        return _evaluated(evaluate(*arguments))
    count = min(PARTS, len(arguments[0]))
    parts = [_evaluated(part) for part in executor.map(evaluate, *(np.array_split(a, count) for a in arguments))]
    stated = [part.violation is not None for part in parts]
    try:
        values = np.concatenate([np.asarray(part.objectives, np.float64) for part in parts])
        if not any(stated):
            return Evaluated(values)
        return Evaluated(values, np.concatenate([np.asarray(part.violation, np.float64) for part in parts]))
    except (TypeError, ValueError):
        raise InputError("evaluate returned results of different shapes for different points") from None


def _evaluated(value: Any) -> Evaluated:
    return Evaluated(*value) if isinstance(value, tuple) and 1 <= len(value) <= 3 else Evaluated(value)


def _checked_bounds(bounds: ArrayLike) -> tuple[Floats, Floats]:
    table = _checked_vector("bounds", bounds, ndim=2)
    if table.shape[1] != 2 or len(table) == 0:
        raise InputError(f"bounds have shape {table.shape}; they must have (number of parameters, 2)")
    low, high = table[:, 0].copy(), table[:, 1].copy()
    if not np.all(low < high):
        row = int(np.argmin(low < high))
        raise InputError(f"bounds of parameter {row} are {low[row]:g} and {high[row]:g}; the second must be larger")
    return low, high


def _checked_vector(name: str, value: ArrayLike, length: int | None = None, ndim: int | None = None) -> Floats:
    try:
        vector = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must hold numbers") from None
    if not np.isfinite(vector).all():
        raise InputError(f"{name} holds NaN or infinity; it must be finite")
    if ndim is not None and vector.ndim != ndim:
        raise InputError(f"{name} have shape {vector.shape}; they must have (number of parameters, 2)")
    if length is not None and vector.shape != (length,):
        raise InputError(f"{name} has shape {vector.shape}; it must have ({length},)")
    if ndim is None and vector.ndim > 1:
        raise InputError(f"{name} has shape {vector.shape}; it must be a number or a list of numbers")
    return vector


def _checked_scale(ideal: ArrayLike | None, nadir: ArrayLike | None) -> tuple[Floats | None, Floats | None]:
    if ideal is None and nadir is None:
        return None, None
    if ideal is None or nadir is None:
        raise InputError("only one of ideal and nadir is stated; state both or none")
    best, worst = _checked_vector("ideal", ideal), _checked_vector("nadir", nadir)
    if best.ndim != 1 or best.shape != worst.shape or not np.all(worst < best):
        raise InputError(f"ideal is {best.tolist()} and nadir {worst.tolist()}; the ideal must be larger on all axes")
    return best, worst


def _check_whole(name: str, value: Any, least: int, most: int) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not least <= value <= most:
        raise InputError(f"{name} is {value!r}; it must be a whole number from {least} to {most}")


def _check_share(name: str, value: Any, least: float, most: float, open_below: bool = False) -> None:
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not number or not least <= value <= most or (open_below and value == least):
        what = f"above {least:g} to {most:g}" if open_below else f"from {least:g} to {most:g}"
        raise InputError(f"{name} is {value!r}; it must be a number {what}")
