"""Many matches as tasks, anywhere (:mod:`pcs_racing_agents.jobs.jobs`), resumable, with the same result everywhere."""

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import RaceGame
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track, calibration_values, load_track
from pcs_racing_agents.agents.agent import Competitor, competitor_hash
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import Arrays, Job, Progress
from pcs_racing_agents.jobs.tasks import in_other_processes
from pcs_racing_agents.tournament.matches import Matches, join_matches, play_games

__all__ = ["Pairing", "each_pairing", "play_pairings"]

BLOCK = 400  # games of one task: one to two seconds of work


class Pairing(NamedTuple):
    """Games between two competitors on one track.

    Attributes
    ----------
    track : Track
    ego, opponent : Competitor
    policies : ndarray, shape (B, 2), int64
        Variants of both.
    starts : Starts
    seeds : ndarray, shape (B,), uint64
    """

    track: Track
    ego: Competitor
    opponent: Competitor
    policies: NDArray[np.int64]
    starts: Starts
    seeds: NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class _Task:
    """A piece of a pairing, as it travels to a worker; the digest is of all that its result depends on."""

    content_hash: str
    track: Track | Path
    track_hash: str
    archive: PolicyArchive
    config: GameConfig
    threads: int | None
    ego: Competitor
    opponent: Competitor
    policies: NDArray[np.int64]
    starts: Starts
    seeds: NDArray[np.uint64]


def play_pairings(
    pairings: Sequence[Pairing],
    archive: PolicyArchive,
    config: GameConfig,
    *,
    name: str = "races",
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[Matches]:
    """Play all games of several pairings.

    Parameters
    ----------
    pairings : sequence of Pairing
    archive : PolicyArchive
    config : GameConfig
    name : str
        Of this part of the job's work.
    job : Job, optional
        Where results are kept; with it, games that were played before are not played again.
    executor : Executor, optional
        Where the games are played; by default here, on all cores.
    progress : callable, optional
        Told the number of games.

    Returns
    -------
    list of Matches
        In the order of the pairings; without what was seen (``seen`` has no columns).
    """
    return list(each_pairing(pairings, archive, config, name=name, job=job, executor=executor, progress=progress))


def each_pairing(
    pairings: Sequence[Pairing],
    archive: PolicyArchive,
    config: GameConfig,
    *,
    name: str = "races",
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[Matches]:
    """Play all games of several pairings as :func:`play_pairings`, and yield what came of them pairing by pairing.

    With a job, all of them are played first and then read from its chunks: memory does not grow with the games.
    """
    tasks, owner = [], []
    for i, pairing in enumerate(pairings):
        for first in range(0, len(pairing.seeds), BLOCK):
            rows = np.arange(first, min(first + BLOCK, len(pairing.seeds)))
            tasks.append(_task(pairing, rows, archive, config, executor, kept=job is not None))
            owner.append(i)
    total = sum(len(task.seeds) for task in tasks)
    tell = _count_games(progress, total)
    found = _from_job(job, name, tasks, executor, tell) if job is not None else _from_here(name, tasks, executor, tell)
    for _, group in groupby(zip(owner, found, strict=True), key=itemgetter(0)):
        parts = [Matches(**arrays, seen=np.zeros((len(arrays["lead"]), 2, 0), np.float32)) for _, arrays in group]
        yield join_matches(parts)


def _from_job(job: Job, name: str, tasks: list[_Task], executor: Executor | None, tell: Progress) -> Iterator[Arrays]:
    part = _plain_name(name)
    job.run(part, _play, tasks, executor=executor, progress=tell, keep=False)
    return (job.read(part, index) for index in range(len(tasks)))


def _from_here(name: str, tasks: list[_Task], executor: Executor | None, tell: Progress) -> Iterator[Arrays]:
    tell(0, len(tasks), name)
    for done, arrays in enumerate(executor.map(_play, tasks) if executor is not None else map(_play, tasks), start=1):
        tell(done, len(tasks), name)
        yield arrays


def _task(
    pairing: Pairing,
    rows: NDArray[np.intp],
    archive: PolicyArchive,
    config: GameConfig,
    executor: Executor | None,
    *,
    kept: bool,
) -> _Task:
    track, starts = pairing.track, pairing.starts.take(rows)
    policies, seeds = pairing.policies[rows], pairing.seeds[rows]
    # Other processes read the map again (from a cache): its arrays are too many to send along with every task.
    elsewhere = in_other_processes(executor) is not None
    return _Task(
        content_hash=fingerprint(
            _track_hash(track),
            archive.content_hash,
            config,
            [competitor_hash(one) if kept else "" for one in (pairing.ego, pairing.opponent)],
            (policies, starts.s, starts.side, seeds),
        ),
        track=track.folder if elsewhere and track.folder is not None else track,
        track_hash=_track_hash(track),
        archive=archive,
        config=config,
        threads=None if executor is None else 1,
        ego=pairing.ego,
        opponent=pairing.opponent,
        policies=policies,
        starts=starts,
        seeds=seeds,
    )


def _track_hash(track: Track) -> str:
    return fingerprint(
        track.content_hash, {preset: calibration_values(own) for preset, own in track.calibration.items()}
    )


def _play(task: _Task) -> dict[str, NDArray[Any]]:
    track = task.track if isinstance(task.track, Track) else load_track(task.track)
    if _track_hash(track) != task.track_hash:
        raise InputError(f"the map in {task.track} has changed while races were driven on it; start again")
    game = RaceGame(track, task.archive, task.config, threads=task.threads)
    played = play_games(game, task.ego, task.opponent, policies=task.policies, starts=task.starts, seeds=task.seeds)
    return {key: value for key, value in played._asdict().items() if key != "seen"}


def _count_games(progress: Progress | None, total: int) -> Progress:
    """Tell of games instead of tasks."""

    def tell(done: int, tasks: int, what: str) -> None:
        if progress is not None:
            progress(round(total * done / tasks) if tasks else 0, total, what)

    return tell


def _plain_name(name: str) -> str:
    """A name as jobs want it: small letters, digits and hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:80] or "races"
