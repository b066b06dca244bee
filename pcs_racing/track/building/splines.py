"""Closed cubic splines, sampled at equal arc length; numpy and numba only.

The periodic cubic spline through chord-length knots is textbook material (de Boor, *A Practical Guide to Splines*,
1978, chapter IV); its cyclic tridiagonal system is solved with the Sherman-Morrison correction of *Numerical Recipes*,
2.7.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import headings, lengths

Floats = NDArray[np.float64]

# Gauss and Legendre's rule of five points on [0, 1], to the last bit (numpy's function finds it by LAPACK): exact for
# the arc length of anything close to a cubic.
_NODES = (0.046910077030668004, 0.23076534494715845, 0.5, 0.7692346550528415, 0.953089922969332)
_WEIGHTS = (0.11846344252809454, 0.23931433524968324, 0.28444444444444444, 0.23931433524968324, 0.11846344252809454)


class LineSamples(NamedTuple):
    """A closed line sampled at equal arc length."""

    length: float  #: Length of the closed line in m.
    xy: Floats  #: shape (N, 2): Points at ``s = i * length / N``, in m.
    tangent: Floats  #: shape (N, 2): Unit tangents.
    psi: Floats  #: shape (N,): Heading in rad, continuous along the line.
    kappa: Floats  #: shape (N,): Curvature in 1/m, positive to the left.


@compiled
def solve_cyclic(lower, diagonal, upper, right):  # type: ignore[no-untyped-def]
    """Solve ``lower[i] x[i-1] + diagonal[i] x[i] + upper[i] x[i+1] = right[i]``, indices modulo n, for x (n, m).

    The matrix must be diagonally dominant, and n at least 3.
    """
    n, m = right.shape
    # The two corner entries become a correction of rank one, carried along as one more right-hand side.
    gamma = -diagonal[0]
    main = diagonal.copy()
    main[0] -= gamma
    main[n - 1] -= lower[0] * upper[n - 1] / gamma
    x = np.empty((n, m + 1))
    x[:, :m] = right
    x[:, m] = 0.0
    x[0, m] = gamma
    x[n - 1, m] = upper[n - 1]
    for i in range(1, n):
        factor = lower[i] / main[i - 1]
        main[i] -= factor * upper[i - 1]
        for j in range(m + 1):
            x[i, j] -= factor * x[i - 1, j]
    for j in range(m + 1):
        x[n - 1, j] /= main[n - 1]
    for i in range(n - 2, -1, -1):
        for j in range(m + 1):
            x[i, j] = (x[i, j] - upper[i] * x[i + 1, j]) / main[i]
    corner = lower[0] / gamma
    out = np.empty((n, m))
    for j in range(m):
        factor = (x[0, j] + corner * x[n - 1, j]) / (1.0 + x[0, m] + corner * x[n - 1, m])
        for i in range(n):
            out[i, j] = x[i, j] - factor * x[i, m]
    return out


def clean_closed(points: ArrayLike, tolerance: float = 1e-6) -> Floats:
    """Points of a closed line without repeated ones; a last point that repeats the first is dropped too."""
    xy = np.ascontiguousarray(points, dtype=np.float64)
    step = lengths(np.roll(xy, -1, axis=0) - xy)
    return np.ascontiguousarray(xy[step > tolerance])


def sample_closed(points: ArrayLike, ds: float) -> LineSamples:
    """Sample the periodic cubic spline through the points of a closed line at equal arc length, the first point first.

    The points, shape (K, 2) in m, are four or more that differ (else a ``ValueError``); the first need not be repeated
    at the end. Of the spacings that divide the length the one nearest to ``ds`` (m) is taken.
    """
    xy = clean_closed(points)
    if len(xy) < 4:
        raise ValueError(f"a closed line needs at least 4 distinct points, got {len(xy)}")
    step = np.roll(xy, -1, axis=0) - xy
    h = lengths(step)
    before = np.roll(h, 1)
    slope = step / h[:, None]
    bend = solve_cyclic(before, 2.0 * (before + h), h, 6.0 * (slope - np.roll(slope, 1, axis=0)))
    bend_next = np.roll(bend, -1, axis=0)
    # On interval k, with u in [0, 1]: position, and derivatives by chord length.
    c1 = slope - h[:, None] * (2.0 * bend + bend_next) / 6.0
    c2 = 0.5 * bend
    c3 = (bend_next - bend) / (6.0 * h[:, None])

    def velocity(k: NDArray[np.intp], t: Floats) -> Floats:
        t = t[..., None]
        return c1[k] + t * (2.0 * c2[k] + 3.0 * t * c3[k])

    def arc(k: NDArray[np.intp], t: Floats) -> Floats:
        mean = np.zeros(len(t))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            mean += weight * lengths(velocity(k, t * node))
        return t * mean

    start = np.concatenate([[0.0], np.cumsum(arc(np.arange(len(xy)), h))])
    length = float(start[-1])
    count = max(round(length / ds), 8)
    s = np.arange(count) * (length / count)
    k = np.minimum(np.searchsorted(start, s, side="right") - 1, len(xy) - 1)
    t = h[k] * (s - start[k]) / (start[k + 1] - start[k])
    # Newton's method on the arc length; chord lengths are so good a guess that four steps are enough.
    for _ in range(4):
        t = t - (arc(k, t) - (s - start[k])) / lengths(velocity(k, t))
    t1 = t[:, None]
    position = xy[k] + t1 * (c1[k] + t1 * (c2[k] + t1 * c3[k]))
    v = velocity(k, t)
    a = 2.0 * c2[k] + 6.0 * t1 * c3[k]
    speed = lengths(v)
    return LineSamples(
        length=length,
        xy=position,
        tangent=v / speed[:, None],
        psi=np.unwrap(headings(v)),
        kappa=(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / (speed * speed * speed),
    )
