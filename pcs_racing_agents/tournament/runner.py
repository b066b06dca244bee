"""Pairings driven as tasks (:mod:`pcs_racing_agents.jobs.jobs`): anywhere, resumable, with the same results."""

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
from pcs_racing_agents.tournament.matches import Matches, join_matches
from pcs_racing_agents.tournament.pairings import Pairing

__all__ = ["play_pairing", "play_pairings"]

BLOCK = 400  # races of one task: one to two seconds of work


class RaceBlock(NamedTuple):
    """Races of a pairing that are driven together.

    Attributes
    ----------
    content_hash : str
        Of all that their result depends on.
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
    """Drives blocks of races; it travels to other processes once, with the games and the competitors.

    Attributes
    ----------
    pairings : sequence of Pairing
    observations : bool
        Whether to keep what was observed.
    """

    pairings: Sequence[Pairing]
    observations: bool

    def __call__(self, block: RaceBlock) -> dict[str, NDArray[Any]]:
        played = self.pairings[block.pairing].take(np.arange(block.first, block.last)).play()
        return {key: value for key, value in played._asdict().items() if self.observations or key != "seen"}


def play_pairing(
    pairing: Pairing, *, job: Job | None = None, executor: Executor | None = None, progress: Progress | None = None
) -> RaceTable:
    """Drive the races of a pairing; options as for :func:`play_pairings`."""
    name = "-".join((pairing.game.track.name, *pairing.names))
    (matches,) = play_pairings([pairing], name=name, job=job, executor=executor, progress=progress)
    return pairing.table(matches)


def play_pairings(
    pairings: Sequence[Pairing],
    *,
    name: str = "races",
    observations: bool = False,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[Matches]:
    """Drive the races of several pairings side by side, and yield what came of them pairing by pairing.

    Parameters
    ----------
    pairings : sequence of Pairing
    name : str
        Of this part of the job's work.
    observations : bool
        Whether to return what was observed; else ``seen`` has no columns.
    job : Job, optional
        Where results are kept: races that were driven before are not driven again. All of them are driven first and
        then read from its chunks, so that memory does not grow with them.
    executor : Executor, optional
        Where the races are driven; by default here, on all cores. It does not change the result.
    progress : callable, optional
        Called as ``progress(done, total, name)``, counting races.
    """
    # Workers share the cores; alone in this thread a game takes all of them.
    games = {id(p.game): p.game if executor is None else replace(p.game, threads=1) for p in pairings}
    worker = RaceWorker([replace(p, game=games[id(p.game)]) for p in pairings], observations)
    blocks = [
        block for i, pairing in enumerate(pairings) for block in _blocks(i, pairing, observations, kept=job is not None)
    ]
    total = sum(len(pairing) for pairing in pairings)

    def tell(done: int, tasks: int, what: str) -> None:
        if progress is not None:
            progress(round(total * done / tasks) if tasks else 0, total, what)

    results: dict[int, Arrays] = {}
    kept = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:80] or "races"  # a name as jobs want it
    if job is not None:
        job.run(kept, worker, blocks, executor=executor, progress=tell, keep=False)
    else:
        tell(0, len(blocks), name)
        for index, arrays in run_tasks(numbered_tasks(worker, blocks), executor, name):
            results[index] = arrays
            tell(len(results), len(blocks), name)
    index = 0
    for pairing in pairings:
        parts = []
        for _ in range(0, len(pairing), BLOCK):
            arrays = results.pop(index) if job is None else job.read(kept, index)
            parts.append(Matches(**{"seen": np.zeros((len(arrays["lead"]), 2, 0), np.float32), **arrays}))
            index += 1
        yield join_matches(parts)


def _blocks(number: int, pairing: Pairing, observations: bool, *, kept: bool) -> Iterator[RaceBlock]:
    game = pairing.game
    who = [competitor_hash(car) if kept else "" for car in (pairing.ego, pairing.opponent)]
    what = (
        fingerprint(_track_hash(game.track), game.archive.content_hash, game.config, who, observations) if kept else ""
    )
    for first in range(0, len(pairing), BLOCK):
        last = min(first + BLOCK, len(pairing))
        rows = slice(first, last)
        drawn = (pairing.variants[rows], pairing.starts.s[rows], pairing.starts.side[rows], pairing.noise[rows])
        yield RaceBlock(fingerprint(what, drawn) if kept else "", number, first, last)


def _track_hash(track: Track) -> str:
    return fingerprint(
        track.content_hash, {preset: calibration_values(own) for preset, own in track.calibration.items()}
    )
