"""Optimisers with one ask-and-tell protocol: MO-CMA-ES and baselines.

All optimisers get the same information: number of parameters, size of a generation, seed, and after
every generation its objectives and violations. They do not know the ideal or nadir point in advance
unless the caller states it.

- ``nsga2``: pymoo's NSGA-II with its default operators.
- ``random``: uniform in the box.

``nsga2`` needs ``pip install "pcs-racing[baselines]"``.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import UnknownNameError, require
from pcs_racing_agents.policies.mo_cma_es import MOCMAES, OptimiserOptions
from pcs_racing_agents.policies.pareto_archive import ParetoArchive

Floats = NDArray[np.float64]


class Optimiser(Protocol):
    """Ask-and-tell optimiser in the unit cube."""

    @property
    def restarts(self) -> int:
        """Number of restarts."""

    @property
    def step_size(self) -> float:
        """Maximum standard deviation as a share of a parameter's range; NaN without step size."""

    def ask(self) -> Floats:
        """Return a generation of points, shape (n, P); the caller clips them to the unit cube."""

    def tell(
        self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive
    ) -> ParetoArchive:
        """Learn from the results of ``ask``, and return the archive with the points added."""


class Random:
    """Random search: points drawn uniformly."""

    restarts = 0
    step_size = np.nan

    def __init__(self, spec: OptimiserOptions) -> None:
        self._shape = spec.population, spec.dimension
        self._rng = np.random.default_rng(spec.seed)

    def ask(self) -> Floats:
        """Return points drawn uniformly."""
        return self._rng.random(self._shape)

    def tell(
        self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive
    ) -> ParetoArchive:
        """Return the archive with the points added; nothing is learned."""
        return archive.joined(points, objectives, violation)


class NSGA2:
    """NSGA-II of pymoo: K. Deb and others, IEEE Trans. Evolutionary Computation 6(2), 2002."""

    restarts = 0
    step_size = np.nan

    def __init__(self, spec: OptimiserOptions) -> None:
        require("pymoo", extra="baselines")
        self._spec = spec
        self._algorithm: Any = None
        self._asked: Any = None

    def _set_up(self, objectives: int) -> None:
        from pymoo.algorithms.moo.nsga2 import NSGA2 as Algorithm  # noqa: N811
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination

        self._algorithm = Algorithm(pop_size=self._spec.population)
        problem = Problem(
            n_var=self._spec.dimension, n_obj=objectives, n_ieq_constr=1, xl=0.0, xu=1.0
        )
        seed = int(self._spec.seed.generate_state(1)[0])
        self._algorithm.setup(problem, termination=NoTermination(), seed=seed, verbose=False)

    def ask(self) -> Floats:
        """Return the first population (drawn uniformly) or the children of the last population."""
        if self._algorithm is None:
            self._set_up(2)  # the number of objectives has no influence before the first results
        self._asked = self._algorithm.ask()
        return np.asarray(self._asked.get("X"), np.float64)

    def tell(
        self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive
    ) -> ParetoArchive:
        """Let the generation compete with its parents."""
        from pymoo.core.evaluator import Evaluator
        from pymoo.problems.static import StaticProblem

        self._algorithm.problem.n_obj = objectives.shape[1]
        evaluated = StaticProblem(self._algorithm.problem, F=-objectives, G=violation[:, None])
        Evaluator().eval(evaluated, self._asked)
        self._algorithm.tell(infills=self._asked)
        return archive.joined(points, objectives, violation)


_METHODS: dict[str, Callable[[OptimiserOptions], Optimiser]] = {
    "mo-cma-es": MOCMAES,
    "nsga2": NSGA2,
    "random": Random,
}
METHODS = tuple(_METHODS)


def make_optimiser(
    method: str | Callable[[OptimiserOptions], Optimiser], spec: OptimiserOptions
) -> Optimiser:
    """Return an optimiser by name, or the result of a function of the options."""
    if not isinstance(method, str):
        return method(spec)
    if method not in _METHODS:
        raise UnknownNameError(f"method is {method!r}; it must be one of {', '.join(METHODS)}")
    return _METHODS[method](spec)
