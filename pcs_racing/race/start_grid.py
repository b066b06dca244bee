"""Putting both cars of every race on the grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.positions import place_cars
from pcs_racing.race.state import RaceState, empty_state
from pcs_racing.track.frenet import LEFT, RIGHT, SPEED, X, Y
from pcs_racing.track.track import Track


@dataclass(frozen=True, eq=False)
class Starts:
    """Where the cars of a batch of races start."""

    s: NDArray[np.float64]  #: shape (B,): Arc length of the start line, m.
    #: shape (B,): 0 when car 0 starts on the left (side by side) or in front (staggered, rolling), 1 when car 1 does.
    side: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.s)

    def take(self, indices: ArrayLike) -> "Starts":
        """Return some of them, in the order asked for."""
        chosen = np.asarray(indices)
        return Starts(self.s[chosen], self.side[chosen])


def place_on_grid(
    track: Track,
    config: RaceConfig,
    spacing: float,
    slowest: float,
    vehicles: tuple[VehicleParams, VehicleParams],
    starts: Starts,
    memory_size: int,
    conditions: RaceConditions = AS_THE_SETUP,
) -> RaceState:
    """Both cars of every race at their start; a race whose cars do not fit there is marked as crashed.

    Side by side, the two cars are centred between the walls; staggered and rolling, the rear car stands ``start_gap``
    behind and both are ``spacing`` (m) apart across the track. Progress is counted from the front car's line. No car
    starts faster than the race line at the speed scale ``slowest``, that of pace 0.
    """
    arrays = track.arrays
    outside = ~((starts.s >= 0.0) & (starts.s < arrays.length))
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"race {i}: the start line {starts.s[i]} m is not on track {track.name!r}; it must lie in "
            f"[0, {arrays.length:.2f})"
        )
    neither = (starts.side != 0) & (starts.side != 1)
    if neither.any():
        raise InputError(f"start sides must be 0 or 1; found {starts.side[neither][0]}")
    state = empty_state(len(starts), memory_size)
    # A row for each race, and in it the left or front place, then the right or rear one.
    car = np.stack([starts.side, 1 - starts.side], axis=1)
    race = np.arange(len(starts))[:, None]
    behind = np.zeros(2) if config.start == "side-by-side" else np.array([0.0, config.start_gap])
    s = np.mod(starts.s[:, None] - behind, arrays.length)
    sample = arrays.line[(s / arrays.ds).astype(np.intp) % len(arrays.line)]
    middle = 0.5 * (sample[..., LEFT] - sample[..., RIGHT])
    d = middle + np.array([0.5, -0.5]) * spacing
    pose = track.to_cartesian(np.stack([s, d], axis=-1))
    # No start faster than the slowest policy may drive there: it would begin with a crash that nobody chose.
    profile = slowest * sample[..., SPEED]
    state.cars[race, car, X] = pose[..., 0]
    state.cars[race, car, Y] = pose[..., 1]
    state.cars[race, car, _vehicle.V] = (
        profile if config.start == "rolling" else np.minimum(config.start_speed, profile)
    )
    state.cars[race, car, _vehicle.PSI] = np.mod(pose[..., 2], 2.0 * np.pi)
    state.progress[race, car] = -behind
    settle(track, vehicles, state, conditions)
    return state


def settle(
    track: Track,
    vehicles: tuple[VehicleParams, VehicleParams],
    state: RaceState,
    conditions: RaceConditions = AS_THE_SETUP,
) -> None:
    """Set the Frenet coordinates of freshly placed cars, and mark those that stand in a wall or in the other one."""
    cars = conditions.rows(vehicles, state.races)
    for on, first, last in conditions.runs(track, state.races):
        part = RaceState._make(array[first:last] for array in state)
        place_cars(on.arrays, part, cars[first:last])
