"""Coordinates of policies in a payoff matrix: the rating, and the place in the leading cyclic plane."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array
from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.headroom import cyclic_planes, ratings

Floats = NDArray[np.float64]

COORDINATES = ("rating", "cycle_1", "cycle_2")


@dataclass(frozen=True, eq=False)
class PayoffCoordinates:
    """Rating and cyclic plane of a pool of policies.

    The payoff of policy i against policy j is about ``rating_i - rating_j + x_i y_j - y_i x_j``, with ``(x, y)`` the
    place in the plane.
    """

    rating: Floats  #: shape (N,): Mean payoff over the pool, races won.
    #: shape (N, 2): Places in the leading cyclic plane, turned so that the first coordinate grows with a given
    #: behaviour and the second is uncorrelated with it.
    plane: Floats
    #: ``strength``, ``noise``: Singular value of the plane, and what noise alone reaches in 95 of 100 draws.
    strength: float
    noise: float

    @property
    def scale(self) -> Floats:
        """Units of :attr:`standard`: sd of the ratings, and root mean square of both coordinates of the plane."""
        return np.array([self.rating.std(), *[np.sqrt(np.square(self.plane).mean())] * 2])

    @property
    def standard(self) -> Floats:
        """Rating and place, shape (N, 3): mean 0 and in standard deviations over the pool."""
        return np.column_stack([self.rating, self.plane]) / self.scale


def payoff_coordinates(payoffs: ArrayLike, behaviour: ArrayLike) -> PayoffCoordinates:
    """Return rating and leading cyclic plane of a pool.

    Parameters
    ----------
    payoffs : array_like, shape (F, N, N)
        As for :func:`pcs_racing_agents.policies.headroom.cyclic_planes`.
    behaviour : array_like, shape (N,)
        What the first coordinate of the plane is to grow with; a plane has no direction of its own.
    """
    rating, leading = ratings(payoffs), cyclic_planes(payoffs)[0]
    trend = check_array("behaviour", behaviour, (len(rating),))
    trend = trend - trend.mean()
    cos, sin = trend @ leading.points
    length = float(np.hypot(cos, sin))
    if length == 0.0 or rating.std() == 0.0:
        raise InputError("all policies have the same rating or the same behaviour; a pool needs policies that differ")
    cos, sin = cos / length, sin / length
    plane = leading.points @ np.array([[cos, -sin], [sin, cos]])
    return PayoffCoordinates(rating, plane, leading.strength, leading.noise)
