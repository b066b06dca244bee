"""Synthesis of an archive: search, choice and measurement of policies, as one resumable job.

1. **Champions**, an option: tunings (:mod:`pcs_racing_agents.policies.tuning`) find strong
   policies, each against the rivals and the champions before it.
2. **Search.** Random policies (the initial sample) set the scale. Then the search proposes
   generation after generation, and every policy races in the same scenarios (Algorithm 1 of the
   paper). The opponents are random policies, fixed for the run as in the paper, rivals and
   champions.
3. **Choice.** The best evaluated policies race again, in other scenarios. Policies are left out if
   they crash too often, are clearly beaten by another policy, or nearly coincide with another
   policy. With ``selection: spread`` the searches start at the last champion and go in all
   directions of the axes, a policy much weaker than the champion violates a limit, and the choice
   holds policies far apart.
4. **Measurement.** The remaining policies race once more in new scenarios. The coordinates come
   from these races alone, since the maximum of many noisy values is biased.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import signed_seed
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.folders import clear_half_written
from pcs_racing_agents.base.jobs import Job, open_job, run_races
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.policies.archive_report import write_archive
from pcs_racing_agents.policies.config import ArchiveConfig
from pcs_racing_agents.policies.evaluate import (
    Evaluation,
    Scenarios,
    draw_scenarios,
    race_policies,
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
from pcs_racing_agents.policies.tuning import TuningProgress, TuningRun, policy_text

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Notes = Mapping[str, str | float]

BLOCK = 2  # policies per task: a generation of 32 keeps 16 cores busy


class ArchiveProgress(NamedTuple):
    """Progress of a synthesis."""

    #: Stage of the latest work: ``"champions"``, ``"search"``, ``"choice"`` or ``"measurement"``.
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


def synthesize(
    config: ArchiveConfig,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    callback: ArchiveCallback | None = None,
) -> PolicyArchive:
    """Make an archive and write it: ``archive.npz``, ``manifest.yaml``, ``hypervolume.csv`` and
    ``front.png``.

    Intermediate results are stored in the folder ``job``: an interrupted run resumes when it is
    started again. The picture needs matplotlib; without matplotlib it is left out.

    Parameters
    ----------
    folder : str or Path
        A new or empty folder, or a folder with a started run of the same synthesis.
    executor : Executor, optional
        Executor of the races (:func:`pcs_racing_agents.base.executors.make_executor`). It has no
        influence on the result.
    callback : callable, optional
        Called with the :class:`ArchiveProgress` during the run.
    """
    folder = Path(folder)
    hashes = {name: load_track(name).content_hash for name in config.tracks}
    # Drawn before the folder is made: an invalid option must not leave a folder behind.
    stage_scenarios(config)
    _check_folder(folder)
    settings = {**plain_settings(config), "rules": config.rules, "track_hashes": hashes}
    with open_job(folder / "job", "archive", settings) as job:
        clear_half_written(folder)
        run = ArchiveRun(config, job, executor, callback or (lambda _: None))
        run.find_champions()
        search, choice, final = stage_scenarios(config, run.champions)
        run.search(search)
        candidates, notes = run.choose(choice)
        kept, raced, more = run.measure(candidates, final)
        content = ", ".join(f"{name} {digest[:16]}" for name, digest in hashes.items())
        champions = {f"champion_{k}": text for k, text in enumerate(run.champions, 1)}
        notes = {**champions, **notes, **more, "track_hashes": content}
        steps = [step for step in run.history if step.stage == "search"]
        return write_archive(folder, config, run.explored(), run.scale, kept, raced, steps, notes)


def stage_scenarios(
    config: ArchiveConfig, champions: Sequence[str] = ()
) -> tuple[Scenarios, Scenarios, Scenarios]:
    """Return the scenarios of search, choice and measurement; no two stages share a race.

    ``champions`` are met as well as the rivals.
    """
    search, choice, final, *_ = _roots(config)

    def drawn(
        root: np.random.SeedSequence, opponents: int, starts: int, duration: float
    ) -> Scenarios:
        policies = draw_policies(config, opponents, root)
        seed = _number(root)
        return draw_scenarios(
            config.planner,
            config.tracks,
            config.rules_of(duration),
            opponents=policies,
            rivals=config.rivals_with(champions),
            characteristics=config.axes,
            segment_seconds=config.segment_seconds,
            starts=starts,
            seed=seed,
        )

    return (
        drawn(search, config.opponents, config.starts, config.duration),
        drawn(choice, config.choice_opponents, config.choice_starts, config.duration),
        drawn(final, config.final_opponents, config.final_starts, config.final_duration),
    )


def draw_policies(config: ArchiveConfig, count: int, root: np.random.SeedSequence) -> Floats:
    """Draw random policies within their bounds by Latin hypercube sampling, shape (count, P).

    Fixed parameters are not drawn and have their values of the start.

    The mean strength of a set of opponents shifts the lead of every policy that races against them.
    It varies less between small Latin hypercube samples than between independent draws.
    """
    planner = get_planner(config.planner)
    varied = planner.indices(config.varied)
    low, high = planner.bounds[varied].T
    drawn = low + latin_hypercube(count, len(low), np.random.default_rng(root)) * (high - low)
    return planner.complete(config.varied, drawn, config.start_policy.parameters)


def _roots(config: ArchiveConfig) -> list[np.random.SeedSequence]:
    """Return the root seeds of all random parts of a synthesis.

    The parts are the three stages, the initial sample, the search and the champions.
    """
    return np.random.SeedSequence(config.seed).spawn(6)


def _number(root: np.random.SeedSequence) -> int:
    """Return a seed derived from a root, independent of the draws from the root itself."""
    # A child of the root, since other draws use the root itself.
    return signed_seed(root.spawn(1)[0])


def _check_folder(folder: Path) -> None:
    """Check that a folder with files holds a run of a synthesis: no other file is overwritten."""
    if folder.is_dir() and not (folder / "job").is_dir():
        others = sorted(entry.name for entry in folder.iterdir())
        if others:
            raise InputError(
                f"{folder} holds {others[0]} but no run of a synthesis; choose a new or an empty"
                " folder"
            )


@dataclass
class ArchiveRun:
    """Stages of a synthesis, whose races are tasks of one job, and the record of its search.

    Parameters of policies have the shape (K, P), fixed ones included.
    """

    config: ArchiveConfig
    job: Job
    executor: Executor | None
    callback: ArchiveCallback
    champions: list[str] = field(default_factory=list)  #: Policies found by tuning, as texts.
    min_score: float = 0.0  #: Min score against the rivals of a policy of the archive.
    #: Parameters and results of the initial sample and of each generation.
    searched: list[tuple[Floats, Evaluation]] = field(default_factory=list)
    history: list[ArchiveProgress] = field(default_factory=list)

    @property
    def scale(self) -> Scale:
        """Range of the initial sample, the unit of hypervolumes."""
        return Scale.of(self.searched[0][1].coordinates)

    @property
    def evaluations(self) -> int:
        """Number of policies raced in the search so far."""
        return sum(len(parameters) for parameters, _ in self.searched)

    def explored(self) -> tuple[Floats, Evaluation]:
        """Return parameters and results of all policies of the search, in race order."""
        parameters, results = zip(*self.searched, strict=True)
        return np.concatenate(parameters), Evaluation(
            *(np.concatenate(arrays) for arrays in zip(*results, strict=True))
        )

    def violation(self, evaluation: Evaluation) -> Floats:
        """Return by how much policies violate the limits of the search, shape (K,).

        Rates are per race; coordinates are in units of the initial sample's range.
        """
        beyond = evaluation.own_crash - self.config.search_crash_limit
        beyond = np.maximum(beyond, self.min_score - evaluation.score)
        if self.config.min_coordinates is None:
            return beyond
        shortfall = (np.array(self.config.min_coordinates) - evaluation.coordinates) / (
            self.scale.ideal - self.scale.nadir
        )
        return np.maximum(beyond, shortfall.max(axis=1))

    @property
    def strongest(self) -> Floats:
        """Parameters of the last champion, or of the start without champions, shape (P,)."""
        start = self.config.start_policy
        return (parse_policy(self.champions[-1]) if self.champions else start).parameters

    def find_champions(self) -> None:
        """Tune the planner again and again, each time also against the policies found before."""
        config, planner = self.config, get_planner(self.config.planner)

        def show(stage: str, done: int, total: int, state: TuningProgress | None) -> None:
            crash = state.own_crash if state else 0.0
            part = (len(self.champions) + done / total) / config.champions
            share = self._done("champions", part)
            self.callback(ArchiveProgress("champions", 0, 0, 0, 0.0, 0, crash, share))

        for number, root in enumerate(_roots(config)[5].spawn(config.champions), 1):
            tuning = config.tuning(self.champions, _number(root))
            run = TuningRun(tuning, self.job, self.executor, show, f"champion-{number}")
            self.champions.append(policy_text(planner, run.choose(run.search())))

    def search(self, scenarios: Scenarios) -> None:
        """Race the initial sample and generation after generation in the same scenarios.

        Each direction of the axes has a search of its own, which knows the initial sample.
        """
        config, planner = self.config, get_planner(self.config.planner)
        first, seed = _roots(config)[3:5]
        varied = planner.indices(config.varied)
        spread = config.selection == "spread"
        sample = draw_policies(config, config.initial_sample, first)
        if spread:
            # Halfway to the strongest policy: of policies drawn at random hardly any is strong.
            sample = 0.5 * (sample + self.strongest)
            sample[0] = self.strongest
        sampled = self._searched("initial-sample", scenarios, sample)
        if spread:
            self.min_score = float(sampled.score[0]) - config.margin
        violation = self.violation(sampled)
        for number, signs in enumerate(config.directions):
            search = Search(
                planner.bounds[varied],
                population=config.population,
                elite_ratio=config.elite_ratio,
                step_size=config.step_size,
                start=self.strongest[varied] if spread else None,
                seed=_number(seed),
            )
            search.add(sample[:, varied], signs * sampled.coordinates, violation)
            self._note_search(search)
            for generation in range(1, config.generations + 1):
                name = f"generation-{number * config.generations + generation:05d}"
                points = planner.complete(
                    config.varied, search.ask(), config.start_policy.parameters
                )
                found = self._searched(name, scenarios, points)
                search.tell(signs * found.coordinates, self.violation(found))
                self._note_search(search)

    def choose(self, scenarios: Scenarios) -> tuple[Floats, Notes]:
        """Choose among the policies of the search, by new races.

        Return the chosen policies, and the numbers of policies left out for each reason.
        """
        config = self.config
        theta, explored = self.explored()
        # Points evaluated several times race once.
        rows = np.sort(np.unique(theta, axis=0, return_index=True)[1])
        crashing = explored.own_crash > config.search_crash_limit
        allowed = rows[self.violation(explored)[rows] <= 0.0]
        if len(allowed) == 0:
            raise InputError(
                f"all {len(rows)} policies crash in more than {config.search_crash_limit:.0%} of"
                f" the races of {config.duration:g} s, lie below min_coordinates, or are weak;"
                " raise crash_limit or margin, or lower min_coordinates"
            )
        choose = self._choose_spread if config.selection == "spread" else self._choose_front
        chosen, notes = choose(allowed, scenarios)
        points = self.scale(explored.coordinates)
        return chosen, {
            "search_over_crash_limit": int(crashing.sum()),
            "search_hypervolume": hypervolume(points[rows[~crashing[rows]]]),
            "search_hypervolume_without_crash_limit": hypervolume(points[rows]),
            **notes,
        }

    def measure(self, parameters: Floats, scenarios: Scenarios) -> tuple[Floats, Arrays, Notes]:
        """Race policies in new scenarios, sort them by the first axis, and filter them.

        Policies that still crash too often or score too little are left out and, for a front, also
        policies that another policy clearly beats. Beaten policies add nothing to the front, so
        their removal makes the front look no better than it is. Return the remaining policies,
        their races, and the numbers of policies left out.
        """
        config = self.config
        front = config.selection == "pareto"
        within_limits = kept = np.zeros(0, np.int64)
        if len(parameters):
            raced = self._race("measurement", "measurement", scenarios, parameters)
            measured = summarise(raced)
            within_limits = kept = np.flatnonzero(
                (measured.own_crash <= config.crash_limit) & (measured.score >= self.min_score)
            )
            if front:
                kept = kept[~clearly_beaten(raced, kept, config.error_bars)]
            # Sorted from the most careful to the fastest policy.
            kept = kept[np.argsort(measured.coordinates[kept, 0], kind="stable")]
        minimum = 2 if front else 3
        if len(kept) < minimum:
            raise InputError(
                f"{len(kept)} policies remain below the crash limit of {config.crash_limit:.0%} and"
                f" within the margin; an archive needs {minimum} at least: raise crash_limit or"
                " margin, or search longer"
            )
        self._note("measurement", len(kept), measured)
        notes = {
            "measurement_outside_limits": len(parameters) - len(within_limits),
            "measurement_beaten": len(within_limits) - len(kept),
        }
        return parameters[kept], {key: values[kept] for key, values in raced.items()}, notes

    def _choose_front(self, allowed: Indices, scenarios: Scenarios) -> tuple[Floats, Notes]:
        """Race the best allowed policies in new scenarios; choose policies not clearly beaten."""
        config = self.config
        theta, explored = self.explored()
        points = _unit(explored.coordinates[allowed])
        order = allowed[spread_first(points, 0.5 * config.spacing, config.candidates)]
        raced = self._race("choice", "choice", scenarios, theta[order])
        measured = summarise(raced)
        within_limits = np.flatnonzero(self.violation(measured) <= 0.0)
        not_beaten = within_limits[~clearly_beaten(raced, within_limits, config.error_bars)]
        points = _unit(measured.coordinates[not_beaten])
        distinct = not_beaten[thin_out(points, config.spacing, config.max_policies)]
        self._note("choice", len(distinct), measured)
        return theta[order[distinct]], {
            "choice_candidates": len(order),
            "choice_outside_limits": len(order) - len(within_limits),
            "choice_beaten": len(within_limits) - len(not_beaten),
            "choice_too_near_another": len(not_beaten) - len(distinct),
        }

    def _choose_spread(self, allowed: Indices, scenarios: Scenarios) -> tuple[Floats, Notes]:
        """Race strong policies far apart in new scenarios; choose some that still are.

        The start and the last champion are always among them.
        """
        config = self.config
        theta, explored = self.explored()
        others = allowed[allowed != 0]
        rows = np.concatenate([[0], others])  # the first policy of the search is the strongest
        order = rows[spread_out(_unit(explored.coordinates[rows]), config.candidates)]
        known = np.unique([self.strongest, config.start_policy.parameters], axis=0)
        candidates = np.concatenate([known, theta[order[1:]]])
        raced = self._race("choice", "choice", scenarios, candidates)
        measured = summarise(raced)
        self.min_score = float(measured.score[: len(known)].max()) - config.margin
        within_limits = np.flatnonzero(self.violation(measured) <= 0.0)
        kept = np.unique(np.concatenate([np.arange(len(known)), within_limits]))
        points = _unit(measured.coordinates[kept])
        distinct = kept[spread_out(points, config.max_policies, len(known))]
        self._note("choice", len(distinct), measured)
        return candidates[distinct], {
            "choice_candidates": len(candidates),
            "choice_outside_limits": len(candidates) - len(within_limits),
            "choice_min_score": self.min_score,
        }

    def _searched(self, name: str, scenarios: Scenarios, parameters: Floats) -> Evaluation:
        """Race and record policies of the search."""
        evaluation = summarise(self._race("search", name, scenarios, parameters))
        self.searched.append((parameters, evaluation))
        return evaluation

    def _race(self, stage: str, name: str, scenarios: Scenarios, parameters: Floats) -> Arrays:
        """Race policies as tasks of this name, or load results of an earlier run."""
        # The search reports progress by generation, with the hypervolume, unknown to the tasks.
        progress = None if stage == "search" else self._progress(stage)
        blocks = range(0, len(parameters), BLOCK)
        tasks = [(scenarios, parameters[first : first + BLOCK]) for first in blocks]
        results = run_races(
            name, race_policies, tasks, job=self.job, executor=self.executor, progress=progress
        )
        return {key: np.concatenate([result[key] for result in results]) for key in results[0]}

    def _progress(self, stage: str) -> Progress:
        """Return a callback for the tasks of a stage."""

        def progress(done: int, total: int, _: str) -> None:
            share = self._done(stage, done / total)
            self.callback(self.history[-1]._replace(stage=stage, done=share))

        return progress

    def _note_search(self, search: Search) -> None:
        """Record a generation of the search, and call the callback."""
        progress = ArchiveProgress(
            stage="search",
            generation=search.generation,
            generations=self.config.generations,
            evaluations=self.evaluations,
            hypervolume=search.hypervolume,
            front=len(search.parameters),
            own_crash=float(self.searched[-1][1].own_crash.mean()),
            # A search may resume, so its progress is the number of policies raced.
            done=self._done("search", self.evaluations / self.config.evaluations),
        )
        self.history.append(progress)
        self.callback(progress)

    def _note(self, stage: str, front: int, evaluation: Evaluation) -> None:
        """Record the end of a later stage, and call the callback."""
        crash, done = float(evaluation.own_crash.mean()), self._done(stage, 1.0)
        progress = self.history[-1]._replace(stage=stage, front=front, own_crash=crash, done=done)
        self.history.append(progress)
        self.callback(progress)

    def _done(self, stage: str, share: float) -> float:
        """Return the share of all racing that is done after a share of a stage."""
        work = self.config.work
        earlier = list(work)[: list(work).index(stage)]
        return (sum(work[name] for name in earlier) + share * work[stage]) / sum(work.values())


def _unit(points: Floats) -> Floats:
    """Return points scaled by their own range."""
    if len(points) == 0:
        return points
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((points - low) / np.maximum(high - low, 1e-12), np.float64)
