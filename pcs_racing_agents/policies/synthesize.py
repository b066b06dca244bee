"""Search for the Pareto set of any function, by Algorithm 1 of the paper or another method."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.search import Generation, Search, Synthesis

BLOCKS = 16  # blocks of a generation on an executor


class Evaluated(NamedTuple):
    """Objectives of n points, and violations of the constraint."""

    objectives: ArrayLike  #: shape (n, G): Objectives, to maximise.
    #: shape (n,): Violation of a constraint, up to 0 for feasible points; without it all points are
    #: feasible.
    violation: ArrayLike | None = None
    #: shape (n, P): Evaluated points; in stored results they are compared with the requested
    #: points.
    parameters: ArrayLike | None = None


def synthesize(
    evaluate: Callable[..., Any],
    bounds: ArrayLike,
    *,
    generations: int = 40,
    initial: ArrayLike | None = None,
    evaluations: int | None = None,
    executor: Executor | None = None,
    evaluated: Sequence[Any] = (),
    callback: Callable[[Generation], object] | None = None,
    **options: Any,
) -> Synthesis:
    """Search for the Pareto set of a function.

    Parameters
    ----------
    evaluate : callable
        ``evaluate(parameters)`` takes points, shape (n, P), and returns their objectives, shape (n,
        G), all to be **maximised**; or ``(objectives, violation)`` with a violation for each, up to
        0 where the point is feasible (:meth:`Search.tell`). A row's result must not depend on the
        other rows.
    bounds : array_like, shape (P, 2)
        Minimum and maximum value of each parameter.
    generations : int
        Number of generations, 1 to 1,000,000; from 0 with an initial sample.
    initial : array_like, shape (n, P), optional
        Initial sample: points evaluated before the first generation and added to the archive. Their
        range normalises objectives unless ``ideal`` and ``nadir`` are stated. Optimisers do not
        recombine them.
    evaluations : int, optional
        Maximum number of evaluated points; a generation that would exceed it is not begun.
    executor : Executor, optional
        Executor for up to 16 blocks of a generation at once. It has no influence on the result.
    evaluated : sequence
        Results of the first evaluations from an earlier run with the same arguments: objectives,
        ``(objectives, violation)`` or :class:`Evaluated` each, as in a :class:`Generation`. They
        replace calls of ``evaluate``, and the search continues as if never interrupted.
    callback : callable, optional
        Called with the :class:`Generation` after each generation and after the initial sample.
    **options
        Options of :class:`Search`: ``population``, ``elite_ratio``, ``loss``, ``mean``, ``seed``,
        ``method``, ``reference``, ``ideal``, ``nadir``, ``start``, ``step_size``.
    """
    check_whole("generations", generations, 1 if initial is None else 0, 1_000_000)
    most = np.inf if evaluations is None else check_whole("evaluations", evaluations, 1)
    most_results = generations + (initial is not None)
    if len(evaluated) > most_results:
        raise InputError(
            f"evaluated holds {len(evaluated)} results; this search needs at most {most_results}"
        )
    # Made before any evaluation, so that invalid options are reported at once.
    search = Search(bounds, **options)
    stored = iter(evaluated)
    spent = 0

    def results(points: NDArray[np.float64]) -> Evaluated:
        """Evaluate points, or return their stored results."""
        nonlocal spent
        spent += len(points)
        stored_value = next(stored, None)
        if stored_value is None:
            return _evaluate(evaluate, points, executor)
        result = _evaluated(stored_value)
        # Results of other points would mislead the search silently.
        if result.parameters is not None and not np.array_equal(
            np.asarray(result.parameters), points
        ):
            raise InputError(
                f"stored results belong to other points than those after {spent - len(points)}"
                " evaluations: they were made with other arguments, another seed or other versions"
                " of the libraries"
            )
        return result

    def tell(generation: Generation) -> None:
        if callback is not None:
            callback(generation)

    if initial is not None:
        sample = search.check_points("initial", initial)
        result = results(sample)
        # The range of the sample normalises all later objectives.
        if options.get("ideal") is None:
            values = check_array("objectives", result.objectives, (len(sample), None))
            search = Search(
                bounds, **{**options, "ideal": values.max(axis=0), "nadir": values.min(axis=0)}
            )
        tell(search.add(sample, result.objectives, result.violation))
    for _ in range(generations):
        if spent + search.population > most:
            break
        result = results(search.ask())
        tell(search.tell(result.objectives, result.violation))
    return search.result()


def _evaluate(
    evaluate: Callable[..., Any], points: NDArray[np.float64], executor: Executor | None
) -> Evaluated:
    if executor is None:
        return _evaluated(evaluate(points))
    parts = np.array_split(points, min(BLOCKS, len(points)))
    blocks = [_evaluated(block) for block in executor.map(evaluate, parts)]
    stated = [block.violation is not None for block in blocks]
    try:
        values = np.concatenate([np.asarray(block.objectives, np.float64) for block in blocks])
        if not any(stated):
            return Evaluated(values)
        return Evaluated(
            values, np.concatenate([np.asarray(block.violation, np.float64) for block in blocks])
        )
    except (TypeError, ValueError):
        raise InputError(
            "evaluate returned results of different shapes for different points"
        ) from None


def _evaluated(value: Any) -> Evaluated:
    return (
        Evaluated(*value) if isinstance(value, tuple) and 1 <= len(value) <= 3 else Evaluated(value)
    )
