"""The fastest speed along a closed line that the tyres, the brakes and the motor allow."""

import numpy as np

from pcs_racing.base.checks import check_number
from pcs_racing.base.compilation import compiled
from pcs_racing.base.errors import InputError

LATERAL = 5.0
"""Default limit of the lateral acceleration in m/s^2."""
BRAKING = 4.5
"""Default limit of the braking deceleration in m/s^2."""
ACCELERATION = 3.5
"""Default limit of the acceleration in m/s^2."""
TOP_SPEED = 8.0
"""Default top speed in m/s."""


def speed_profile(
    kappa: np.ndarray,
    ds: float | np.ndarray,
    *,
    lateral: float = LATERAL,
    braking: float = BRAKING,
    acceleration: float = ACCELERATION,
    top_speed: float = TOP_SPEED,
) -> np.ndarray:
    """Largest periodic speeds (m/s) along a closed line within four limits (m/s^2 and m/s), all positive.

    The usual forward-backward sweep (for instance Kapania, Subosits and Gerdes 2016, "A sequential two-step algorithm
    for fast generation of vehicle racing trajectories", without its coupling of lateral and longitudinal grip): the
    cornering speed ``sqrt(lateral / |kappa|)`` is lowered forwards where the motor can't reach it, and backwards where
    the brakes can't come down to it.

    ``kappa`` is the curvature at the samples in 1/m, and ``ds`` the distance in m from each sample to the next one
    (from the last to the first): one for all, or one for each.
    """
    limits = {"lateral": lateral, "braking": braking, "acceleration": acceleration, "top_speed": top_speed}
    for name, value in limits.items():
        check_number(name, value, above=0.0)
    kappa = np.asarray(kappa, dtype=np.float64)
    if kappa.ndim != 1 or kappa.size == 0:
        raise InputError(f"kappa has shape {kappa.shape}: one curvature for each sample of the line is needed")
    if not np.isfinite(kappa).all():
        raise InputError(f"kappa[{int(np.argmin(np.isfinite(kappa)))}] is not finite")
    steps = _steps(ds, kappa.size)
    # In squared speeds, in which constant acceleration is a straight line.
    cap = np.minimum(lateral / np.maximum(np.abs(kappa), 1e-12), top_speed**2)
    return np.sqrt(_sweep(cap, steps, acceleration, braking))


def lap_time(v: np.ndarray, ds: float | np.ndarray) -> float:
    """Time of one lap in s at speeds ``v`` (m/s, positive) at samples ``ds`` (m) apart, as for `speed_profile`.

    The acceleration is constant from each sample to the next.
    """
    v = np.asarray(v, dtype=np.float64)
    if v.ndim != 1 or v.size == 0 or not (np.isfinite(v).all() and (v > 0.0).all()):
        raise InputError("v must be a list of positive, finite speeds, one for each sample of the line")
    return float(np.sum(2.0 * _steps(ds, v.size) / (v + np.roll(v, -1))))


def _steps(ds: float | np.ndarray, n: int) -> np.ndarray:
    steps = np.asarray(ds, dtype=np.float64)
    if steps.shape not in ((), (n,)):
        raise InputError(f"ds has shape {steps.shape}: it must be one distance, or one for each of the {n} samples")
    if not (np.isfinite(steps).all() and (steps > 0.0).all()):
        raise InputError("ds holds a distance that is not positive and finite: samples must lie apart")
    return np.broadcast_to(steps, (n,)).copy()


@compiled
def _sweep(cap, ds, acceleration, braking):  # type: ignore[no-untyped-def]
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
        w[j] = min(w[j], w[i] + 2.0 * acceleration * ds[i])
    for k in range(n):
        j = (first - k) % n
        i = (j - 1) % n
        w[i] = min(w[i], w[j] + 2.0 * braking * ds[i])
    return w
