"""Simulation of the nodes of a tree's level from the states of the level above, in chunks that threads share.

A thread drives its races from beginning to end. Threads that waited for each other whenever progress is noted, every
0.1 s, would gain much less.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import PLAN_EVERY
from pcs_racing.race.driving import default_threads
from pcs_racing.race.races import advance
from pcs_racing.race.state import RaceState, concatenate, empty_state, take

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

CHUNK = 64
"""Races that a thread drives at a time: about 30 ms of work, and 1.2 kB of state each."""


class RaceEnds(NamedTuple):
    """The ends of B races: those parts of a :class:`RaceState` that decide the payoff."""

    progress: Floats  #: shape (B, 2)
    crash: NDArray[np.int8]  #: shape (B, 2)
    fault: NDArray[np.int8]

    @classmethod
    def empty(cls, races: int) -> "RaceEnds":
        """Return arrays of zeros for so many races."""
        return cls(np.zeros((races, 2)), np.zeros((races, 2), np.int8), np.zeros((races, 2), np.int8))

    def write(self, rows: Indices | slice, ends: "RaceEnds") -> None:
        """Overwrite some races, in place."""
        self.progress[rows] = ends.progress
        self.crash[rows] = ends.crash
        self.fault[rows] = ends.fault

    def as_races(self) -> RaceState:
        """Return a state that holds these numbers, as :meth:`RaceGame.worth` wants it."""
        return empty_state(len(self.progress), 0)._replace(**self._asdict())


def _in_chunks(game: RaceGame, races: int, work: Callable[[slice], Any]) -> list[Any]:
    """Call a function for chunks of so many races, on the threads of the game, and return the answers in order."""
    chunks = [slice(first, first + CHUNK) for first in range(0, races, CHUNK)]
    threads = min(game.threads or default_threads(), len(chunks))
    if threads <= 1 or any(planner.drive is not None for planner in game.setup.planners):
        return [work(chunk) for chunk in chunks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, chunks))


def drive_children(game: RaceGame, parents: RaceState, rows: Indices, policies: Indices) -> tuple[RaceState, Floats]:
    """Simulate a step of the game: child ``i`` goes on from state ``rows[i]`` with the two ``policies[i]``.

    Returns
    -------
    races : RaceState
        B races, a step later.
    estimates : ndarray, shape (B, 2, G)
        What was measured in that step (:meth:`RaceGame.drive`).
    """
    single = replace(game, threads=1)

    def drive(chunk: slice) -> tuple[RaceState, Floats]:
        races = take(parents, rows[chunk])
        return races, single.drive(races, policies[chunk])

    none = take(parents, rows[:0]), np.zeros((0, 2, len(game.characteristics)))
    races, estimates = zip(none, *_in_chunks(game, len(rows), drive), strict=True)
    return concatenate(list(races)), np.concatenate(estimates)


def drive_to_the_end(
    game: RaceGame, parents: RaceState, rows: Indices, policies: Indices, *, trace: bool = False
) -> tuple[RaceEnds, NDArray[np.float32]]:
    """Simulate the last step of the game, in which no characteristics are measured, as :func:`drive_children` does.

    Returns
    -------
    ends : RaceEnds
    trace : ndarray, shape (B, T, 2), float32
        Progress of each car whenever the drivers plan (every 0.1 s), the step's first and last moment included;
        ``T = 0`` without ``trace``.
    """
    ticks = int(np.diff(game.config.end_ticks)[-1])
    moments = ticks // PLAN_EVERY + 1 if trace else 0
    ends = RaceEnds.empty(len(rows))
    traces = np.zeros((len(rows), moments, 2), np.float32)

    def drive(chunk: slice) -> None:
        races, theta = take(parents, rows[chunk]), game.theta(policies[chunk])
        if trace:
            traces[chunk, 0] = races.progress
            for moment in range(1, moments):
                advance(game.setup, races, theta, PLAN_EVERY, threads=1, ittc=False)
                traces[chunk, moment] = races.progress
        else:
            advance(game.setup, races, theta, ticks, threads=1, ittc=False)
        ends.write(chunk, RaceEnds(races.progress, races.crash, races.fault))

    _in_chunks(game, len(rows), drive)
    return ends, traces
