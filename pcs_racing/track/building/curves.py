"""Closed plane curves as arrays of points (N, 2), in m."""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import lengths, sine_cosine
from pcs_racing.base.errors import MapError
from pcs_racing.track.building.splines import sample_closed

MAX_LENGTH = 10_000.0  # m: far beyond any circuit for 1:10 cars, and it bounds the memory


@compiled
def transform(real, imaginary):  # type: ignore[no-untyped-def]
    """Return ``X[k] = sum_j x[j] exp(-2 pi i j k / N)`` for any N, in N times the sum of its prime factors operations.

    It has the same bits on every processor; numpy's transform uses the sines of the C library, which selects its code
    by the processor. This is the mixed-radix transform in Stockham's order (Van Loan 1992, *Computational Frameworks
    for the Fast Fourier Transform*, 1.7). Real and imaginary parts go in and come out one by one.
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
                        # One turn of both: the short transform's and that of its place in the long one.
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


def checked_curve(points: np.ndarray, label: str) -> np.ndarray:
    """Points of a closed curve as an (N, 2) array, without repeated neighbours and without a repeated first point.

    Further columns are ignored.
    """
    xy = np.asarray(points, dtype=np.float64)
    if xy.ndim != 2 or xy.shape[1] < 2:
        raise MapError(f"the {label} has shape {xy.shape}: rows that begin with x and y are needed")
    xy = xy[:, :2]
    if not np.isfinite(xy).all():
        raise MapError(
            f"the {label} holds a coordinate that is not finite, in row {int(np.argwhere(~np.isfinite(xy))[0, 0])}"
        )
    xy = xy[lengths(xy - np.roll(xy, 1, axis=0)) > 1e-9]
    if len(xy) < 4:
        raise MapError(f"the {label} has {len(xy)} different points: a closed curve needs at least 4")
    steps = lengths(np.roll(xy, -1, axis=0) - xy)
    if steps[-1] > 10.0 * np.median(steps) and steps[-1] > 0.1 * steps.sum():
        raise MapError(f"the {label} is open: its last point lies {steps[-1]:.2f} m from its first")
    return xy


def curve_length(xy: np.ndarray) -> float:
    """Length in m of a closed polyline, shape (N, 2)."""
    return float(lengths(np.roll(xy, -1, axis=0) - xy).sum())


def signed_area(xy: np.ndarray) -> float:
    """Area in m^2 inside a closed polyline, shape (N, 2); positive if it runs counterclockwise."""
    x, y = xy.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def resample(xy: np.ndarray, step: float) -> np.ndarray:
    """Evenly spaced points on the periodic cubic spline through a closed curve, see :func:`sample_closed`."""
    return sample_closed(xy, step).xy


def smooth(xy: np.ndarray, wavelength: float) -> np.ndarray:
    """Closed curve, given by evenly spaced points, without waves that are shorter than about ``wavelength`` (m).

    The points y that minimise ``sum |y - x|^2 + c sum |y''|^2`` around the loop, which Fourier modes solve one by one:
    a wave is multiplied by ``1 / (1 + (wavelength / its own length)^4)``.
    """
    n = len(xy)
    waves = np.minimum(np.arange(n), n - np.arange(n))  # around the loop
    ratio = (wavelength / curve_length(xy) * waves) ** 2
    share = 1.0 / (n * (1.0 + ratio * ratio))
    real, imaginary = transform(xy[:, 0], xy[:, 1])
    # The inverse transform is the transform with its two parts exchanged.
    y, x = transform(imaginary * share, real * share)
    return np.column_stack([x, y])


@compiled
def first_crossing(xy):  # type: ignore[no-untyped-def]
    """First pair of segments of a closed polyline that cross, those from points i and j on; (-1, -1) if it is simple.

    From one segment to the next the distance to a third one changes by at most the longest step. So after a pair that
    is far apart, all segments that can't be near yet are skipped: an evenly sampled circuit takes almost linear time.
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
        # The last segment meets the first one in the first point: no crossing.
        last = n if i > 0 else n - 1
        while j < last:
            cx, cy = xy[j]
            far = int(np.sqrt((cx - ax) * (cx - ax) + (cy - ay) * (cy - ay)) / longest)
            if far > 3:
                j += far - 2
                continue
            dx, dy = xy[(j + 1) % n]
            j += 1
            # On a straight the sides below are rounding errors; boxes that don't overlap settle it.
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
