"""The fastest speed along a closed line that the tyres, the brakes and the motor allow."""

import numpy as np

from pcs_racing.base.compilation import compiled

LATERAL = 5.0  # most lateral acceleration, m/s^2
BRAKING = 4.5  # m/s^2
ACCELERATION = 3.5  # m/s^2
TOP_SPEED = 8.0  # m/s


def speed_profile(kappa: np.ndarray, ds: float) -> np.ndarray:
    """Largest periodic speeds (m/s) within the four limits, at samples of a closed line ``ds`` metres apart.

    The usual forward-backward sweep (for instance Kapania, Subosits and Gerdes 2016, "A sequential two-step algorithm
    for fast generation of vehicle racing trajectories", without its coupling of lateral and longitudinal grip): the
    cornering speed ``sqrt(LATERAL / |kappa|)`` (curvature in 1/m) is lowered forwards where the motor can't reach it,
    and backwards where the brakes can't come down to it.
    """
    # In squared speeds, in which constant acceleration is a straight line.
    cap = np.minimum(LATERAL / np.maximum(np.abs(kappa), 1e-12), TOP_SPEED**2)
    return np.sqrt(_sweep(cap, ds))


def lap_time(v: np.ndarray, ds: float) -> float:
    """Time of one lap in s, at constant acceleration between samples ``ds`` metres apart with speeds ``v`` (m/s)."""
    return float(np.sum(2.0 * ds / (v + np.roll(v, -1))))


@compiled
def _sweep(cap, ds):  # type: ignore[no-untyped-def]
    """Squared speeds below ``cap`` that also respect acceleration and braking.

    The slowest sample is never lowered (all its neighbours are at least as fast), so one lap forwards and one lap
    backwards from there are exact, and periodic.
    """
    n = cap.shape[0]
    w = cap.copy()
    first = np.argmin(cap)
    for k in range(n):
        i = (first + k) % n
        j = (i + 1) % n
        w[j] = min(w[j], w[i] + 2.0 * ACCELERATION * ds)
    for k in range(n):
        j = (first - k) % n
        i = (j - 1) % n
        w[i] = min(w[i], w[j] + 2.0 * BRAKING * ds)
    return w
