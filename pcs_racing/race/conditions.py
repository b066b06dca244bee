"""Conditions of each race of a batch, apart from start and noise: cars, planners, and obstacles on
the track.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car.vehicle import PARAMS_SIZE, VehicleParams
from pcs_racing.track.track import Track

if TYPE_CHECKING:
    from pcs_racing.planners.planner import Planner

Share: TypeAlias = "list[tuple[Planner | None, NDArray[np.int64]]]"
"""Planners of a car, each with the indices of its races; None for a steered car."""


@dataclass(frozen=True, eq=False)
class RaceConditions:
    """Cars, tracks and planners of the B races of a batch, if they differ between the races."""

    #: shape (B, N, 48): Parameter rows of the cars
    #: (:meth:`pcs_racing.car.vehicle.VehicleParams.as_row`); None for the cars of the setup.
    vehicles: NDArray[np.float64] | None = None
    #: Track of each race: the setup's track with obstacles on it; None for the setup's track.
    tracks: tuple[Track, ...] | None = None
    #: shape (B, N): Planner of each car, None for a steered car; None for the setup's planners.
    planners: NDArray[np.object_] | None = None

    def take(self, indices: ArrayLike) -> "RaceConditions":
        """Return the conditions of some races, in the given order."""
        chosen = np.asarray(indices, np.intp)
        return RaceConditions(
            None if self.vehicles is None else np.ascontiguousarray(self.vehicles[chosen]),
            None if self.tracks is None else tuple(self.tracks[i] for i in chosen),
            None if self.planners is None else self.planners[chosen],
        )

    def rows(self, vehicles: Sequence[VehicleParams], races: int) -> NDArray[np.float64]:
        """Return the cars' parameter rows in every race, (races, N, 48); by default the setup's."""
        if self.vehicles is None:
            return vehicle_rows(vehicles, races)
        wanted = (races, len(vehicles), PARAMS_SIZE)
        if self.vehicles.shape != wanted:
            raise InputError(
                f"vehicles have shape {self.vehicles.shape}; for {races} races they must have"
                f" {wanted}"
            )
        return self.vehicles

    def shares(self, planners: "Sequence[Planner | None]", races: int) -> list[Share]:
        """Return the planners of each car with their races; by default the setup's ``planners``."""
        if self.planners is None:
            return [[(planner, np.arange(races))] for planner in planners]
        if self.planners.shape != (races, len(planners)):
            raise InputError(
                f"planners have shape {self.planners.shape}; for {races} races they must have"
                f" {(races, len(planners))}"
            )
        return [
            [
                (planner, np.flatnonzero([one is planner for one in column]))
                for planner in {id(one): one for one in column}.values()
            ]
            for column in self.planners.T.tolist()
        ]

    def runs(self, track: Track, races: int) -> list[tuple[Track, int, int]]:
        """Return runs of neighbouring races on one track: track, first race, last race + 1."""
        if self.tracks is None:
            return [(track, 0, races)]
        if len(self.tracks) != races:
            raise InputError(
                f"there are {len(self.tracks)} tracks for {races} races; give one for each"
            )
        return [(self.tracks[first], first, last) for first, last in runs_of(self.tracks)]


AS_THE_SETUP = RaceConditions()
"""The same cars, track and planners in every race."""


def runs_of(values: Sequence[object]) -> list[tuple[int, int]]:
    """Return first index and last index + 1 of every run of the same object in a sequence."""
    edges = [0, *(i for i in range(1, len(values)) if values[i] is not values[i - 1]), len(values)]
    return list(pairwise(edges)) if values else []


def vehicle_rows(vehicles: Sequence[VehicleParams], races: int) -> NDArray[np.float64]:
    """Return the parameters of the cars in every race, shape (races, N, 48)."""
    # Writeable arrays, or the kernels would be compiled a second time for one race.
    rows = np.empty((races, len(vehicles), PARAMS_SIZE))
    for car, vehicle in enumerate(vehicles):
        rows[:, car] = vehicle.as_row()
    return rows
