"""Simulation of pairings as tasks (:mod:`pcs_racing_agents.jobs.jobs`): in parallel, resumable, reproducible.

Pairings with the same races against the same opponent are simulated together, since what their egos have in common must
be driven only once (:mod:`pcs_racing_agents.tournament.shared_driving`).
"""

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.track.track import Track, calibration_values
from pcs_racing_agents.agents.agent import Driver, competitor_hash
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.jobs.tasks import numbered_tasks, run_tasks
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.games import PlayedGames, join_played
from pcs_racing_agents.tournament.pairings import Pairing

BLOCK = 400  # races of one task: about a second of work


class RaceBlock(NamedTuple):
    """The races of one task."""

    content_hash: str  #: Hash of everything that their result depends on.
    group: int  #: Number of the group of pairings.
    first: int  #: ``first``, ``last``: The races of each pairing from ``first`` to before ``last``.
    last: int


@dataclass(frozen=True, eq=False)
class RaceWorker:
    """A function that simulates blocks of races; it is sent to other processes once, with games and competitors."""

    groups: Sequence[Sequence[Pairing]]  #: The pairings of a group differ in nothing but their egos.
    observations: bool  #: Whether to return observations.

    def __call__(self, block: RaceBlock) -> dict[str, NDArray[Any]]:
        """Race a block of a group, and return the columns of its table."""
        group = self.groups[block.group]
        races = group[0].take(np.arange(block.first, block.last))
        played = join_played(races.play_each([pairing.ego for pairing in group]))
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

    Pairings that differ in nothing but their egos are simulated together: what they have in common only once.

    Parameters
    ----------
    observations : bool
        Whether to return observations; else ``PlayedGames.observations`` has no columns.
    job : Job, optional
        Stores results; races with stored results are not simulated again. Results are then read from its chunks, so
        that memory does not grow with the number of races.
    progress : callable, optional
        Called as ``progress(done, total, name)``, counting races.
    """
    # With an executor its workers share the cores; without one a game uses all of them.
    games = {id(p.game): p.game if executor is None else replace(p.game, threads=1) for p in pairings}
    places = _groups(pairings)
    groups = [[replace(pairings[i], game=games[id(pairings[i].game)]) for i in group] for group in places]
    worker = RaceWorker(groups, observations)
    blocks = [block for i, g in enumerate(groups) for block in _blocks(i, g, observations, hashed=job is not None)]
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
    tasks: dict[int, list[int]] = {}
    for index, block in enumerate(blocks):
        tasks.setdefault(block.group, []).append(index)
    place = {i: (g, k) for g, group in enumerate(places) for k, i in enumerate(group)}
    in_memory, driven = -1, []  # a group, and the results of its tasks
    for i in range(len(pairings)):
        group, ego = place[i]
        if group != in_memory:
            in_memory = group
            driven = [results[k] if job is None else job.read(chunk_name, k) for k in tasks[group]]
        yield join_played([_played(arrays, ego, len(groups[group])) for arrays in driven])


def _played(arrays: Arrays, ego: int, egos: int) -> PlayedGames:
    """Results of one of the egos of a block of races, which follow each other."""
    races = len(arrays["lead"]) // egos
    own = {name: values[ego * races : (ego + 1) * races] for name, values in arrays.items()}
    return PlayedGames(**{"observations": np.zeros((races, 2, 0), np.float32), **own})


def _groups(pairings: Sequence[Pairing]) -> list[list[int]]:
    """Numbers of the pairings that differ in nothing but their egos, which are no drivers; the others are alone."""
    groups: dict[Any, list[int]] = {}
    for i, pairing in enumerate(pairings):
        draws = (pairing.variants, pairing.starts.s, pairing.starts.side, pairing.noise)
        same: Any = (id(pairing.game), id(pairing.opponent), *(array.tobytes() for array in draws))
        groups.setdefault(i if isinstance(pairing.ego, Driver) else same, []).append(i)
    return list(groups.values())


def _blocks(number: int, group: Sequence[Pairing], observations: bool, *, hashed: bool) -> Iterator[RaceBlock]:
    pairing, game = group[0], group[0].game
    common = ""
    if hashed:
        hashes = [competitor_hash(car) for car in (*(each.ego for each in group), pairing.opponent)]
        common = fingerprint(_track_hash(game.track), game.archive.content_hash, game.config, hashes, observations)
    size = max(1, BLOCK // len(group))
    for first in range(0, len(pairing), size):
        last = min(first + size, len(pairing))
        rows = slice(first, last)
        draws = (pairing.variants[rows], pairing.starts.s[rows], pairing.starts.side[rows], pairing.noise[rows])
        yield RaceBlock(fingerprint(common, draws) if hashed else "", number, first, last)


def _track_hash(track: Track) -> str:
    return fingerprint(
        track.content_hash, {preset: calibration_values(own) for preset, own in track.calibration.items()}
    )
