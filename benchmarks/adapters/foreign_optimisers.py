"""Optimisers of two other libraries, as the search takes them (``Search(method=...)``), for benchmarks that compare.

All get the same information as our own: the number of parameters, the size of a generation, a seed, and after every
generation its objectives and violations. ``pip install "pcs-racing[baselines]"`` installs both libraries.

- ``comocma``: COMO-CMA-ES, a handful of CMA-ES that look for a place each on the front; two objectives only.
- ``cma-mae``: CMA-MAE of pyribs. The cells of its archive are directions of the trade-off (differences between
  normalised objectives), and in every cell it maximises the sum of the normalised objectives. Its ranges must be known:
  they come from a first generation at random.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.optional import require
from pcs_racing_agents.synthesis.mo_cma_es import OptimiserOptions, cma_options, middle_of_the_best
from pcs_racing_agents.synthesis.optimisers import METHODS
from pcs_racing_agents.synthesis.pareto_archive import ParetoArchive, Scale

Floats = NDArray[np.float64]


class COMO:
    """COMO-CMA-ES: C. Toure and others, GECCO 2019; comocma's, without restarts.

    As many kernels as have room in a generation, each with the default population of CMA-ES or a little more, and a
    point for its mean. They start at points drawn uniformly.
    """

    restarts = 0

    def __init__(self, setting: OptimiserOptions) -> None:
        if setting.dimension < 2:
            raise InputError("CMA-ES needs at least 2 parameters; there is 1")
        require("comocma", extra="baselines")
        import cma
        import comocma

        self._setting = setting
        rng = np.random.default_rng(setting.seed)
        count = max(1, setting.population // (4 + int(3 * np.log(setting.dimension)) + 1))
        sizes = [len(points) - 1 for points in np.array_split(np.arange(setting.population), count)]
        options = {**cma_options(rng), "bounds": [0.0, 1.0], "BoundaryHandler": cma.BoundPenalty}
        kernels = [
            comocma.CmaKernel(rng.random(setting.dimension), setting.step_size, {**options, "popsize": size})
            for size in sizes
        ]
        for kernel in kernels:
            kernel.stop = _no_stop
        quiet = {"archive": False, "verb_log": 0, "verb_disp": 0, "update_order": lambda _: rng.random()}
        if np.size(setting.reference) > 2:
            raise InputError(f"method 'comocma' handles 2 objectives; the reference has {np.size(setting.reference)}")
        reference = (-np.asarray(setting.reference) * np.ones(2)).tolist()
        self._kernels, self._raw = kernels, [np.zeros(2)] * len(kernels)
        self._sofomore = comocma.Sofomore(kernels, reference, quiet)
        self._asked: Any = None

    @property
    def step_size(self) -> float:
        """Of the kernel with the largest one."""
        return float(max(np.max(kernel.stds) for kernel in self._kernels))

    def ask(self) -> Floats:
        """Return the means of all kernels and what they sample around them."""
        self._means = list(self._sofomore._told_indices)
        self._asked = self._sofomore.ask("all")
        return np.stack(self._asked)

    def tell(self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive) -> ParetoArchive:
        """Update the kernels one after another, each against the means of the others."""
        if objectives.shape[1] != 2:
            raise InputError(f"method 'comocma' handles 2 objectives; there are {objectives.shape[1]}")
        grown = archive.joined(points, objectives, violation)
        scale = grown.scale(self._setting.ideal, self._setting.nadir)
        worst = _worst(scale, objectives, violation)
        # The scale has moved since the means were evaluated.
        for kernel, row in zip(self._means, worst, strict=False):
            self._raw[kernel] = row
        for kernel, raw in zip(self._kernels, self._raw, strict=True):
            kernel.objective_values = (-scale(raw)).tolist()
        self._sofomore.tell(self._asked, (-scale(worst)).tolist())
        return grown


class CMAMAE:
    """CMA-MAE: M. Fontaine and S. Nikolaidis, Covariance matrix adaptation MAP-annealing, GECCO 2023; pyribs'.

    Pyribs itself would draw anew until all points lie within bounds, if need be for ever, so it is given none.
    """

    LEARNING_RATE = 0.01  # both as in the paper
    CELLS = 100

    def __init__(self, setting: OptimiserOptions) -> None:
        require("ribs", extra="baselines")
        self._setting = setting
        self._rng = np.random.default_rng(setting.seed)
        self._archive: Any = None
        self._emitters: list[Any] = []
        self._scale: Scale | None = None

    @property
    def restarts(self) -> int:
        """Of all emitters together."""
        return sum(emitter.restarts for emitter in self._emitters)

    @property
    def step_size(self) -> float:
        """Of the emitter with the largest one, before its covariances; NaN in the first generation."""
        return max((float(emitter._opt.sigma) for emitter in self._emitters), default=np.nan)

    def ask(self) -> Floats:
        """Return points at random in the first generation, then what the emitters propose."""
        if self._archive is None:
            return self._rng.random((self._setting.population, self._setting.dimension))
        return np.concatenate([emitter.ask() for emitter in self._emitters])

    def _set_up(self, objectives: int, lowest: float, start: Floats) -> None:
        from ribs.archives import GridArchive
        from ribs.emitters import EvolutionStrategyEmitter

        axes, seeds = objectives - 1, self._setting.seed.generate_state(6)[1:].tolist()
        self._archive = GridArchive(
            solution_dim=self._setting.dimension,
            dims=[max(2, round(self.CELLS ** (1.0 / axes)))] * axes,
            ranges=[(-1.0, 1.0)] * axes,
            learning_rate=self.LEARNING_RATE,
            threshold_min=lowest,
            seed=seeds[0],
        )
        count = min(4, max(1, self._setting.population // 12))
        self._emitters = [
            EvolutionStrategyEmitter(
                self._archive,
                x0=start,
                sigma0=self._setting.step_size,
                ranker="imp",
                selection_rule="mu",
                restart_rule="basic",
                batch_size=len(points),
                seed=seed,
            )
            for points, seed in zip(np.array_split(np.arange(self._setting.population), count), seeds[1:], strict=False)
        ]

    def tell(self, points: Floats, objectives: Floats, violation: Floats, archive: ParetoArchive) -> ParetoArchive:
        """Fill the cells, and let the emitters follow what improved them."""
        grown = archive.joined(points, objectives, violation)
        first = self._archive is None
        if first:
            everything = ParetoArchive.empty(points.shape[1]).joined(points, objectives, violation)
            self._scale = _whole_range(everything, self._setting)
        assert self._scale is not None
        values = self._scale(_worst(self._scale, objectives, violation))
        total, directions = values.sum(axis=1), values[:, :-1] - values[:, 1:]
        if first:
            start = middle_of_the_best(grown) if self._setting.start is None else self._setting.start
            self._set_up(objectives.shape[1], float(total.min()), start)
            self._archive.add(points, total, directions)
            return grown
        insertion = self._archive.add(points, total, directions)
        begin = 0
        for emitter in self._emitters:
            rows = slice(begin, begin + emitter.batch_size)
            begin += emitter.batch_size
            emitter.tell(
                points[rows], total[rows], directions[rows], {key: value[rows] for key, value in insertion.items()}
            )
        return grown


def _no_stop(**_: Any) -> dict[str, Any]:
    """Return no reason to stop: every generation asks all kernels."""
    return {}


def _worst(scale: Scale, objectives: Floats, violation: Floats) -> Floats:
    """Return objectives, those of infeasible points below all feasible ones, the lower the more they violate."""
    infeasible = violation > 0.0
    if not infeasible.any():
        return objectives
    extent = scale.ideal - scale.nadir
    lowest = np.minimum(objectives.min(axis=0), scale.nadir) - extent
    return np.where(infeasible[:, None], lowest - violation[:, None] * extent, objectives)


def _whole_range(explored: ParetoArchive, setting: OptimiserOptions) -> Scale:
    if setting.ideal is not None and setting.nadir is not None:
        return Scale(setting.ideal, setting.nadir)
    rows = explored.violation <= 0.0
    values = explored.objectives[rows] if rows.any() else explored.objectives
    low, high = values.min(axis=0), values.max(axis=0)
    return Scale(np.where(low < high, high, low + 1.0), low)


FOREIGN = {"comocma": COMO, "cma-mae": CMAMAE}
ALL = (*METHODS[:-1], *FOREIGN, METHODS[-1])
"""Names of all methods that are compared; random search comes last."""
