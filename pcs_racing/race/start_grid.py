"""Starting grid: placement of the cars of every race."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats
from pcs_racing.car.vehicle import PSI, V, VehicleParams
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import Rules
from pcs_racing.race.positions import mark_contacts, place_cars
from pcs_racing.race.state import RaceState, empty_state
from pcs_racing.track.frenet import LEFT, RIGHT, SPEED, X, Y
from pcs_racing.track.track import Track

ROW = 2.0  # m between rows of two cars
PLACE_EVERY = 0.5  # m between tried start places
BLOCK = 1.0  # m: length of the stretches that alternate between training and test
CLEAR = 0.4  # m: min distance between the middle of a car and a wall, from the third car on


Stretches = tuple[tuple[float, float], ...]
"""First and last start place of each run of valid places, arc lengths, m."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Start positions of a batch of races."""

    s: NDArray[np.float64]  #: shape (B,): Arc length of the start line, m.
    #: shape (B,): Place of car 0 on the grid: 0 is on the left (side by side) or in front
    #: (staggered, rolling). The next places belong to car 1, 2 ...; the first place follows the
    #: last.
    side: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.s)

    def take(self, indices: ArrayLike) -> "Starts":
        """Return some of the starts, in the given order."""
        chosen = np.asarray(indices)
        return Starts(self.s[chosen], self.side[chosen])


def place_on_grid(
    track: Track,
    rules: Rules,
    spacing: float,
    slowest: float,
    vehicles: tuple[VehicleParams, ...],
    starts: Starts,
    memory_size: int,
    conditions: RaceConditions = AS_THE_SETUP,
) -> RaceState:
    """Return the start state of every race; races whose cars do not fit are marked as crashed.

    Side by side, two cars are centred between the walls, and the next two cars are `ROW` m, or
    ``start_gap`` if that is more, behind them. Staggered and rolling, each car is ``start_gap``
    behind the car before it, on the other side. The sides are ``spacing`` (m) apart across the
    track; from the third car on they are nearer where the track is narrow. Progress is counted from
    the front car's line. No car starts faster than the race line at the speed scale ``slowest``,
    the scale of pace 0.
    """
    arrays = track.arrays
    outside = ~((starts.s >= 0.0) & (starts.s < arrays.length))
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"race {i}: the start line {starts.s[i]} m is not on track {track.name!r}; it must lie"
            f" in [0, {arrays.length:.2f})"
        )
    places = places_of_grid(len(vehicles))
    wrong = (starts.side < 0) | (starts.side >= places)
    if wrong.any():
        sides = "0 or 1" if places == 2 else f"from 0 to {places - 1}"
        raise InputError(f"start sides must be {sides}; found {starts.side[wrong][0]}")
    state = empty_state(len(starts), memory_size, len(vehicles), rules.laps)
    # One row per race, one column per car.
    place = (starts.side[:, None] + np.arange(len(vehicles))) % places
    row, gap = place, rules.start_gap
    if rules.start == "side-by-side":
        row, gap = place // 2, max(ROW, rules.start_gap)
    behind = row * gap
    s = np.mod(starts.s[:, None] - behind, arrays.length)
    sample = arrays.line[(s / arrays.ds).astype(np.intp) % len(arrays.line)]
    middle = 0.5 * (sample[..., LEFT] - sample[..., RIGHT])
    d = middle + np.array([0.5, -0.5])[place % 2] * spacing
    fitting = np.minimum(np.maximum(d, CLEAR - sample[..., RIGHT]), sample[..., LEFT] - CLEAR)
    d = np.where(place < 2, d, fitting)
    pose = track.to_cartesian(np.stack([s, d], axis=-1))
    # No start is faster than the slowest policy may drive there: otherwise the race would begin
    # with a crash that no policy chose.
    profile = slowest * sample[..., SPEED]
    state.cars[..., X], state.cars[..., Y] = pose[..., 0], pose[..., 1]
    state.cars[..., V] = (
        profile if rules.start == "rolling" else np.minimum(rules.start_speed, profile)
    )
    state.cars[..., PSI] = np.mod(pose[..., 2], 2.0 * np.pi)
    state.progress[:] = -behind
    settle(track, vehicles, state, conditions)
    return state


def places_of_grid(cars: int) -> int:
    """Return the number of start places of car 0: the number of cars, or 2 for a car alone."""
    return max(2, cars)


def settle(
    track: Track,
    vehicles: tuple[VehicleParams, ...],
    state: RaceState,
    conditions: RaceConditions = AS_THE_SETUP,
) -> None:
    """Set the Frenet coordinates of new cars; mark cars in a wall or in another car as crashed."""
    cars = conditions.rows(vehicles, state.races)
    for on, first, last in conditions.runs(track, state.races):
        part = RaceState._make(array[first:last] for array in state)
        own = cars[first:last]
        place_cars(on.arrays, part.cars, part.frenet, part.crash, own)
        if len(vehicles) > 1 or len(on.arrays.moving):
            mark_contacts(on.arrays, part.cars, part.crash, own, part.tick)


def stretches_of(fit: NDArray[np.bool_]) -> Stretches:
    """Return the first and the last place of every run of valid places."""
    edges = np.diff(np.concatenate([[False], fit, [False]]).astype(np.int8))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple(
        (round(first * PLACE_EVERY, 3), round(last * PLACE_EVERY, 3))
        for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True)
    )


def places_of(stretches: Stretches) -> Floats:
    """Return all places of some stretches, m, ascending."""
    return np.concatenate(
        [np.arange(first, last + 0.5 * PLACE_EVERY, PLACE_EVERY) for first, last in stretches]
    )


def split_places(places: Floats, split: str) -> Floats:
    """Return the places for training or for tests; every second block of 1 m is for training.

    If less than a quarter of the places lie in blocks of one kind, every second place is for
    training instead.
    """
    if split not in ("train", "test"):
        raise InputError(f"split is {split!r}; it must be 'train' or 'test'")
    training = (places / BLOCK).astype(np.int64) % 2 == 1
    if min(np.count_nonzero(training), np.count_nonzero(~training)) < len(places) // 4:
        training = np.arange(len(places)) % 2 == 1
    return places[training if split == "train" else ~training]
