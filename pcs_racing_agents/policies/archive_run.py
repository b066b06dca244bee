"""Synthesis of an archive: search, choice and measurement of policies, as one resumable job.

1. **Search.** Random policies (the initial sample) set the scale. Then an optimiser proposes
   generation after generation, and every policy races in the same scenarios (Algorithm 1 of the
   paper).
2. **Choice.** The best evaluated policies race again, in other scenarios. Policies are left out if
   they crash too often, are clearly beaten by another policy, or nearly coincide with another
   policy. As an option, candidates race each other instead, and the choice is a pool with headroom
   (:mod:`pcs_racing_agents.policies.selection`).
3. **Measurement.** The remaining policies race once more in new scenarios. The coordinates come
   from these races alone, since the maximum of many noisy values is biased.
4. **Judgement**, only of a pool chosen for headroom: its headroom in new races.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.folders import clear_half_written
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.policies.archive_report import write_archive
from pcs_racing_agents.policies.archive_search import REFERENCE, ArchiveCallback, PolicyRaces
from pcs_racing_agents.policies.config import ArchiveConfig
from pcs_racing_agents.policies.evaluate import Scenarios, draw_scenarios, summarise
from pcs_racing_agents.policies.indicators import hypervolume
from pcs_racing_agents.policies.mo_cma_es import latin_hypercube
from pcs_racing_agents.policies.selection import (
    beaten,
    choose_for_headroom,
    difference_errors,
    judge_headroom,
    spread_first,
    thin_out,
)
from pcs_racing_agents.policies.synthesize import synthesize

Floats = NDArray[np.float64]
Notes = Mapping[str, str | float]


def make_archive(
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
        Called with the :class:`~pcs_racing_agents.policies.archive_search.ArchiveProgress` during
        the run.
    """
    folder = Path(folder)
    family = get_planner(config.planner)
    hashes = {
        name: load_track(name).content_hash
        for name in (*config.tracks, *(config.judging_tracks or ()))
    }
    # Drawn before the folder is made: an invalid option must not leave a folder behind.
    search, choice, final = stage_scenarios(config)
    first, optimiser, payoffs, judging = _roots(config)[3:]
    _check_folder(folder)
    settings = {**plain_settings(config), "rules": config.rules, "track_hashes": hashes}
    with open_job(folder / "job", "archive", settings) as job:
        clear_half_written(folder)
        races = PolicyRaces(config, job, executor, callback or (lambda _: None), search)
        varied = family.indices(config.varied)
        synthesize(
            races,
            family.bounds[varied],
            generations=config.generations,
            initial=draw_policies(family, config.initial_sample, first, config.fixed)[:, varied],
            evaluations=config.evaluations,
            callback=races.after_generation,
            population=config.population,
            elite_ratio=config.elite_ratio,
            loss=config.loss,
            mean=config.mean,
            seed=_number(optimiser),
            method=config.method,
            reference=REFERENCE,
            step_size=config.step_size,
        )
        candidates, notes = choose(races, choice, _number(payoffs))
        kept, raced, more = measure(races, candidates, final)
        if config.selection == "headroom":
            more = {**more, **judge_headroom(races, kept, _number(judging))}
        content = ", ".join(f"{name} {digest[:16]}" for name, digest in hashes.items())
        notes = {**notes, **more, "track_hashes": content}
        return write_archive(
            folder, config, races.explored(), races.scale, kept, raced, races.history, notes
        )


def stage_scenarios(config: ArchiveConfig) -> tuple[Scenarios, Scenarios, Scenarios]:
    """Return the scenarios of search, choice and measurement; no two stages share a race."""
    search, choice, final, *_ = _roots(config)

    def drawn(
        root: np.random.SeedSequence, opponents: int, starts: int, duration: float
    ) -> Scenarios:
        return draw_scenarios(
            config.tracks,
            config.rules_of(duration),
            draw_policies(get_planner(config.planner), opponents, root, config.fixed),
            config.axes,
            planner=config.planner,
            rivals=config.rivals,
            starts=starts,
            segment_seconds=config.segment_seconds,
            seed=_number(root),
        )

    return (
        drawn(search, config.opponents, config.starts, config.duration),
        drawn(choice, config.choice_opponents, config.choice_starts, config.duration),
        drawn(final, config.final_opponents, config.final_starts, config.final_duration),
    )


def _roots(config: ArchiveConfig) -> list[np.random.SeedSequence]:
    """Return the root seeds of all random parts of a synthesis.

    The parts are the three stages, the initial sample, the optimiser, and the payoffs in choice and
    judgement.
    """
    return np.random.SeedSequence(config.seed).spawn(7)


def draw_policies(
    family: Planner, count: int, root: np.random.SeedSequence, fixed: Sequence[str] = ()
) -> Floats:
    """Draw random policies within their bounds by Latin hypercube sampling, shape (count, P).

    Parameters in ``fixed`` are not drawn and have their defaults.

    The mean strength of a set of opponents shifts the lead of every policy that races against them.
    It varies less between small Latin hypercube samples than between independent draws.
    """
    varied = family.without(fixed)
    low, high = family.bounds[family.indices(varied)].T
    drawn = low + latin_hypercube(count, len(low), np.random.default_rng(root)) * (high - low)
    return family.complete(varied, drawn)


def _number(root: np.random.SeedSequence) -> int:
    """Return a seed derived from a root, independent of the draws from the root itself."""
    # A child of the root, since other draws use the root itself; 63 bits, since seeds are signed.
    return int(root.spawn(1)[0].generate_state(1, np.uint64)[0] >> np.uint64(1))


def _check_folder(folder: Path) -> None:
    """Check that a folder with files holds a run of a synthesis: no other file is overwritten."""
    if folder.is_dir() and not (folder / "job").is_dir():
        others = sorted(entry.name for entry in folder.iterdir())
        if others:
            raise InputError(
                f"{folder} holds {others[0]} but no run of a synthesis; choose a new or an empty"
                " folder"
            )


def choose(races: PolicyRaces, scenarios: Scenarios, seed: int) -> tuple[Floats, Notes]:
    """Choose among the policies of a search, by new races.

    Candidates for a front race again in ``scenarios``; ``seed`` is the root of the races between
    candidates for a pool with headroom. Return the parameters that vary, shape (K, P), and the
    numbers of policies left out for each reason.
    """
    config = races.config
    theta, explored = races.explored()
    # Points evaluated several times race once.
    rows = np.sort(np.unique(theta, axis=0, return_index=True)[1])
    crashing = explored.own_crash > config.search_crash_limit
    allowed = rows[races.violation(explored)[rows] <= 0.0]
    if len(allowed) == 0:
        raise InputError(
            f"all {len(rows)} policies crash in more than {config.search_crash_limit:.0%} of the"
            f" races of {config.duration:g} s, or lie below min_coordinates or min_score; raise"
            " crash_limit, or lower the others"
        )
    if config.selection == "headroom":
        parameters, notes = choose_for_headroom(races, allowed, seed)
    else:
        parameters, notes = _choose_front(races, allowed, scenarios)
    return parameters, {
        "search_over_crash_limit": int(crashing.sum()),
        "search_hypervolume": hypervolume(
            races.scale(explored.coordinates[rows[~crashing[rows]]]), REFERENCE
        ),
        "search_hypervolume_without_crash_limit": hypervolume(
            races.scale(explored.coordinates[rows]), REFERENCE
        ),
        **notes,
    }


def _choose_front(
    races: PolicyRaces, allowed: NDArray[np.int64], scenarios: Scenarios
) -> tuple[Floats, Notes]:
    """Race the best allowed policies in new scenarios, and choose policies not clearly beaten."""
    config = races.config
    theta, explored = races.explored()
    order = allowed[
        spread_first(_unit(explored.coordinates[allowed]), 0.5 * config.spacing, config.candidates)
    ]
    raced = races.race("choice", "choice", scenarios, theta[order])
    remeasured = summarise(raced)
    within_limits = np.flatnonzero(races.violation(remeasured) <= 0.0)
    not_beaten = within_limits[~_beaten(config, raced, within_limits)]
    distinct = not_beaten[
        thin_out(_unit(remeasured.coordinates[not_beaten]), config.spacing, config.max_policies)
    ]
    last = races.history[-1]
    races.note("choice", last.generation, last.hypervolume, len(distinct), remeasured)
    return theta[order[distinct]], {
        "choice_candidates": len(order),
        "choice_outside_limits": len(order) - len(within_limits),
        "choice_beaten": len(within_limits) - len(not_beaten),
        "choice_too_near_another": len(not_beaten) - len(distinct),
    }


def measure(
    races: PolicyRaces, parameters: Floats, scenarios: Scenarios
) -> tuple[Floats, Arrays, Notes]:
    """Race policies in new scenarios, sort them by the first axis, and filter them.

    Policies that still crash too often are left out and, for a front, also policies that another
    policy clearly beats. Beaten policies add nothing to the front, so their removal makes the front
    look no better than it is. Return the parameters of the remaining policies, shape (K, P), their
    races, and the numbers of policies left out.
    """
    limit = races.config.crash_limit
    within_limits = kept = np.zeros(0, np.int64)
    if len(parameters):
        raced = races.race("measurement", "measurement", scenarios, parameters)
        measured = summarise(raced)
        within_limits = np.flatnonzero(
            (measured.own_crash <= limit) & (measured.score >= races.config.min_score)
        )
        kept = within_limits
        if races.config.selection == "pareto":
            kept = within_limits[~_beaten(races.config, raced, within_limits)]
        # Sorted from the most careful to the fastest policy.
        kept = kept[np.argsort(measured.coordinates[kept, 0], kind="stable")]
    fewest = 2 if races.config.selection == "pareto" else 3
    if len(kept) < fewest:
        raise InputError(
            f"{len(kept)} policies remain below the crash limit of {limit:.0%} and above min_score;"
            f" an archive needs {fewest} at least: raise crash_limit, lower min_score, or search"
            " longer"
        )
    last = races.history[-1]
    races.note("measurement", last.generation, last.hypervolume, len(kept), measured)
    notes = {
        "measurement_over_crash_limit": len(parameters) - len(within_limits),
        "measurement_beaten": len(within_limits) - len(kept),
    }
    return parameters[kept], {key: values[kept] for key, values in raced.items()}, notes


def _beaten(config: ArchiveConfig, raced: Arrays, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which policies in ``rows`` are beaten within ``rows`` beyond the error bars."""
    subset = {key: values[rows] for key, values in raced.items()}
    return beaten(summarise(subset).coordinates, difference_errors(subset), config.error_bars)


def _unit(points: Floats) -> Floats:
    """Return points scaled by their own range."""
    if len(points) == 0:
        return points
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((points - low) / np.maximum(high - low, 1e-12), np.float64)
