"""State of a batch of races as a plain value: copy it, pickle it, select races from it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.planners.view import PATH_COLUMNS, PATH_POINTS

SUMS: dict[str, str] = {
    "ITTC": "sum of the minimum time to collision over its samples, s",
    "ITTC_SAMPLES": "number of those samples (20 per second)",
    "STEERING": "total movement of the steering, rad",
    "BLOCKING": "time spent ahead of the opponent, within 3 m, and in its way, s",
    "LATERAL": "integral of the squared lateral acceleration, m^2/s^3",
    "TIME": "time driven, s",
    "PROFILE": "time of the profile of pace 1 for the driven way along the race line, s",
    "TIME_BEHIND": "time driven while another car led, s",
    "PROFILE_BEHIND": "increase of PROFILE while another car led, s",
}
"""Running sums of each car, by name; characteristics are made of differences of these sums."""

ITTC, ITTC_SAMPLES, STEERING, BLOCKING, LATERAL, TIME, PROFILE, TIME_BEHIND, PROFILE_BEHIND = range(
    len(SUMS)
)

# Columns of ``laps``: complete laps; end time of the last lap, s; duration of the last lap and of
# the shortest lap, s. In a race with laps a column for the duration of each of its laps follows.
LAPS, ENDED_AT, LAP_TIME, BEST_LAP = range(4)
LAP_COLUMNS = 4

NO_LAP = -1.0
"""Value in place of a missing lap time."""

NO_CRASH, WALL_CRASH, CAR_CRASH = range(3)

MAX_CARS = 8

MODES = ("rgb_array", "human")
"""Modes of pictures of a race: arrays, or a window."""


def views(cars: int) -> tuple[str, ...]:
    """Return the possible views of a race of ``cars`` cars."""
    return ("track", "both", *(f"car_{car}" for car in range(max(2, cars))))


class RaceState(NamedTuple):
    """State of a batch of B races of N cars at one moment: plain arrays, race axis first.

    The state is complete: two races with equal states, policies and rules continue identically to
    the last bit.
    """

    tick: NDArray[np.int64]  #: shape (B,): Simulation steps of 0.01 s driven so far.
    #: shape (B,): Key of each race's own noise. The noise is a function of (seed, car, tick), so
    #: there is no generator state.
    seed: NDArray[np.uint64]
    cars: NDArray[np.float64]  #: shape (B, N, 7): Vehicle states (:mod:`pcs_racing.car.vehicle`).
    #: shape (B, N, 2): Arc length in [0, length) and distance from the race line, m.
    frenet: NDArray[np.float64]
    #: shape (B, N): Cumulative arc length since the start line, m; a lap adds the length of the
    #: track.
    progress: NDArray[np.float64]
    #: shape (B, N, 2): Target steering angle (rad) and speed (m/s) in force, the noise included.
    command: NDArray[np.float64]
    disturbance: NDArray[np.float64]  #: shape (B, N): AR(1) steering disturbance, rad.
    #: shape (B, N, 12, 4): Path that each car follows: x, y (m), speed (m/s), curvature (1/m).
    path: NDArray[np.float64]
    memory: NDArray[np.float64]  #: shape (B, N, M): Memory of the planners.
    sums: NDArray[np.float64]  #: shape (B, N, 9): Running sums (:data:`SUMS`).
    #: shape (B, N): Crash code: 0 none, 1 into a wall, 2 with another car; latched, and the race
    #: stands still afterwards.
    crash: NDArray[np.int8]
    #: shape (B, N): Number of faults of each car: 1 for a crash that ends the race; if contacts do
    #: not end the race, at most 127.
    fault: NDArray[np.int8]
    #: shape (B,): Car that last led all other cars by more than a car's length (-1 for none yet).
    leader: NDArray[np.int8]
    overtakes: NDArray[np.int64]  #: shape (B, N): Number of overtakes of each car.
    #: shape (B, N, 4 + L): Numbers behind :attr:`lap_count`, :attr:`lap_time`, :attr:`best_lap` and
    #: :attr:`lap_times`. The first car to drive L laps ends the race; 0 for a race by time.
    laps: NDArray[np.float64]
    #: shape (B, N): Bits of each car: bit k is set if the last gap of more than a car's length to
    #: car k was a lead.
    ahead: NDArray[np.uint8]
    #: shape (B, N): Last contact of each car, coded as ``crash``, if contacts do not end the race;
    #: 0 once the car drives faster than 1 m/s again.
    contact: NDArray[np.int8]
    #: shape (B, N): Share of its commanded speed that each car lacks (``front_pace`` of the rules).
    handicap: NDArray[np.float64]

    @property
    def races(self) -> int:
        """Number of races in the batch."""
        return len(self.tick)

    @property
    def number(self) -> int:
        """Number of cars in each race, N: 1 to 8."""
        return self.progress.shape[1]

    @property
    def lead(self) -> NDArray[np.float64]:
        """Lead of car 0 over the best other car, m, shape (B,); 0 if alone."""
        rivals = self.progress[:, 1:] if self.number > 1 else self.progress
        return np.asarray(self.progress[:, 0] - rivals.max(axis=1))

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """True if the race ended in a crash, shape (B,)."""
        return np.asarray(self.crash.any(axis=1))  # NO_CRASH is 0

    @property
    def finish_time(self) -> NDArray[np.float64]:
        """End time of each car's last lap of the race, s, shape (B, N); infinite for a car that did
        not end it, and in a race by time.
        """
        wanted = self.laps.shape[2] - LAP_COLUMNS
        done = (self.laps[..., LAPS] >= wanted) & (wanted > 0)
        return np.where(done, self.laps[..., ENDED_AT], np.inf)

    @property
    def over(self) -> NDArray[np.bool_]:
        """True if the race ended before its time, by a crash or by its laps, shape (B,)."""
        if self.laps.shape[2] == LAP_COLUMNS:
            return self.crashed
        return self.crashed | np.isfinite(self.finish_time).any(axis=1)

    @property
    def lap_count(self) -> NDArray[np.int64]:
        """Number of complete laps of each car, shape (B, N).

        A lap ends where progress passes a multiple of the track's length. The start line is the
        line of all laps, and the first lap begins with the race.
        """
        return self.laps[..., LAPS].astype(np.int64)

    @property
    def lap_time(self) -> NDArray[np.float64]:
        """Time of each car's last complete lap, s, shape (B, N); -1 if there is none.

        The ends of laps are interpolated between two samples, 0.02 s apart.
        """
        return self._laps_or_none(LAP_TIME)

    @property
    def best_lap(self) -> NDArray[np.float64]:
        """Time of each car's shortest complete lap, s, shape (B, N); -1 if there is none."""
        return self._laps_or_none(BEST_LAP)

    @property
    def lap_times(self) -> NDArray[np.float64]:
        """Time of each lap of a race with L laps, s, shape (B, N, L); NaN for a lap not driven.

        The first lap begins with the race, the others at the start line.
        """
        times = self.laps[..., LAP_COLUMNS:]
        driven = np.arange(times.shape[2]) < self.laps[..., LAPS, None]
        return np.where(driven, times, np.nan)

    def _laps_or_none(self, column: int) -> NDArray[np.float64]:
        return np.where(self.laps[..., LAPS] > 0.0, self.laps[..., column], NO_LAP)

    def copy(self) -> "RaceState":
        """Return an independent copy."""
        return RaceState._make(array.copy() for array in self)


def empty_state(races: int, memory_size: int, cars: int = 2, laps: int | None = None) -> RaceState:
    """Return the state of a batch of races with all numbers 0 and no leader.

    ``laps``: number of laps that ends a race, None for races by time.
    """
    return RaceState(
        tick=np.zeros(races, np.int64),
        seed=np.zeros(races, np.uint64),
        cars=np.zeros((races, cars, 7)),
        frenet=np.zeros((races, cars, 2)),
        progress=np.zeros((races, cars)),
        command=np.zeros((races, cars, 2)),
        disturbance=np.zeros((races, cars)),
        path=np.zeros((races, cars, PATH_POINTS, PATH_COLUMNS)),
        memory=np.zeros((races, cars, memory_size)),
        sums=np.zeros((races, cars, len(SUMS))),
        crash=np.zeros((races, cars), np.int8),
        fault=np.zeros((races, cars), np.int8),
        leader=np.full(races, -1, np.int8),
        overtakes=np.zeros((races, cars), np.int64),
        laps=np.zeros((races, cars, LAP_COLUMNS + (laps or 0))),
        ahead=np.zeros((races, cars), np.uint8),
        contact=np.zeros((races, cars), np.int8),
        handicap=np.zeros((races, cars)),
    )


def take(state: RaceState, indices: ArrayLike) -> RaceState:
    """Return copies of some races, in the given order (a race may be taken more than once)."""
    chosen = np.asarray(indices)
    return RaceState._make(np.ascontiguousarray(array[chosen]) for array in state)


def concatenate(states: list[RaceState]) -> RaceState:
    """Join batches of races into one."""
    return RaceState._make(np.concatenate(arrays) for arrays in zip(*states, strict=True))
