"""The search of an archive: scouts, then generations of policies that all race in the same scenarios.

The opponents are random policies, fixed for the run as in the paper, whose limitation is that random policies are no
competition. As an option, some of them give way to policies of the archive at stated generations. The archive is then
raced again, so that old and new policies are compared against the same opponents.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.planners.planner import Planner
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.synthesis.config import ArchiveConfig
from pcs_racing_agents.synthesis.diverse import greedy_map, similarity
from pcs_racing_agents.synthesis.evaluate import Evaluation, Scenarios, blocks, join, race_here, summarise
from pcs_racing_agents.synthesis.explored import Scale
from pcs_racing_agents.synthesis.indicators import hypervolume
from pcs_racing_agents.synthesis.selection import front_layers
from pcs_racing_agents.synthesis.synthesize import Search

__all__ = ["REFERENCE", "ArchiveSearch", "News", "Told"]

Floats = NDArray[np.float64]

BLOCK = 2  # policies of a task: a generation of 32 keeps 16 cores busy
REFERENCE = -0.1  # worst point of a hypervolume: a tenth of the scouts' range below their worst


class News(NamedTuple):
    """How far a synthesis is.

    Attributes
    ----------
    stage : str
        What was done last: ``"search"``, ``"choice"`` or ``"measurement"``.
    generation, generations : int
        Generations done, and asked for.
    evaluations : int
        Policies raced in the search so far.
    hypervolume : float
        Of the search's front, in units of the scouts' range; it may fall when opponents are replaced.
    front : int
        Policies in that front.
    own_crash : float
        Mean own crash rate of the policies raced last.
    done : float
        Share of all the racing that is done, 0 to 1.
    """

    stage: str
    generation: int
    generations: int
    evaluations: int
    hypervolume: float
    front: int
    own_crash: float
    done: float


Told = Callable[[News], None]
"""``told(news)``: called after the scouts (generation 0), after every generation, and now and then in later stages."""


@dataclass
class ArchiveSearch:
    """The races of a synthesis, and everything that its search raced.

    Attributes
    ----------
    config : ArchiveConfig
    job : Job
    executor : Executor or None
    told : Told
    family : Planner
    scenarios : Scenarios
        Of the search, as they are now.
    scale : Scale
        Range of the scouts, once they have raced.
    parameters : list of ndarray
        Policies raced, (n, P) each.
    found : list of Evaluation
        What came of them.
    comparable : int
        Policies from here on were raced against the same opponents.
    history : list of News
    """

    config: ArchiveConfig
    job: Job
    executor: Executor | None
    told: Told
    family: Planner
    scenarios: Scenarios
    scale: Scale = field(init=False)
    parameters: list[Floats] = field(default_factory=list)
    found: list[Evaluation] = field(default_factory=list)
    comparable: int = 0
    history: list[News] = field(default_factory=list)

    def race(self, stage: str, name: str, scenarios: Scenarios, parameters: Floats) -> Arrays:
        """Race policies, or read what an earlier run found."""

        def progress(done: int, total: int, what: str) -> None:
            if stage != "search":
                self.told(self.history[-1]._replace(stage=stage, done=self._done(stage, done / total)))

        tasks = blocks(scenarios, parameters, BLOCK)
        return join(self.job.run(name, race_here(self.executor), tasks, executor=self.executor, progress=progress))

    def run(self, scouts: Floats, seed: int) -> None:
        """Race the scouts, then generation after generation."""
        config = self.config
        found = self._raced("scouts", scouts)
        low, high = found.coordinates.min(axis=0), found.coordinates.max(axis=0)
        for axis, least, largest in zip(config.axes, low, high, strict=True):
            if not least < largest:
                raise InputError(f"all {config.scouts} scouts have {axis} {least:g}; such an axis tells nothing apart")
        self.scale = Scale(high, low)
        search = Search(
            self.family.bounds,
            population=config.population,
            elite_ratio=config.elite_ratio,
            loss=config.loss,
            mean=config.mean,
            seed=seed,
            method=config.method,
            reference=REFERENCE,
            ideal=high,
            nadir=low,
            step_size=config.step_size,
        )
        search.add(scouts, found.coordinates, self.violation(found))
        front = self._best(found)
        self.tell("search", 0, hypervolume(self.scale(front), REFERENCE), len(front), found)
        for number in range(1, config.generations + 1):
            if number in config.refresh_generations:
                self._refresh(search, number)
            if sum(map(len, self.parameters)) + config.population > config.evaluations:
                break  # racing the front again has cost as much as the last generations
            asked = search.ask()
            found = self._raced(f"generation-{number:05d}", asked)
            news = search.tell(found.coordinates, self.violation(found))
            self.tell("search", number, news.hypervolume, news.archive_size, found)

    def _raced(self, name: str, parameters: Floats) -> Evaluation:
        found = summarise(self.race("search", name, self.scenarios, parameters))
        self.parameters.append(parameters)
        self.found.append(found)
        return found

    def violation(self, found: Evaluation) -> Floats:
        """By how much policies violate the limits, shape (K,): own crashes per race, or parts of the scouts' range."""
        crashes = found.own_crash - self.config.search_crash_limit
        if self.config.least is None:
            return crashes
        short = (np.array(self.config.least) - found.coordinates) / (self.scale.ideal - self.scale.nadir)
        return np.maximum(crashes, short.max(axis=1))

    def _best(self, found: Evaluation) -> Floats:
        feasible = found.coordinates[self.violation(found) <= 0.0]
        return feasible[front_layers(feasible) == 0]

    def _refresh(self, search: Search, number: int) -> None:
        """Replace opponents by policies spread along the front, and race the front again against the new set."""
        front = search.archive
        count = min(round(self.config.refresh_share * len(self.scenarios.opponents)), len(front))
        if count == 0:
            return
        chosen = np.sort(greedy_map(similarity(self.scale(search.result().objectives), 0.2), count))
        opponents = self.scenarios.opponents.copy()
        opponents[len(opponents) - count :] = front[chosen]
        self.scenarios = self.scenarios.against(opponents)
        self.comparable = sum(map(len, self.parameters))
        found = self._raced(f"refresh-{number:05d}", front)
        search.replace(found.coordinates, self.violation(found))

    def explored(self) -> tuple[Floats, Evaluation]:
        """Everything raced in the search, in that order."""
        parts = zip(*self.found, strict=True)
        return np.concatenate(self.parameters), Evaluation(*(np.concatenate(part) for part in parts))

    def tell(self, stage: str, number: int, volume: float, front: int, found: Evaluation) -> None:
        """Note and tell how far the synthesis is."""
        evaluations = sum(map(len, self.parameters))
        crash = float(found.own_crash.mean())
        done = self._done(stage, 1.0)
        news = News(stage, number, self.config.generations, evaluations, volume, front, crash, done)
        self.history.append(news)
        self.told(news)

    def _done(self, stage: str, part: float) -> float:
        """Share of all racing that is done when part of a stage is."""
        search, choice, measurement = self.config.work
        raced = search if stage != "search" else sum(map(len, self.parameters)) / self.config.evaluations * search
        raced += {"search": 0.0, "choice": part * choice, "measurement": choice + part * measurement}[stage]
        return raced / (search + choice + measurement)
