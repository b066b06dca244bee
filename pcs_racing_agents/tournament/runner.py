"""Simulation of pairings as tasks (:mod:`pcs_racing_agents.jobs.jobs`): in parallel, resumable, reproducible."""

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.track.track import Track, calibration_values
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import Job, Progress
from pcs_racing_agents.jobs.tasks import numbered_tasks, run_tasks
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.games import PlayedGames, join_played
from pcs_racing_agents.tournament.pairings import Pairing

__all__ = ["play_pairing", "play_pairings"]

BLOCK = 400  # races of one task: one to two seconds of work


class RaceBlock(NamedTuple):
    """The races of one task.

    Attributes
    ----------
    content_hash : str
        Hash of everything that their result depends on.
    pairing : int
        Number of the pairing.
    first, last : int
        The races from ``first`` to before ``last``.
    """

    content_hash: str
    pairing: int
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class RaceWorker:
    """A function that simulates blocks of races; it is sent to other processes once, with games and competitors.

    Attributes
    ----------
    pairings : sequence of Pairing
    observations : bool
        Whether to return observations.
    """

    pairings: Sequence[Pairing]
    observations: bool

    def __call__(self, block: RaceBlock) -> dict[str, NDArray[Any]]:
        played = self.pairings[block.pairing].take(np.arange(block.first, block.last)).play()
        return {key: value for key, value in played._asdict().items() if self.observations or key != "observations"}


def play_pairing(
    pairing: Pairing, *, job: Job | None = None, executor: Executor | None = None, progress: Progress | None = None
) -> RaceTable:
    """Simulate the races of a pairing; options as for :func:`play_pairings`."""
    name = "-".join((pairing.game.track.name, *pairing.names))
    (games,) = play_pairings([pairing], name=name, job=job, executor=executor, progress=progress)
    return pairing.table(games)


def play_pairings(
    pairings: Sequence[Pairing],
    *,
    name: str = "races",
    observations: bool = False,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[PlayedGames]:
    """Simulate the races of several pairings in parallel, and yield the results pairing by pairing.

    Parameters
    ----------
    pairings : sequence of Pairing
    name : str
        Name of this part of the job's work.
    observations : bool
        Whether to return observations; else ``PlayedGames.observations`` has no columns.
    job : Job, optional
        Stores results; races with stored results are not simulated again. Results are then read from its chunks, so
        that memory does not grow with the number of races.
    executor : Executor, optional
        Simulates the races; by default this process, on all cores. It does not change the result.
    progress : callable, optional
        Called as ``progress(done, total, name)``, counting races.
    """
    # With an executor its workers share the cores; without one a game uses all of them.
    games = {id(p.game): p.game if executor is None else replace(p.game, threads=1) for p in pairings}
    worker = RaceWorker([replace(p, game=games[id(p.game)]) for p in pairings], observations)
    stored = job is not None
    blocks = [block for i, p in enumerate(pairings) for block in _blocks(i, p, observations, hashed=stored)]
    total = sum(len(pairing) for pairing in pairings)

    def report(done: int, tasks: int, label: str) -> None:
        if progress is not None:
            progress(round(total * done / tasks) if tasks else 0, total, label)

    results: dict[int, Arrays] = {}
    chunk_name = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:80] or "races"  # a name as jobs want it
    if job is not None:
        job.run(chunk_name, worker, blocks, executor=executor, progress=report, keep=False)
    else:
        report(0, len(blocks), name)
        for index, arrays in run_tasks(numbered_tasks(worker, blocks), executor, name):
            results[index] = arrays
            report(len(results), len(blocks), name)
    index = 0
    for pairing in pairings:
        parts = []
        for _ in range(0, len(pairing), BLOCK):
            arrays = results.pop(index) if job is None else job.read(chunk_name, index)
            parts.append(PlayedGames(**{"observations": np.zeros((len(arrays["lead"]), 2, 0), np.float32), **arrays}))
            index += 1
        yield join_played(parts)


def _blocks(number: int, pairing: Pairing, observations: bool, *, hashed: bool) -> Iterator[RaceBlock]:
    game = pairing.game
    hashes = [competitor_hash(car) if hashed else "" for car in (pairing.ego, pairing.opponent)]
    identity = (_track_hash(game.track), game.archive.content_hash, game.config, hashes, observations)
    common = fingerprint(*identity) if hashed else ""
    for first in range(0, len(pairing), BLOCK):
        last = min(first + BLOCK, len(pairing))
        rows = slice(first, last)
        draws = (pairing.variants[rows], pairing.starts.s[rows], pairing.starts.side[rows], pairing.noise[rows])
        yield RaceBlock(fingerprint(common, draws) if hashed else "", number, first, last)


def _track_hash(track: Track) -> str:
    return fingerprint(
        track.content_hash, {preset: calibration_values(own) for preset, own in track.calibration.items()}
    )
