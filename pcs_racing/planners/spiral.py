"""Cubic curvature spirals: smooth paths from a pose to a goal pose, curvature matched at both ends [1]_.

Along the path, u in [0, 1], the curvature is the cubic through p0, p1, p2, p3 at u = 0, 1/3, 2/3, 1. With the end
heading eliminated, two unknowns are left: the length and ``w = length (p1 - p2)``. In them the heading is linear, so
that Newton's method needs one sine and cosine per quadrature node and a 2 x 2 solve; three rounds do.

A *block* is a flat array of rows, one number per spiral in each row. The number of spirals is fixed when the code is
compiled: with known distances between rows the compiler proves that they do not overlap, and uses vector instructions
throughout.

References
----------
.. [1] A. Kelly and B. Nagy, "Reactive nonholonomic trajectory generation via parametric optimal control", IJRR
22(7-8), 2003.
"""

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import sine_cosine

__all__ = ["SEGMENTS", "SPIRALS", "heading_basis", "sample_spirals", "solve_spirals", "spiral_curvature"]

SPIRALS = 16  # two vectors of eight
SEGMENTS = 8
NEWTON_ROUNDS = 3
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
_A, _B, _C, _D, _E, _F = (POINT_Y + SPIRALS * (SEGMENTS + 1 + k) for k in range(6))
BLOCK = _F + SPIRALS

# Gauss and Legendre's rule of eight points on [0, 1], to the last bit: numpy's function finds it by LAPACK.
_NODES = np.array(
    [
        0.019855071751231884,
        0.10166676129318664,
        0.2372337950418355,
        0.4082826787521751,
        0.591717321247825,
        0.7627662049581645,
        0.8983332387068134,
        0.9801449282487681,
    ]
)
_HALF = [0.05061426814518813, 0.11119051722668724, 0.15685332293894363, 0.181341891689181]
_WEIGHTS = np.array(_HALF + _HALF[::-1])


def heading_basis(u: float) -> tuple[float, float, float, float]:
    """Coefficients (a, c0, c3, d) of the heading at ``u``: theta = a theta_end + length (c0 p0 + c3 p3) + d w."""
    b0 = u * (1.0 + u * (-11.0 / 4.0 + u * (3.0 - 9.0 / 8.0 * u)))
    b1 = u * u * (9.0 / 2.0 + u * (-15.0 / 2.0 + 27.0 / 8.0 * u))
    b2 = u * u * (-9.0 / 4.0 + u * (6.0 - 27.0 / 8.0 * u))
    b3 = u * u * (1.0 / 2.0 + u * (-3.0 / 2.0 + 9.0 / 8.0 * u))
    return 4.0 / 3.0 * (b1 + b2), b0 - (b1 + b2) / 6.0, b3 - (b1 + b2) / 6.0, 0.5 * (b1 - b2)


_BASIS = np.array([heading_basis(u) for u in _NODES])
_SEGMENT_BASIS = np.array([heading_basis(j / SEGMENTS) for j in range(1, SEGMENTS + 1)])


@kernel(inline="always")
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
    for _ in range(NEWTON_ROUNDS):
        for g in range(SPIRALS):
            block[_A + g] = 0.0
            block[_B + g] = 0.0
            block[_C + g] = 0.0
            block[_D + g] = 0.0
            block[_E + g] = 0.0
            block[_F + g] = 0.0
        for k in range(_BASIS.shape[0]):
            a = _BASIS[k, 0]
            c0 = _BASIS[k, 1]
            c3 = _BASIS[k, 2]
            d = _BASIS[k, 3]
            weight = _WEIGHTS[k]
            for g in range(SPIRALS):
                bend = c0 * kappa0 + c3 * block[GOAL_KAPPA + g]
                s, c = sine_cosine(a * block[GOAL_HEADING + g] + block[LENGTH + g] * bend + d * block[W + g])
                s *= weight
                c *= weight
                block[_A + g] += c
                block[_B + g] += s
                block[_C + g] += c * bend
                block[_D + g] += s * bend
                block[_E + g] += d * c
                block[_F + g] += d * s
        for g in range(SPIRALS):
            length = block[LENGTH + g]
            error_x = length * block[_A + g] - block[GOAL_X + g]
            error_y = length * block[_B + g] - block[GOAL_Y + g]
            x_length = block[_A + g] - length * block[_D + g]
            x_w = -length * block[_F + g]
            y_length = block[_B + g] + length * block[_C + g]
            y_w = length * block[_E + g]
            determinant = x_length * y_w - x_w * y_length
            per = 1.0 / (determinant if abs(determinant) > 1e-9 else 1e-9)
            # Far from the solution a full step may leave the region where the heading stays in [-pi, pi].
            step_length = (error_x * y_w - error_y * x_w) * per
            step_w = (x_length * error_y - y_length * error_x) * per
            block[LENGTH + g] = length - min(max(step_length, -0.3 * length), 0.3 * length)
            block[W + g] -= min(max(step_w, -4.0), 4.0)


@kernel
def _mark_missed(block):  # type: ignore[no-untyped-def]
    """Mark the spirals that Newton's method did not bring to their goal; strict arithmetic, so that NaN counts as
    missed.
    """
    last = SEGMENTS * SPIRALS
    for g in range(SPIRALS):
        miss = abs(block[POINT_X + last + g] - block[GOAL_X + g]) + abs(block[POINT_Y + last + g] - block[GOAL_Y + g])
        block[BROKEN + g] = 0.0 if miss < MISSED else 1.0


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
    for g in range(SPIRALS):
        block[POINT_X + g] = 0.0
        block[POINT_Y + g] = 0.0
        block[_A + g] = 1.0
        block[_B + g] = 0.0
        block[_C + g] = kappa0
        block[MAX_KAPPA + g] = 0.0
        block[MEAN_KAPPA + g] = 0.0
        block[KAPPA_RATE + g] = 0.0
        block[_D + g], block[_E + g], block[_F + g] = spiral_curvature(
            block[LENGTH + g], block[W + g], block[GOAL_HEADING + g], kappa0, block[GOAL_KAPPA + g]
        )
    for j in range(SEGMENTS):
        a = _SEGMENT_BASIS[j, 0]
        b0 = _SEGMENT_BASIS[j, 1]
        b3 = _SEGMENT_BASIS[j, 2]
        d = _SEGMENT_BASIS[j, 3]
        u = (j + 1) / SEGMENTS
        here = j * SPIRALS
        for g in range(SPIRALS):
            length = block[LENGTH + g]
            end = block[GOAL_HEADING + g]
            kappa1 = block[GOAL_KAPPA + g]
            kappa = kappa0 + u * (block[_D + g] + u * (block[_E + g] + u * block[_F + g]))
            s, c = sine_cosine(a * end + length * (b0 * kappa0 + b3 * kappa1) + d * block[W + g])
            h = length * (1.0 / SEGMENTS)
            before = block[_C + g]
            # Trapezoid rule with its end correction, exact to the fifth order of the step.
            bend = h * h * (1.0 / 12.0)
            block[POINT_X + SPIRALS + here + g] = (
                block[POINT_X + here + g] + 0.5 * h * (block[_A + g] + c) + bend * (s * kappa - block[_B + g] * before)
            )
            block[POINT_Y + SPIRALS + here + g] = (
                block[POINT_Y + here + g] + 0.5 * h * (block[_B + g] + s) + bend * (block[_A + g] * before - c * kappa)
            )
            block[_A + g] = c
            block[_B + g] = s
            block[_C + g] = kappa
            block[MAX_KAPPA + g] = max(block[MAX_KAPPA + g], abs(kappa))
            block[MEAN_KAPPA + g] += abs(kappa)
            block[KAPPA_RATE + g] = max(block[KAPPA_RATE + g], abs(kappa - before))
    for g in range(SPIRALS):
        block[MEAN_KAPPA + g] *= 1.0 / SEGMENTS
        block[KAPPA_RATE + g] *= SEGMENTS / block[LENGTH + g]
    _mark_missed(block)
    s0, c0 = sine_cosine(course)
    for k in range(SPIRALS * (SEGMENTS + 1)):
        x = block[POINT_X + k]
        y = block[POINT_Y + k]
        block[POINT_X + k] = x0 + x * c0 - y * s0
        block[POINT_Y + k] = y0 + x * s0 + y * c0
