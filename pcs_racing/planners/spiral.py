"""Cubic curvature spirals: smooth paths from a pose to a goal pose, curvature matched at both ends [1]_.

Along the path, u in [0, 1], the curvature is the cubic through p0, p1, p2, p3 at u = 0, 1/3, 2/3, 1. With the end
heading eliminated, two unknowns are left: the length and ``w = length (p1 - p2)``. In them the heading is linear, so
that Newton's method needs one sine and cosine per quadrature node and a 2 x 2 solve; two rounds with two and with five
inner nodes end within half a centimetre of the goals that the lattice planner lays.

A *block* is a flat array of rows, one number per spiral in each row. The number of spirals is fixed when the code is
compiled: with known distances between rows the compiler proves that they do not overlap, and uses vector instructions
throughout.

References
----------
.. [1] A. Kelly and B. Nagy, "Reactive nonholonomic trajectory generation via parametric optimal control", IJRR
22(7-8), 2003.
"""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import rough_sine_cosine, sine_cosine

__all__ = ["SEGMENTS", "SPIRALS", "heading_basis", "sample_spirals", "solve_spirals", "spiral_curvature"]

SPIRALS = 16  # two vectors of eight
SEGMENTS = 8
MISSED = 0.1  # m; a spiral that ends farther from its goal than this has not been found

# Where each row of a block starts. Filled by the caller: the goals in the frame of the start (x, y, heading,
# curvature).
GOAL_X, GOAL_Y, GOAL_HEADING, GOAL_KAPPA = (SPIRALS * k for k in range(4))
# Filled by solve_spirals: the length and w.
LENGTH, W = (SPIRALS * k for k in range(4, 6))
# Filled by sample_spirals: largest and mean curvature, largest curvature rate, whether the goal was missed, and points.
MAX_KAPPA, MEAN_KAPPA, KAPPA_RATE, BROKEN = (SPIRALS * k for k in range(6, 10))
POINT_X = SPIRALS * 10
POINT_Y = POINT_X + SPIRALS * (SEGMENTS + 1)
# Work rows.
_END_COS, _END_SIN, _A1, _A2, _A3, _SUM_COS, _SUM_SIN = (POINT_Y + SPIRALS * (SEGMENTS + 1 + k) for k in range(7))
BLOCK = _SUM_SIN + SPIRALS


def heading_basis(u: float) -> tuple[float, float, float, float]:
    """Coefficients (a, c0, c3, d) of the heading at ``u``: theta = a theta_end + length (c0 p0 + c3 p3) + d w."""
    b0 = u * (1.0 + u * (-11.0 / 4.0 + u * (3.0 - 9.0 / 8.0 * u)))
    b1 = u * u * (9.0 / 2.0 + u * (-15.0 / 2.0 + 27.0 / 8.0 * u))
    b2 = u * u * (-9.0 / 4.0 + u * (6.0 - 27.0 / 8.0 * u))
    b3 = u * u * (1.0 / 2.0 + u * (-3.0 / 2.0 + 9.0 / 8.0 * u))
    return 4.0 / 3.0 * (b1 + b2), b0 - (b1 + b2) / 6.0, b3 - (b1 + b2) / 6.0, 0.5 * (b1 - b2)


# The inner nodes on [0, 1] of Lobatto's rules of four and of seven points, their weights, and the weight of each end.
_FOUR_NODES = (0.27639320225002106, 0.7236067977499789)
_FOUR_WEIGHTS = np.array([5.0 / 12.0, 5.0 / 12.0])
_FOUR_END = 1.0 / 12.0
_SEVEN_NODES = (0.08488805186071652, 0.2655756032646429, 0.5, 0.7344243967353571, 0.9151119481392835)
_SEVEN_WEIGHTS = np.array(
    [0.1384130236807830, 0.2158726906049313, 0.2438095238095238, 0.2158726906049313, 0.1384130236807830]
)
_SEVEN_END = 1.0 / 42.0

_FOUR = np.array([heading_basis(u) for u in _FOUR_NODES])
_SEVEN = np.array([heading_basis(u) for u in _SEVEN_NODES])
_SEGMENT = np.array([heading_basis(j / SEGMENTS) for j in range(1, SEGMENTS + 1)])


@kernel(forceinline=True)
def spiral_curvature(length, w, end_heading, kappa0, kappa1):  # type: ignore[no-untyped-def]
    """Coefficients (a1, a2, a3) of a solved spiral's curvature: ``kappa0 + u (a1 + u (a2 + u a3))`` at u, 1/m."""
    per_length = 1.0 / length
    total = (8.0 * end_heading * per_length - kappa0 - kappa1) * (1.0 / 3.0)  # p1 + p2
    p1 = 0.5 * (total + w * per_length)
    p2 = 0.5 * (total - w * per_length)
    a1 = -5.5 * kappa0 + 9.0 * p1 - 4.5 * p2 + kappa1
    a2 = 9.0 * kappa0 - 22.5 * p1 + 18.0 * p2 - 4.5 * kappa1
    a3 = -4.5 * kappa0 + 13.5 * p1 - 13.5 * p2 + 4.5 * kappa1
    return a1, a2, a3


@inner_kernel(forceinline=True)
def _newton_round(block, kappa0, basis, weights, end_weight):  # type: ignore[no-untyped-def]
    """Improve the lengths and w of all spirals, with the end points integrated by a rule of Lobatto.

    The heading at the ends is given, so that these nodes of the rule cost nothing.
    """
    for g in range(SPIRALS):
        length = block[LENGTH + g]
        w = block[W + g]
        along = end_weight * (1.0 + block[_END_COS + g])
        across = end_weight * block[_END_SIN + g]
        along_length = 0.0
        across_length = 0.0
        along_w = 0.0
        across_w = 0.0
        for k in range(basis.shape[0]):
            bend = basis[k, 1] * kappa0 + basis[k, 2] * block[GOAL_KAPPA + g]
            s, c = rough_sine_cosine(basis[k, 0] * block[GOAL_HEADING + g] + length * bend + basis[k, 3] * w)
            s *= weights[k]
            c *= weights[k]
            along += c
            across += s
            along_length += s * bend
            across_length += c * bend
            along_w += basis[k, 3] * s
            across_w += basis[k, 3] * c
        error_x = length * along - block[GOAL_X + g]
        error_y = length * across - block[GOAL_Y + g]
        x_length = along - length * along_length
        x_w = -length * along_w
        y_length = across + length * across_length
        y_w = length * across_w
        determinant = x_length * y_w - x_w * y_length
        per = 1.0 / (determinant if abs(determinant) > 1e-9 else 1e-9)
        # Far from the solution a full step may leave the region where the heading stays in [-pi, pi].
        step_length = (error_x * y_w - error_y * x_w) * per
        step_w = (x_length * error_y - y_length * error_x) * per
        block[LENGTH + g] = length - min(max(step_length, -0.3 * length), 0.3 * length)
        block[W + g] = w - min(max(step_w, -4.0), 4.0)


@kernel
def solve_spirals(block, kappa0):  # type: ignore[no-untyped-def]
    """Find the spirals from the origin, heading along x, to the goals of a block.

    Parameters
    ----------
    block : ndarray
        Holds the goals (m, rad in [-pi, pi], 1/m); its rows ``LENGTH`` (m) and ``W`` are overwritten.
    kappa0 : float
        Curvature at the start, 1/m.
    """
    for g in range(SPIRALS):
        x = block[GOAL_X + g]
        y = block[GOAL_Y + g]
        heading = block[GOAL_HEADING + g]
        length = np.sqrt(x * x + y * y) * (1.0 + heading * heading / 20.0)
        block[LENGTH + g] = length
        # The solution for small headings.
        bend = length * (kappa0 - block[GOAL_KAPPA + g])
        block[W + g] = (y / length - 0.5 * heading - 0.0458333333 * bend) / 0.1125
        block[_END_SIN + g], block[_END_COS + g] = rough_sine_cosine(heading)
    # What four points leave of the error is less than what one step of Newton's method does.
    _newton_round(block, kappa0, _FOUR, _FOUR_WEIGHTS, _FOUR_END)
    _newton_round(block, kappa0, _SEVEN, _SEVEN_WEIGHTS, _SEVEN_END)


@inner_kernel(forceinline=True)
def _measure_curvature(block, kappa0):  # type: ignore[no-untyped-def]
    """Fill in the coefficients of the curvature and what it is like at the ends of the segments."""
    for g in range(SPIRALS):
        length = block[LENGTH + g]
        a1, a2, a3 = spiral_curvature(length, block[W + g], block[GOAL_HEADING + g], kappa0, block[GOAL_KAPPA + g])
        largest = 0.0
        total = 0.0
        change = 0.0
        before = kappa0
        for j in range(1, SEGMENTS + 1):
            u = j / SEGMENTS
            kappa = kappa0 + u * (a1 + u * (a2 + u * a3))
            largest = max(largest, abs(kappa))
            total += abs(kappa)
            change = max(change, abs(kappa - before))
            before = kappa
        block[_A1 + g] = a1
        block[_A2 + g] = a2
        block[_A3 + g] = a3
        block[MAX_KAPPA + g] = largest
        block[MEAN_KAPPA + g] = total * (1.0 / SEGMENTS)
        block[KAPPA_RATE + g] = change * SEGMENTS / length


@kernel
def sample_spirals(block, kappa0, x0, y0, course):  # type: ignore[no-untyped-def]
    """Fill in the points of solved spirals, in the frame of the map, and what their curvature is like.

    Parameters
    ----------
    block : ndarray
        Solved by :func:`solve_spirals`; the rows after ``W`` are overwritten.
    kappa0 : float
        Curvature at the start, 1/m.
    x0, y0, course : float
        Pose of the start in the map, m and rad.
    """
    _measure_curvature(block, kappa0)
    s0, c0 = sine_cosine(course)
    for g in range(SPIRALS):
        block[POINT_X + g] = x0
        block[POINT_Y + g] = y0
        block[_SUM_COS + g] = 0.5
        block[_SUM_SIN + g] = 0.0
    for j in range(SEGMENTS):
        a = _SEGMENT[j, 0]
        b0 = _SEGMENT[j, 1]
        b3 = _SEGMENT[j, 2]
        d = _SEGMENT[j, 3]
        u = (j + 1) / SEGMENTS
        there = (j + 1) * SPIRALS
        for g in range(SPIRALS):
            length = block[LENGTH + g]
            bend = b0 * kappa0 + b3 * block[GOAL_KAPPA + g]
            s, c = rough_sine_cosine(a * block[GOAL_HEADING + g] + length * bend + d * block[W + g])
            kappa = kappa0 + u * (block[_A1 + g] + u * (block[_A2 + g] + u * block[_A3 + g]))
            sum_c = block[_SUM_COS + g] + c
            sum_s = block[_SUM_SIN + g] + s
            block[_SUM_COS + g] = sum_c
            block[_SUM_SIN + g] = sum_s
            # The trapezoid rule, with the correction for its ends that makes it exact to the fifth order of the step.
            h = length * (1.0 / SEGMENTS)
            correction = h * h * (1.0 / 12.0)
            x = h * (sum_c - 0.5 * c) + correction * s * kappa
            y = h * (sum_s - 0.5 * s) + correction * (kappa0 - c * kappa)
            block[POINT_X + there + g] = x0 + x * c0 - y * s0
            block[POINT_Y + there + g] = y0 + x * s0 + y * c0
    last = SEGMENTS * SPIRALS
    for g in range(SPIRALS):
        x = block[GOAL_X + g]
        y = block[GOAL_Y + g]
        miss_x = x0 + x * c0 - y * s0 - block[POINT_X + last + g]
        miss_y = y0 + x * s0 + y * c0 - block[POINT_Y + last + g]
        # The comparison that NaN fails, so that it counts as missed.
        block[BROKEN + g] = 0.0 if abs(miss_x) + abs(miss_y) < MISSED else 1.0
