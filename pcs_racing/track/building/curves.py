"""Closed plane curves (points (N, 2), m), and closed cubic splines sampled at equal arc length.

The periodic cubic spline through chord-length knots is textbook material (de Boor, *A Practical
Guide to Splines*, 1978, chapter IV). Its cyclic tridiagonal system is solved with the
Sherman-Morrison correction of *Numerical Recipes*, 2.7.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import headings, lengths, sine_cosine
from pcs_racing.base.typing import Floats

# Five-point Gauss-Legendre rule on [0, 1], the same bits everywhere (numpy computes it by LAPACK):
# exact for the arc length of near-cubic curves.
_NODES = (0.046910077030668004, 0.23076534494715845, 0.5, 0.7692346550528415, 0.953089922969332)
_WEIGHTS = (
    0.11846344252809454,
    0.23931433524968324,
    0.28444444444444444,
    0.23931433524968324,
    0.11846344252809454,
)


class LineSamples(NamedTuple):
    """A closed line sampled at equal arc length."""

    length: float  #: Length of the closed line in m.
    xy: Floats  #: shape (N, 2): Points at ``s = i * length / N``, in m.
    tangent: Floats  #: shape (N, 2): Unit tangents.
    psi: Floats  #: shape (N,): Heading in rad, continuous along the line.
    kappa: Floats  #: shape (N,): Curvature in 1/m, positive to the left.


@compiled
def solve_cyclic(lower, diagonal, upper, right):
    """Solve ``lower[i] x[i-1] + diagonal[i] x[i] + upper[i] x[i+1] = right[i]`` for x (n, m).

    Indices are modulo n. The matrix must be diagonally dominant, and n at least 3.
    """
    n, m = right.shape
    # The two corner entries are a rank-one correction, solved as an additional right-hand side.
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


def clean_closed(points: ArrayLike) -> Floats:
    """Return the points of a closed line without repeated points (including first = last)."""
    xy = np.ascontiguousarray(points, dtype=np.float64)
    step = lengths(np.roll(xy, -1, axis=0) - xy)
    return np.ascontiguousarray(xy[step > 1e-6])


def sample_closed(points: ArrayLike, ds: float) -> LineSamples:
    """Sample the periodic cubic spline through a closed line at equal arc length.

    The samples begin at the first point. At least four points, shape (K, 2) in m, must differ (else
    a ``ValueError``); the last may repeat the first. The spacing divides the length, and is as near
    to ``ds`` (m) as possible.
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
    # On interval k, with u in [0, 1]: position and derivatives by chord length.
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
    # Newton's method on the arc length; chord lengths are a good guess, so four steps are enough.
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


MAX_LENGTH = 10_000.0  # m: far beyond any track for 1:10 cars; it bounds the memory


@compiled
def transform(real, imaginary):
    """Return ``X[k] = sum_j x[j] exp(-2 pi i j k / N)`` for any N.

    The number of operations is N times the sum of its prime factors. The result has the same bits
    on every processor; numpy's transform uses the sines of the C library, which selects its code by
    the processor. This is the mixed-radix transform in Stockham's order (Van Loan 1992,
    *Computational Frameworks for the Fast Fourier Transform*, 1.7). Real and imaginary parts are
    separate arguments and results.
    """
    n = real.shape[0]
    sine = np.empty(n)
    cosine = np.empty(n)
    for k in range(n):
        sine[k], cosine[k] = sine_cosine(-2.0 * np.pi * k / n)
    re, im = real.copy(), imaginary.copy()
    next_re, next_im = np.empty(n), np.empty(n)
    done = 1  # values already combined into one
    left = n
    radix = 2
    while left > 1:
        while left % radix != 0:
            radix = radix + 1 if radix * radix <= left else left
        left //= radix
        for k in range(left):
            for r in range(radix):
                for j in range(done):
                    total_re = 0.0
                    total_im = 0.0
                    for q in range(radix):
                        # Product of the twiddle factors of the short and the long transform.
                        turn = (q * r * (n // radix) + k * r * done) % n
                        a, b = re[j + done * (k + left * q)], im[j + done * (k + left * q)]
                        total_re += a * cosine[turn] - b * sine[turn]
                        total_im += a * sine[turn] + b * cosine[turn]
                    next_re[j + done * (radix * k + r)] = total_re
                    next_im[j + done * (radix * k + r)] = total_im
        done *= radix
        re, next_re = next_re, re
        im, next_im = next_im, im
    return re, im


def curve_length(xy: np.ndarray) -> float:
    """Return the length in m of a closed polyline, shape (N, 2)."""
    return float(lengths(np.roll(xy, -1, axis=0) - xy).sum())


def signed_area(xy: np.ndarray) -> float:
    """Return the area in m^2 inside a closed polyline, (N, 2); positive if counterclockwise."""
    x, y = xy.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def resample(xy: np.ndarray, step: float) -> np.ndarray:
    """Return evenly spaced points on the spline through a closed curve (:func:`sample_closed`)."""
    return sample_closed(xy, step).xy


def smooth(xy: np.ndarray, wavelength: float) -> np.ndarray:
    """Return a closed curve, evenly spaced, without waves shorter than about ``wavelength`` (m).

    The points y minimise ``sum |y - x|^2 + c sum |y''|^2`` around the loop. Fourier modes separate
    the problem: a wave is multiplied by ``1 / (1 + (wavelength / its own length)^4)``.
    """
    n = len(xy)
    waves = np.minimum(np.arange(n), n - np.arange(n))  # around the loop
    ratio = (wavelength / curve_length(xy) * waves) ** 2
    share = 1.0 / (n * (1.0 + ratio * ratio))
    real, imaginary = transform(xy[:, 0], xy[:, 1])
    # The inverse transform is the transform with exchanged real and imaginary parts.
    y, x = transform(imaginary * share, real * share)
    return np.column_stack([x, y])


@compiled
def first_crossing(xy):
    """Return the first crossing segments (i, j) of a closed polyline; (-1, -1) if it is simple.

    Segment i begins at point i. From one segment to the next the distance to a third segment
    changes by at most the longest step. So after a distant pair, all segments too far away to cross
    are skipped: an evenly sampled track takes almost linear time.
    """
    n = xy.shape[0]
    longest = 0.0
    for i in range(n):
        dx, dy = xy[(i + 1) % n, 0] - xy[i, 0], xy[(i + 1) % n, 1] - xy[i, 1]
        longest = max(longest, np.sqrt(dx * dx + dy * dy))
    for i in range(n - 2):
        ax, ay = xy[i]
        bx, by = xy[i + 1]
        j = i + 2
        # The last segment meets the first in the first point: no crossing.
        last = n if i > 0 else n - 1
        while j < last:
            cx, cy = xy[j]
            far = int(np.sqrt((cx - ax) * (cx - ax) + (cy - ay) * (cy - ay)) / longest)
            if far > 3:
                j += far - 2
                continue
            dx, dy = xy[(j + 1) % n]
            j += 1
            # On a straight the sides below are rounding errors; disjoint boxes rule out a crossing.
            if max(cx, dx) < min(ax, bx) or min(cx, dx) > max(ax, bx):
                continue
            if max(cy, dy) < min(ay, by) or min(cy, dy) > max(ay, by):
                continue
            c_side = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            d_side = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
            a_side = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
            b_side = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
            if c_side * d_side <= 0.0 and a_side * b_side <= 0.0:
                return i, j - 1
    return -1, -1
