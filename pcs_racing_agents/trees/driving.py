"""Simulation of a level of a tree from the states of the level above, in chunks for threads.

A thread drives its races from beginning to end. Threads that waited for each other at every sample
of progress, every 0.1 s, would gain much less.

The last step of games with the cars out of each other's sight is driven only once for each car
(:func:`finish`). A planner with a limited ``sight`` (:class:`pcs_racing.Planner`) drives the
same for any event beyond it. Once the cars are that far apart, ``n`` policies of one car and ``n``
policies of the other make ``n * n`` races, but only ``2 n`` different drives: ``n`` races show all
drives. The other races are combined from these drives, if the cars would not have come near each
other and neither crashed; otherwise they are driven, too. The result is the same to the last bit,
with steering noise as well: the noise depends only on the race's seed, the car and the time.

This holds for progress and crashes, which the end of a game counts. The minimum time to collision
depends on the other car at any distance, so steps with a measurement of it are driven one by one.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.typing import Floats, Indices
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import PLAN_EVERY
from pcs_racing.race.driving import advance, default_threads
from pcs_racing.race.state import RaceState, concatenate, empty_state, take

CHUNK = 64
"""Races that a thread drives at a time: about 30 ms of work, and 1.2 kB of state per race."""

MARGIN = 2.0
"""Distance beyond the sight, m: more than the gap can change in the 0.1 s between two checks."""

UNKNOWN, CRASHES = -1, -2
"""Marks of a drive in place of the row where it is known."""


class _RaceEnds(NamedTuple):
    """Ends of B races: the parts of a :class:`RaceState` that decide the payoff."""

    progress: Floats  #: shape (B, 2)
    crash: NDArray[np.int8]  #: shape (B, 2)
    fault: NDArray[np.int8]

    @classmethod
    def empty(cls, races: int) -> "_RaceEnds":
        """Return arrays of zeros for ``races`` races."""
        return cls(
            np.zeros((races, 2)), np.zeros((races, 2), np.int8), np.zeros((races, 2), np.int8)
        )

    def write(self, rows: Indices | slice, ends: "_RaceEnds") -> None:
        """Overwrite some races, in place."""
        self.progress[rows] = ends.progress
        self.crash[rows] = ends.crash
        self.fault[rows] = ends.fault

    def as_races(self) -> RaceState:
        """Return a state with these numbers, for :func:`pcs_racing.game.reward.reward`."""
        return empty_state(len(self.progress), 0)._replace(**self._asdict())


def _in_chunks(game: RaceGame, races: int, work: Callable[[slice], Any]) -> list[Any]:
    """Call a function for each chunk of races, on the game's threads; return results in order."""
    chunks = [slice(first, first + CHUNK) for first in range(0, races, CHUNK)]
    threads = min(game.threads or default_threads(), len(chunks))
    if threads <= 1 or any(planner.drive is not None for planner in game.setup.planners):
        return [work(chunk) for chunk in chunks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, chunks))


def drive_children(
    game: RaceGame, parents: RaceState, rows: Indices, policies: Indices
) -> tuple[RaceState, Floats]:
    """Simulate a step of the game: child ``i`` continues state ``rows[i]`` with ``policies[i]``.

    Returns
    -------
    races : RaceState
        B races, one step later.
    estimates : ndarray, shape (B, 2, G)
        Measurements of that step (:meth:`RaceGame.drive`).
    """
    single = replace(game, threads=1)

    def drive(chunk: slice) -> tuple[RaceState, Floats]:
        races = take(parents, rows[chunk])
        return races, single.drive(races, game.theta(policies[chunk]))

    none = take(parents, rows[:0]), np.zeros((0, 2, len(game.characteristics)))
    races, estimates = zip(none, *_in_chunks(game, len(rows), drive), strict=True)
    return concatenate(list(races)), np.concatenate(estimates)


def drive_to_the_end(
    game: RaceGame, parents: RaceState, rows: Indices, policies: Indices, *, trace: bool = False
) -> tuple[_RaceEnds, NDArray[np.float32]]:
    """Simulate the last step of the game like :func:`drive_children`, without characteristics.

    Returns
    -------
    ends : _RaceEnds
    trace : ndarray, shape (B, T, 2), float32
        Progress of each car at every plan (every 0.1 s), including the first and the last moment of
        the step; ``T = 0`` without ``trace``.
    """
    ticks = int(np.diff(game.rules.end_ticks)[-1])
    moments = ticks // PLAN_EVERY + 1 if trace else 0
    ends = _RaceEnds.empty(len(rows))
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
        ends.write(chunk, _RaceEnds(races.progress, races.crash, races.fault))

    _in_chunks(game, len(rows), drive)
    return ends, traces


def finish(
    game: RaceGame, parents: RaceState, rows: Indices, policies: Indices, *, share: bool = True
) -> tuple[_RaceEnds, int]:
    """Return the ends of the last step of the game, and the number of races driven for them.

    ``parents``, ``rows``, ``policies``: as for
    :func:`pcs_racing_agents.trees.driving.drive_children`. ``share``: whether to combine races from
    single drives where that is possible; it does not change the result.
    """
    ends = _RaceEnds.empty(len(rows))
    apart = _out_of_sight(game, parents.lead) if share else np.zeros(parents.races, np.bool_)
    rest, count = np.flatnonzero(~apart[rows]), 0
    if apart.any():
        far = np.flatnonzero(apart[rows])
        remaining, count = _combine(game, parents, rows, policies, far, ends)
        rest = np.concatenate([rest, remaining])
    ends.write(rest, drive_to_the_end(game, parents, rows[rest], policies[rest])[0])
    return ends, count + len(rest)


def _combine(
    game: RaceGame,
    parents: RaceState,
    rows: Indices,
    policies: Indices,
    far: Indices,
    ends: _RaceEnds,
) -> tuple[Indices, int]:
    """Write the ends of the races ``far``, whose cars start out of sight, as far as possible.

    Returns the races that must be driven themselves, and the number of races driven here.
    """
    drives = _different_drives(parents, rows[far], policies[far])
    # Row of each drive in ``progress`` and ``traces``, if it is known.
    source = np.full((2, drives.max(initial=-1) + 1), UNKNOWN)
    progress = np.zeros((0, 2))
    traces = np.zeros((0, int(np.diff(game.rules.end_ticks)[-1]) // PLAN_EVERY + 1, 2), np.float32)
    waiting = np.arange(len(far))
    rest = [far[:0]]
    # If a crash hides the drive of the other car, or the cars came near each other, another race
    # is driven for the unknown drives.
    while len(batch := waiting[cover_drives(drives[:, waiting], source == UNKNOWN)]):
        driven, trace = drive_to_the_end(
            game, parents, rows[far[batch]], policies[far[batch]], trace=True
        )
        ends.write(far[batch], driven)
        apart = _out_of_sight(game, trace[:, :, 0] - trace[:, :, 1]).all(axis=1)
        complete = apart & ~driven.crash.any(axis=1)
        for car in range(2):
            source[car, drives[car, batch[apart & (driven.crash[:, car] != 0)]]] = CRASHES
            source[car, drives[car, batch[complete]]] = len(traces) + np.flatnonzero(complete)
        progress = np.concatenate([progress, driven.progress])
        traces = np.concatenate([traces, trace])
        waiting = np.setdiff1d(waiting, batch, assume_unique=True)
        crashing = (source[[[0], [1]], drives[:, waiting]] == CRASHES).any(axis=0)
        rest.append(far[waiting[crashing]])
        waiting = waiting[~crashing]
    for first in range(0, len(waiting), 4096):  # bounded memory
        block = waiting[first : first + 4096]
        from0, from1 = (source[car, drives[car, block]] for car in range(2))
        ends.progress[far[block]] = np.stack([progress[from0, 0], progress[from1, 1]], axis=1)
        # Neither car crashes in its known drive: together they would not crash, either, unless they
        # come near each other.
        apart = _out_of_sight(game, traces[from0, :, 0] - traces[from1, :, 1]).all(axis=1)
        rest.append(far[block[~apart]])
    return np.concatenate(rest), len(traces)


def _out_of_sight(game: RaceGame, lead: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return whether cars are out of each other's sight: the shorter way round the track counts."""
    sight = max(planner.sight for planner in game.setup.planners) + MARGIN
    ahead = np.mod(lead, game.track.length)
    return np.asarray(np.minimum(ahead, game.track.length - ahead) > sight)


def _different_drives(parents: RaceState, rows: Indices, policies: Indices) -> Indices:
    """Number each car's drives, shape (2, B); equal numbers: same car, state and policy."""
    numbers = np.zeros((2, len(rows)), np.int64)
    used, which = np.unique(rows, return_inverse=True)
    for car in range(2):
        own = (
            *(parents.cars, parents.frenet, parents.progress, parents.command),
            *(parents.disturbance, parents.path, parents.memory),
        )
        columns = [array[used, car].reshape(len(used), -1).view(np.int64) for array in own]
        shared = [parents.tick[used, None], parents.seed[used, None].view(np.int64)]
        table = np.concatenate([*columns, *shared], axis=1)
        same = np.unique(table, axis=0, return_inverse=True)[1].reshape(-1)
        keys = np.stack([same[which], policies[:, car]], axis=1)
        numbers[car] = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    return numbers


def cover_drives(drives: Indices, unknown: NDArray[np.bool_]) -> Indices:
    """Select a few races that show every unknown drive: first races with two of them, then one.

    ``drives``, shape (2, B), are the drives of each race; ``unknown``, shape (2, D), is true for
    drives to show.
    """
    missing = unknown.tolist()
    selected = []
    for needed in (2, 1):
        for race, pair in enumerate(drives.T.tolist()):
            if missing[0][pair[0]] + missing[1][pair[1]] >= needed:
                missing[0][pair[0]] = missing[1][pair[1]] = False
                selected.append(race)
    return np.array(sorted(selected), np.int64)
