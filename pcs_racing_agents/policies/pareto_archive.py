"""Archive of a search: all evaluated points, and the Pareto front of its members."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.policies.indicators import non_dominated

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class Scale(NamedTuple):
    """Points normalised to 1 and 0 on each axis for hypervolumes."""

    ideal: Floats  #: shape (G,): ``ideal``, ``nadir``: Points normalised to 1 and 0.
    nadir: Floats

    def __call__(self, objectives: Floats) -> Floats:
        """Return normalised objectives, shape (..., G)."""
        return np.asarray((objectives - self.nadir) / (self.ideal - self.nadir), np.float64)


@dataclass(frozen=True, eq=False)
class ParetoArchive:
    """All points of a search so far; adding points returns a new archive."""

    parameters: Floats  #: shape (N, P)
    objectives: Floats  #: shape (N, G): Objectives, to maximise.
    violation: Floats  #: shape (N,): Violation; up to 0 for feasible points.
    #: shape (N,): True for members of the archive (the population archive of Algorithm 1).
    member: NDArray[np.bool_]
    #: shape (K,): Indices of the archive's Pareto front, ascending: feasible members that no other
    #: feasible member beats; of equal members the first.
    front: Indices = field(init=False)

    def __post_init__(self) -> None:
        rows = np.flatnonzero(self.member & (self.violation <= 0.0))
        kept = (
            non_dominated(self.objectives[rows], duplicates=False)
            if len(rows)
            else np.zeros(0, np.bool_)
        )
        object.__setattr__(self, "front", rows[kept])

    @classmethod
    def empty(cls, parameters: int) -> "ParetoArchive":
        """Return an archive without points."""
        return cls(np.zeros((0, parameters)), np.zeros((0, 0)), np.zeros(0), np.zeros(0, np.bool_))

    def __len__(self) -> int:
        return len(self.parameters)

    def joined(
        self,
        parameters: Floats,
        objectives: Floats,
        violation: Floats,
        member: NDArray[np.bool_] | None = None,
    ) -> "ParetoArchive":
        """Return the archive with n points added, all of them as members unless stated."""
        count = len(parameters)
        known = self.objectives if len(self) else np.zeros((0, objectives.shape[1]))
        return ParetoArchive(
            np.concatenate([self.parameters, parameters]),
            np.concatenate([known, objectives]),
            np.concatenate([self.violation, violation]),
            np.concatenate([self.member, np.ones(count, np.bool_) if member is None else member]),
        )

    def scale(self, ideal: Floats | None = None, nadir: Floats | None = None) -> Scale:
        """Return the range of the front, or the stated points.

        An axis without extent in the front gets the range of all feasible points, or else an extent
        of 1.
        """
        if ideal is not None and nadir is not None:
            return Scale(ideal, nadir)
        feasible = self.objectives[self.violation <= 0.0]
        if len(feasible) == 0:
            return Scale(np.ones(self.objectives.shape[1]), np.zeros(self.objectives.shape[1]))
        low, high = feasible.min(axis=0), feasible.max(axis=0)
        # A division by an extent of 0 is avoided.
        high = np.where(low < high, high, low + 1.0)
        if len(self.front):
            least, largest = (
                self.objectives[self.front].min(axis=0),
                self.objectives[self.front].max(axis=0),
            )
            low, high = (
                np.where(least < largest, least, low),
                np.where(least < largest, largest, high),
            )
        return Scale(high, low)
