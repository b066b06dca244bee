"""Races of a synthesis: objective function of the search, and record of its results.

The opponents are random policies, fixed for the run as in the paper. The authors call this a
limitation, but opponents from the growing archive did not help (``docs/synthesis.md``).
"""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Job, run_races
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.policies.config import ArchiveConfig
from pcs_racing_agents.policies.evaluate import (
    Evaluation,
    Scenarios,
    join,
    race_policies,
    summarise,
)
from pcs_racing_agents.policies.pareto_archive import Scale
from pcs_racing_agents.policies.policy_pool import PolicyPool, pool_payoffs
from pcs_racing_agents.policies.search import Generation
from pcs_racing_agents.policies.synthesize import Evaluated

Floats = NDArray[np.float64]

BLOCK = 2  # policies per task: a generation of 32 keeps 16 cores busy
REFERENCE = -0.1  # reference point: a tenth of the initial sample's range below its worst values


class ArchiveProgress(NamedTuple):
    """Progress of a synthesis."""

    #: Stage of the latest work: ``"search"``, ``"choice"``, ``"measurement"`` or, for policies
    #: chosen for headroom, ``"judgement"``.
    stage: str
    #: ``generation``, ``generations``: Numbers of finished and requested generations.
    generation: int
    generations: int
    evaluations: int  #: Number of policies raced in the search so far.
    #: Hypervolume of the search's front, in units of the initial sample's range.
    hypervolume: float
    front: int  #: Number of policies in the search's front.
    own_crash: float  #: Mean own crash rate of the policies raced last.
    done: float  #: Finished share of all racing, 0 to 1.


ArchiveCallback = Callable[[ArchiveProgress], object]
"""Callback after the initial sample (generation 0), every generation, and parts of later stages."""


@dataclass
class PolicyRaces:
    """Objective function of a synthesis: a call races the given policies as tasks of a job."""

    config: ArchiveConfig
    job: Job
    executor: Executor | None
    callback: ArchiveCallback
    scenarios: Scenarios  #: Races of the search.
    scale: Scale = field(init=False)  #: Range of the initial sample, once it has raced.
    #: Parameters, shape (n, P), and results of all policies of the search, in the order of the
    #: races.
    raced: list[tuple[Floats, Evaluation]] = field(default_factory=list)
    history: list[ArchiveProgress] = field(default_factory=list)
    # names of the next evaluations
    _names: deque[str] = field(default_factory=lambda: deque(["initial-sample"]))

    def __call__(self, parameters: Floats) -> Evaluated:
        """Race policies in the scenarios of the search; crashes above the limit are violations."""
        evaluation = summarise(
            self.race("search", self._names.popleft(), self.scenarios, parameters)
        )
        # The first policies are the initial sample, whose range is the unit of hypervolumes.
        if not self.raced:
            low, high = evaluation.coordinates.min(axis=0), evaluation.coordinates.max(axis=0)
            for axis, least, largest in zip(self.config.axes, low, high, strict=True):
                if not least < largest:
                    raise InputError(
                        f"the initial sample has {axis} {least:g} throughout: no scale follows"
                        " from it"
                    )
            self.scale = Scale(high, low)
        self.raced.append((parameters, evaluation))
        return Evaluated(evaluation.coordinates, self.violation(evaluation))

    def after_generation(self, generation: Generation) -> None:
        """Record the progress."""
        self.note(
            "search",
            generation.generation,
            generation.hypervolume,
            generation.archive_size,
            self.raced[-1][1],
        )
        self._names.append(f"generation-{generation.generation + 1:05d}")

    def race(self, stage: str, name: str, scenarios: Scenarios, parameters: Floats) -> Arrays:
        """Race policies, given by the parameters that vary, or load results of an earlier run."""
        parameters = self._complete(parameters)
        tasks = [
            (scenarios, parameters[first : first + BLOCK])
            for first in range(0, len(parameters), BLOCK)
        ]
        # The search reports progress by generation, with the hypervolume, unknown to the tasks.
        progress = None if stage == "search" else self.progress(stage)
        return join(
            run_races(
                name, race_policies, tasks, job=self.job, executor=self.executor, progress=progress
            )
        )

    def payoffs(self, stage: str, pool: PolicyPool) -> Floats:
        """Race all pairs of a pool or load results of an earlier run, shape (T, F, N, N)."""
        return pool_payoffs(
            pool, name=stage, job=self.job, executor=self.executor, progress=self.progress(stage)
        )

    def progress(self, stage: str) -> Progress:
        """Return a callback for the tasks of a stage."""

        def progress(done: int, total: int, _: str) -> None:
            self.callback(
                self.history[-1]._replace(stage=stage, done=self._done(stage, done / total))
            )

        return progress

    def _complete(self, parameters: Floats) -> Floats:
        """Return parameters of policies, completed by the parameters that do not vary."""
        return get_planner(self.config.planner).complete(self.config.varied, parameters)

    def violation(self, evaluation: Evaluation) -> Floats:
        """Return by how much policies violate the limits, shape (K,).

        Rates are per race; coordinates are in units of the initial sample's range.
        """
        beyond = evaluation.own_crash - self.config.search_crash_limit
        if self.config.rivals:
            beyond = np.maximum(beyond, self.config.min_score - evaluation.score)
        if self.config.min_coordinates is None:
            return beyond
        shortfall = (np.array(self.config.min_coordinates) - evaluation.coordinates) / (
            self.scale.ideal - self.scale.nadir
        )
        return np.maximum(beyond, shortfall.max(axis=1))

    @property
    def evaluations(self) -> int:
        """Number of policies raced in the search so far."""
        return sum(len(parameters) for parameters, _ in self.raced)

    def explored(self) -> tuple[Floats, Evaluation]:
        """Return parameters and results of all policies of the search, in race order."""
        parameters, results = zip(*self.raced, strict=True)
        return np.concatenate(parameters), Evaluation(
            *(np.concatenate(arrays) for arrays in zip(*results, strict=True))
        )

    def note(
        self, stage: str, number: int, volume: float, front: int, evaluation: Evaluation
    ) -> None:
        """Add the progress to the history, and call the callback."""
        crash, done = float(evaluation.own_crash.mean()), self._done(stage, 1.0)
        progress = ArchiveProgress(
            stage, number, self.config.generations, self.evaluations, volume, front, crash, done
        )
        self.history.append(progress)
        self.callback(progress)

    def _done(self, stage: str, share: float) -> float:
        """Return the share of all racing that is done after a share of a stage."""
        work = self.config.work
        if stage == "search":
            # A search may end early or resume, so its progress is the number of policies raced.
            share *= self.evaluations / self.config.evaluations
        earlier = list(work)[: list(work).index(stage)]
        return (sum(work[name] for name in earlier) + share * work[stage]) / sum(work.values())
