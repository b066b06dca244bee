"""Lateral tyre forces by Pacejka's formula [1]_, in the single-track model [2]_.

With slip angle a and load F_z the lateral force of an axle is
``mu D F_z sin(C arctan(B a - E (B a - arctan(B a))))``. Where the formula reverses the force, which
fitted coefficients do beyond the fitted slip angles, the force is 0. Forces across the car slow it
down in a bend; the acceleration along the car takes no part of the grip.

References
----------
.. [1] H. B. Pacejka and E. Bakker, "The magic formula tyre model", Vehicle System Dynamics 21,
   1992.
.. [2] M. Althoff, M. Koschi and S. Manzinger, "CommonRoad: Composable benchmarks for motion
   planning on roads", IV 2017.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import arctangent, arctangent2, sine_cosine

GRAVITY = 9.81


class Tyres(NamedTuple):
    """Coefficients of Pacejka tyres, computed from a car's parameters.

    The stiffness of linear tyres is in :class:`pcs_racing.car.vehicle.Handling`.
    """

    b_f: float
    c_f: float
    e_f: float
    b_r: float
    c_r: float
    e_r: float
    front: float  #: mu D of the front tyres per wheelbase, 1/m.
    rear: float  #: mu D of the rear tyres per wheelbase, 1/m.
    h: float  #: Height of the centre of gravity, m.
    mass_share: float  #: Mass per yaw inertia, 1/m^2.
    substeps: float  #: Number of Runge-Kutta steps per second at 1 m/s that keeps them stable.


@kernel
def pacejka_curve(slip, b, c, e):
    """Return the lateral force at a slip angle (rad) as a share of the peak factor times load."""
    x = b * abs(slip)
    angle = c * arctangent(x - e * (x - arctangent(x)))
    sine, _ = sine_cosine(min(max(angle, 0.0), np.pi))
    return sine if slip >= 0.0 else -sine


@kernel
def pacejka_peak(c, e):
    """Return the max of :func:`pacejka_curve`, for e up to 2: below 1 for curves without a peak."""
    limit = 0.5 * np.pi
    if e >= 1.0:  # the argument has a max
        x = 1.0 / np.sqrt(max(e - 1.0, 1e-12))
        limit = arctangent(x - e * (x - arctangent(x)))
    sine, _ = sine_cosine(min(c * limit, 0.5 * np.pi))
    return sine


@inner_kernel
def substeps_of(tyres, v, dt):
    """Return the number of Runge-Kutta steps of a step at a speed of ``v`` m/s.

    The slower the car, the faster do the forces of stiff tyres change.
    """
    return 1 + int(tyres.substeps * dt / v)


@inner_kernel
def sliding_derivative(state, rate, a, lf, lr, tyres):
    """Return the right-hand side of the model with Pacejka tyres, at speeds above 0."""
    _, _, delta, v, psi, psi_dot, beta = state
    sin_beta, cos_beta = sine_cosine(beta)
    # A car that slides backwards steers the other way, and its brakes slow it down, too.
    way = 1.0 if cos_beta >= 0.0 else -1.0
    along, across = way * v * cos_beta, v * sin_beta
    front_slip = way * delta - arctangent2(across + lf * psi_dot, along)
    rear_slip = -arctangent2(across - lr * psi_dot, along)
    # Braking (a < 0) puts load on the front axle and takes it from the rear.
    front = tyres.front * max(GRAVITY * lr - a * tyres.h, 0.0)
    rear = tyres.rear * max(GRAVITY * lf + a * tyres.h, 0.0)
    front *= pacejka_curve(front_slip, tyres.b_f, tyres.c_f, tyres.e_f)
    rear *= pacejka_curve(rear_slip, tyres.b_r, tyres.c_r, tyres.e_r)
    sin_delta, cos_delta = sine_cosine(delta)
    ahead = way * a - front * sin_delta
    aside = front * cos_delta + rear
    sine, cosine = sine_cosine(psi + beta)
    return (
        v * cosine,
        v * sine,
        rate,
        ahead * cos_beta + aside * sin_beta,
        psi_dot,
        tyres.mass_share * (lf * front * cos_delta - lr * rear),
        (aside * cos_beta - ahead * sin_beta) / v - psi_dot,
    )
