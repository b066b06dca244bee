"""Synthesis of an archive: search, choice and measurement of policies, as one resumable job.

1. **Search.** Random policies (the initial sample) set the scale. Then the search proposes
   generation after generation, and every policy races in the same scenarios (Algorithm 1 of the
   paper).
2. **Choice.** The best evaluated policies race again, in other scenarios.
3. **Measurement.** The chosen policies race once more in new scenarios. The coordinates come from
   these races alone, since the maximum of many noisy values is biased.

A front (:class:`FrontRun`) meets random policies, fixed for a stage as in the paper. Policies are
left out if they crash too often, are clearly beaten by another policy, or nearly coincide with
another policy. For policies far apart (:class:`SpreadRun`) a tuning finds the champion first. The
searches start at the champion and go in all directions of the axes, a policy much weaker than the
champion violates a limit, and the choice holds policies far apart.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import signed_seed
from pcs_racing.base.settings import plain_settings
from pcs_racing.base.typing import Floats, Indices
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing_agents.base.jobs import Arrays, Job, Run, open_job
from pcs_racing_agents.policies.archive_report import write_archive
from pcs_racing_agents.policies.config import ArchiveConfig, FrontConfig, SpreadConfig
from pcs_racing_agents.policies.evaluate import (
    Evaluation,
    Scenarios,
    circuit,
    draw_scenarios,
    race_in_blocks,
    summarise,
)
from pcs_racing_agents.policies.pareto import Scale, hypervolume
from pcs_racing_agents.policies.search import Search, latin_hypercube
from pcs_racing_agents.policies.selection import (
    clearly_beaten,
    spread_first,
    spread_out,
    thin_out,
)
from pcs_racing_agents.policies.tuning import TuningConfig, TuningRun, policy_text

BLOCK = 2  # policies per task: a generation of 32 keeps 16 cores busy
SPACING = 0.015
"""Min distance between two policies of a front, in units of the front's ranges."""


class SearchProgress(NamedTuple):
    """Progress of a search, after the initial sample (generation 0) or a generation."""

    generation: int
    evaluations: int  #: Number of policies raced so far.
    #: Hypervolume of the search's front, in units of the initial sample's range.
    hypervolume: float
    front: int  #: Number of policies in the search's front.
    own_crash: float  #: Mean own crash rate of the policies raced last.


ArchiveCallback = Callable[[str, int, int, SearchProgress | None], object]
"""Callback ``(stage, done, total, progress)``: after each generation, and parts of other stages."""


def synthesize(
    config: ArchiveConfig,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    callback: ArchiveCallback | None = None,
) -> PolicyArchive:
    """Make an archive and write it: ``archive.npz``, ``manifest.yaml``, ``hypervolume.csv`` and
    ``front.png``.

    Finished races are stored in ``chunks``: an interrupted run resumes when it is started again.
    The picture needs matplotlib; without matplotlib it is left out.

    Parameters
    ----------
    config : FrontConfig or SpreadConfig
        Configuration (:func:`pcs_racing_agents.policies.load_archive_config`).
    folder : str or Path
        A new or empty folder, or a folder with a started run of the same synthesis.
    executor : Executor, optional
        Executor of the races (:func:`pcs_racing_agents.base.executors.make_executor`). It has no
        influence on the result.
    callback : callable, optional
        Called with stage, finished and total number of its parts, and in the search with the
        :class:`SearchProgress`.
    """
    folder = Path(folder)
    used = dict.fromkeys(config.circuits(0) + config.circuits(1))
    hashes = {name: circuit(name, config.race_rules).content_hash for name in used}
    # Drawn before the folder is made: an invalid option must not leave a folder behind.
    stage_scenarios(config)
    settings = {**plain_settings(config), "rules": config.race_rules, "track_hashes": hashes}
    with open_job(folder, "archive", settings) as job:
        run = RUNS[type(config)](config, job, executor, callback or (lambda *_: None))
        search, choice, final = run.scenarios()
        run.search(search)
        kept, raced = run.measure(run.choose(choice), final)
        run.notes["track_hashes"] = ", ".join(f"{k} {digest[:16]}" for k, digest in hashes.items())
        return write_archive(
            folder, config, run.explored(), run.scale, kept, raced, run.course, run.notes
        )


def stage_scenarios(
    config: ArchiveConfig, champion: str | None = None
) -> tuple[Scenarios, Scenarios, Scenarios]:
    """Return the scenarios of search, choice and measurement; no two stages share a race.

    ``champion`` is met as well as the rivals.
    """

    def drawn(stage: int, starts: int, duration: float) -> Scenarios:
        root = _roots(config)[stage]
        count, rivals = config.met(stage)
        opponents = draw_policies(config, count, root)
        return draw_scenarios(
            config.planner,
            config.circuits(stage),
            config.rules_of(duration),
            opponents=opponents,
            rivals=tuple(dict.fromkeys((*rivals, *([champion] if champion else [])))),
            characteristics=config.axes,
            segment_seconds=config.segment_seconds,
            starts=starts,
            seed=_number(root),
        )

    return (
        drawn(0, config.starts, config.duration),
        drawn(1, 2 * config.starts, config.duration),
        drawn(2, config.final_starts, config.final_duration),
    )


def draw_policies(config: ArchiveConfig, count: int, root: np.random.SeedSequence) -> Floats:
    """Draw random policies within their bounds by Latin hypercube sampling, shape (count, P).

    Fixed parameters are not drawn and have their values of the start.

    The mean strength of a set of opponents shifts the lead of every policy that races against them.
    It varies less between small Latin hypercube samples than between independent draws.
    """
    planner = get_planner(config.planner)
    low, high = config.bounds.T
    drawn = low + latin_hypercube(count, len(low), np.random.default_rng(root)) * (high - low)
    return planner.complete(config.varied, drawn, config.start_policy.parameters)


def _roots(config: ArchiveConfig) -> list[np.random.SeedSequence]:
    """Return the root seeds: of the three stages, the initial sample, the search, the champion."""
    return np.random.SeedSequence(config.seed).spawn(6)


def _number(root: np.random.SeedSequence) -> int:
    """Return a seed derived from a root, independent of the draws from the root itself."""
    # A child of the root, since other draws use the root itself.
    return signed_seed(root.spawn(1)[0])


@dataclass
class ArchiveRun:
    """Stages of a synthesis, whose races are tasks of one job, and the record of its search.

    Parameters of policies have the shape (K, P), fixed ones included.
    """

    min_policies: ClassVar[int] = 2  #: Min number of policies of an archive.

    config: ArchiveConfig
    job: Job
    executor: Executor | None
    callback: ArchiveCallback
    min_score: float = 0.0  #: Min score of a policy of the archive.
    #: Parameters and results of the initial sample and of each generation.
    searched: list[tuple[Floats, Evaluation]] = field(default_factory=list)
    course: list[SearchProgress] = field(default_factory=list)
    #: Further entries of the manifest: numbers of policies left out for each reason.
    notes: dict[str, str | float] = field(default_factory=dict)

    @property
    def scale(self) -> Scale:
        """Range of the initial sample, the unit of hypervolumes."""
        return Scale.of(self.searched[0][1].coordinates)

    def explored(self) -> tuple[Floats, Evaluation]:
        """Return parameters and results of all policies of the search, in race order."""
        parameters, results = zip(*self.searched, strict=True)
        return np.concatenate(parameters), Evaluation(
            *(np.concatenate(arrays) for arrays in zip(*results, strict=True))
        )

    def scenarios(self) -> tuple[Scenarios, Scenarios, Scenarios]:
        """Return the scenarios of search, choice and measurement."""
        return stage_scenarios(self.config)

    def begin(self, scenarios: Scenarios) -> Floats | None:
        """Race the initial sample, and return the first parameters of searches."""
        sample = draw_policies(self.config, self.config.initial_sample, _roots(self.config)[3])
        self._searched("initial-sample", scenarios, sample)
        return None

    def violation(self, evaluation: Evaluation) -> Floats:
        """Return by how much policies violate the limits of the search, shape (K,)."""
        beyond = evaluation.own_crash - self.config.search_crash_limit
        return np.maximum(beyond, self.min_score - evaluation.score)

    def search(self, scenarios: Scenarios) -> None:
        """Race the initial sample and generation after generation in the same scenarios.

        Each direction of the axes has a search of its own, which knows the initial sample.
        """
        config, planner = self.config, get_planner(self.config.planner)
        varied, root = planner.indices(config.varied), _roots(config)[4]
        start = self.begin(scenarios)
        sample, sampled = self.searched[0]
        violation = self.violation(sampled)
        for number, signs in enumerate(config.directions):
            search = Search(
                config.bounds,
                population=config.population,
                step_size=config.step_size,
                start=None if start is None else start[varied],
                seed=_number(root),
            )
            search.add(sample[:, varied], signs * sampled.coordinates, violation)
            self._note(search)
            for generation in range(1, config.generations + 1):
                name = f"generation-{number * config.generations + generation:05d}"
                points = planner.complete(
                    config.varied, search.ask(), config.start_policy.parameters
                )
                found = self._searched(name, scenarios, points)
                search.tell(signs * found.coordinates, self.violation(found))
                self._note(search)

    def choose(self, scenarios: Scenarios) -> Floats:
        """Choose among the policies of the search, by new races."""
        config = self.config
        theta, explored = self.explored()
        # Points evaluated several times race once.
        rows = np.sort(np.unique(theta, axis=0, return_index=True)[1])
        crashing = explored.own_crash > config.search_crash_limit
        allowed = rows[self.violation(explored)[rows] <= 0.0]
        if len(allowed) == 0:
            raise InputError(
                f"all {len(rows)} policies crash in more than {config.search_crash_limit:.0%} of"
                f" the races of {config.duration:g} s, or are outside the other limits; raise"
                " crash_limit or margin, or lower min_coordinates"
            )
        points = self.scale(explored.coordinates)
        self.notes |= {
            "search_over_crash_limit": int(crashing.sum()),
            "search_hypervolume": hypervolume(points[rows[~crashing[rows]]]),
            "search_hypervolume_without_crash_limit": hypervolume(points[rows]),
        }
        return self.chosen(theta, explored.coordinates, allowed, scenarios)

    def chosen(
        self, theta: Floats, coordinates: Floats, allowed: Indices, scenarios: Scenarios
    ) -> Floats:
        """Race allowed policies of the search in new scenarios, and choose some of them."""
        raise NotImplementedError

    def unbeaten(self, raced: Arrays, rows: Indices) -> Indices:
        """Return the policies in ``rows`` that no other one excludes from the archive."""
        return rows

    def measure(self, parameters: Floats, scenarios: Scenarios) -> tuple[Floats, Arrays]:
        """Race policies in new scenarios, sort them by the first axis, and filter them.

        Policies that still crash too often or score too little are left out, and policies that
        another policy excludes. Return the remaining policies and their races.
        """
        self._check_number(len(parameters))
        raced = self._race("measurement", "measurement", scenarios, parameters)
        measured = summarise(raced)
        within = np.flatnonzero(
            (measured.own_crash <= self.config.crash_limit) & (measured.score >= self.min_score)
        )
        kept = self.unbeaten(raced, within)
        self._check_number(len(kept))
        # Sorted from the most careful to the fastest policy.
        kept = kept[np.argsort(measured.coordinates[kept, 0], kind="stable")]
        self.notes |= {
            "measurement_outside_limits": len(parameters) - len(within),
            "measurement_beaten": len(within) - len(kept),
        }
        return parameters[kept], {key: values[kept] for key, values in raced.items()}

    def _check_number(self, policies: int) -> None:
        if policies < self.min_policies:
            raise InputError(
                f"{policies} policies remain below the crash limit of {self.config.crash_limit:.0%}"
                f" and within the other limits; an archive needs {self.min_policies} at least:"
                " raise crash_limit or margin, or search longer"
            )

    def _searched(self, name: str, scenarios: Scenarios, parameters: Floats) -> Evaluation:
        """Race and record policies of the search."""
        evaluation = summarise(self._race("search", name, scenarios, parameters))
        self.searched.append((parameters, evaluation))
        return evaluation

    def _race(self, stage: str, name: str, scenarios: Scenarios, parameters: Floats) -> Arrays:
        """Race policies as tasks of this name, or load results of an earlier run."""

        def progress(done: int, total: int, _: str) -> None:
            # The search reports by generation, with the hypervolume, unknown to the tasks.
            if stage != "search":
                self.callback(stage, done, total, None)

        run: Run = {"job": self.job, "executor": self.executor, "progress": progress}
        return race_in_blocks(name, scenarios, parameters, BLOCK, **run)

    def _note(self, search: Search) -> None:
        """Record a generation of the search, and call the callback."""
        raced = sum(len(parameters) for parameters, _ in self.searched)
        crash = float(self.searched[-1][1].own_crash.mean())
        self.course.append(
            SearchProgress(
                search.generation, raced, search.hypervolume, len(search.parameters), crash
            )
        )
        self.callback("search", raced, self.config.evaluations, self.course[-1])


class FrontRun(ArchiveRun):
    """Synthesis of a front of policies."""

    config: FrontConfig

    def violation(self, evaluation: Evaluation) -> Floats:
        """Return by how much policies violate the limits of the search, shape (K,).

        Rates are per race; coordinates are in units of the initial sample's range.
        """
        beyond = super().violation(evaluation)
        if self.config.min_coordinates is None:
            return beyond
        shortfall = (np.array(self.config.min_coordinates) - evaluation.coordinates) / (
            self.scale.ideal - self.scale.nadir
        )
        return np.maximum(beyond, shortfall.max(axis=1))

    def chosen(
        self, theta: Floats, coordinates: Floats, allowed: Indices, scenarios: Scenarios
    ) -> Floats:
        """Race the best policies in new scenarios; choose policies not clearly beaten."""
        points = _unit(coordinates[allowed])
        order = allowed[spread_first(points, 0.5 * SPACING, self.config.candidates)]
        raced = self._race("choice", "choice", scenarios, theta[order])
        measured = summarise(raced)
        within = np.flatnonzero(self.violation(measured) <= 0.0)
        kept = self.unbeaten(raced, within)
        points = _unit(measured.coordinates[kept])
        distinct = kept[thin_out(points, SPACING, self.config.max_policies)]
        self.notes |= {
            "choice_candidates": len(order),
            "choice_outside_limits": len(order) - len(within),
            "choice_beaten": len(within) - len(kept),
            "choice_too_near_another": len(kept) - len(distinct),
        }
        return theta[order[distinct]]

    def unbeaten(self, raced: Arrays, rows: Indices) -> Indices:
        """Return the policies in ``rows`` that no other one clearly beats.

        Beaten policies add nothing to the front, so their removal makes the front look no better
        than it is.
        """
        return rows[~clearly_beaten(raced, rows)]


class SpreadRun(ArchiveRun):
    """Synthesis of strong policies that are far from each other."""

    min_policies = 3

    config: SpreadConfig
    champion: Floats  #: shape (P,): Parameters of the champion, once it is tuned.

    def scenarios(self) -> tuple[Scenarios, Scenarios, Scenarios]:
        """Tune the champion, and return the scenarios, which meet it."""
        config = self.config
        tuning = TuningConfig(
            planner=config.planner,
            against=config.rivals,
            tracks=config.tracks,
            held_out=(),
            rules=config.rules,
            duration=config.final_duration,
            start=config.start,
            fixed=config.fixed,
            generations=config.champion_generations,
            crash_limit=config.crash_limit,
            seed=_number(_roots(config)[5].spawn(1)[0]),
        )

        def show(_: str, done: int, total: int, __: object) -> None:
            self.callback("champion", done, total, None)

        run = TuningRun(tuning, self.job, self.executor, show, "champion-1")
        text = policy_text(get_planner(config.planner), run.choose(run.search()))
        self.champion = parse_policy(text).parameters
        self.notes["champion_1"] = text
        return stage_scenarios(config, text)

    def begin(self, scenarios: Scenarios) -> Floats:
        """Race an initial sample around the champion, and return the champion."""
        sample = draw_policies(self.config, self.config.initial_sample, _roots(self.config)[3])
        # Halfway to the champion: of policies drawn at random hardly any is strong.
        sample = 0.5 * (sample + self.champion)
        sample[0] = self.champion
        found = self._searched("initial-sample", scenarios, sample)
        self.min_score = float(found.score[0]) - self.config.margin
        return self.champion

    def chosen(
        self, theta: Floats, coordinates: Floats, allowed: Indices, scenarios: Scenarios
    ) -> Floats:
        """Race strong policies far apart in new scenarios; choose some that still are.

        The start and the champion are always among them.
        """
        config = self.config
        rows = np.concatenate([[0], allowed[allowed != 0]])  # the first one is the champion
        order = rows[spread_out(_unit(coordinates[rows]), config.candidates)]
        known = np.unique([self.champion, config.start_policy.parameters], axis=0)
        candidates = np.concatenate([known, theta[order[1:]]])
        measured = summarise(self._race("choice", "choice", scenarios, candidates))
        self.min_score = float(measured.score[: len(known)].max()) - config.margin
        within = np.flatnonzero(self.violation(measured) <= 0.0)
        kept = np.unique(np.concatenate([np.arange(len(known)), within]))
        points = _unit(measured.coordinates[kept])
        self.notes |= {
            "choice_candidates": len(candidates),
            "choice_outside_limits": len(candidates) - len(within),
            "choice_min_score": self.min_score,
        }
        return candidates[kept[spread_out(points, config.max_policies, len(known))]]


RUNS: dict[type[ArchiveConfig], Callable[..., ArchiveRun]] = {
    FrontConfig: FrontRun,
    SpreadConfig: SpreadRun,
}
"""Algorithms by their configurations."""


def _unit(points: Floats) -> Floats:
    """Return points scaled by their own range."""
    if len(points) == 0:
        return points
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((points - low) / np.maximum(high - low, 1e-12), np.float64)
