"""Single-track vehicle model of CommonRoad [1]_, and controllers from commands to its inputs.

The tyres are linear, or follow Pacejka's formula (:mod:`pcs_racing.car.tyres`).

A vehicle's state is a row of seven numbers: x, y (m), steering angle delta (rad), speed v (m/s),
heading psi (rad), yaw rate psi_dot (rad/s) and slip angle beta (rad), all at the centre of gravity.
Its inputs are the steering rate (rad/s) and the longitudinal acceleration (m/s^2).

References
----------
.. [1] M. Althoff, M. Koschi and S. Manzinger, "CommonRoad: Composable benchmarks for motion
   planning on roads", IV 2017, single-track model with load transfer.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Interval, MultipleOf
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled, inner_kernel, kernel
from pcs_racing.base.elementary import arctangent, exponential, sine_cosine
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Settings, load_settings
from pcs_racing.car.tyres import (
    GRAVITY,
    Tyres,
    pacejka_peak,
    sliding_derivative,
    substeps_of,
)

# Columns of a vehicle state; X and Y share their numbers with a line of the track.
X, Y, DELTA, V, PSI, PSI_DOT, BETA = range(7)
STATE_SIZE = 7
KINEMATIC_BELOW = 0.5  # m/s; the dynamic branch divides by the speed
MAX_DECAY = 20_000.0  # m/s^2: max rate of the decay of yaw, times the speed
MAX_SPIN = 1e4  # rad/s of yaw, and rad of slip
STABLE = 2.75  # max eigenvalue times the length of a Runge-Kutta step

ControlMode = Literal["rates", "target"]

COMMAND_PERIOD = 0.02  # s between two steering commands of a race
MAX_DELAYED = 25  # commands

# Ranges of the coefficients of Pacejka's formula
_B = Interval(ge=0.1, le=100.0)
_C = Interval(ge=0.1, le=4.0)
_D = Interval(ge=0.01, le=3.0)
_E = Interval(ge=-20.0, le=2.0)

# Ranges of the sensors
_MOUNT = Interval(ge=-10.0, le=10.0)
_ERROR = Interval(ge=0.0, le=10.0)
_TURN = Interval(ge=0.0, le=1.0)


@dataclass(frozen=True)
class VehicleParams(Settings):
    """Parameters of one car; the defaults are the 1:10 F1TENTH car.

    Delays and noise of the commands, and the sensors, apply to races, with commands at 50 Hz.
    `simulate` ignores them.
    """

    #: The names of the F1TENTH gym; its two bounds of the steering are one here.
    other_names: ClassVar[Mapping[str, str]] = {
        **{
            "C_Sf": "c_sf",
            "C_Sr": "c_sr",
            "I": "inertia",
            "s_min": "steer_max",
            "s_max": "steer_max",
        },
        **{"sv_min": "steer_rate_max", "sv_max": "steer_rate_max"},
    }
    mu: Annotated[float, Interval(ge=0.01, le=10.0), "Friction coefficient."] = 1.0489
    c_sf: Annotated[
        float, Interval(ge=0.01, le=1000.0), "Cornering stiffness of the front tyres, 1/rad."
    ] = 4.718
    c_sr: Annotated[
        float, Interval(ge=0.01, le=1000.0), "Cornering stiffness of the rear tyres, 1/rad."
    ] = 5.4562
    lf: Annotated[
        float,
        Interval(ge=0.001, le=10.0),
        "Distance from the centre of gravity to the front axle, m.",
    ] = 0.15875
    lr: Annotated[
        float,
        Interval(ge=0.001, le=10.0),
        "Distance from the centre of gravity to the rear axle, m.",
    ] = 0.17145
    h: Annotated[
        float,
        Interval(ge=0.0001, le=10.0),
        "Height of the centre of gravity, m; the wheels stay on the ground.",
    ] = 0.074
    m: Annotated[float, Interval(ge=0.001, le=1e5), "Mass, kg."] = 3.74
    inertia: Annotated[
        float,
        Interval(ge=1e-6, le=1e6),
        "Yaw inertia, kg m^2; yaw settles in 0.05 ms at 1 m/s or more slowly.",
    ] = 0.04712
    steer_max: Annotated[
        float, Interval(ge=0.001, le=1.5), "Max steering angle either way, rad."
    ] = 0.4189
    steer_rate_max: Annotated[
        float, Interval(ge=0.001, le=1000.0), "Max steering rate either way, rad/s."
    ] = 3.2
    v_switch: Annotated[
        float,
        Interval(ge=0.01, le=1000.0),
        "Speed above which the engine's power, not its force, limits the acceleration, m/s.",
    ] = 7.319
    a_max: Annotated[
        float, Interval(ge=0.01, le=1000.0), "Max acceleration and braking, m/s^2."
    ] = 9.51
    v_min: Annotated[float, Interval(ge=-1000.0, le=0.0), "Lowest speed, m/s."] = -5.0
    v_max: Annotated[float, Interval(ge=0.01, le=1000.0), "Highest speed, m/s."] = 20.0
    width: Annotated[
        float,
        Interval(ge=0.001, le=100.0),
        "Width of the car's rectangle, centred on its pose, m.",
    ] = 0.31
    length: Annotated[float, Interval(ge=0.001, le=100.0), "Length of that rectangle, m."] = 0.58
    steer_delay: Annotated[
        float,
        Interval(ge=0.0, le=MAX_DELAYED * COMMAND_PERIOD),
        MultipleOf(COMMAND_PERIOD),
        "Delay of steering commands, s.",
    ] = 0.0
    steer_noise: Annotated[
        float | None,
        Interval(ge=0.0, le=0.4),
        "Standard deviation of the disturbance of every steering command, rad; None for the value"
        " of the rules.",
    ] = None
    tyres: Annotated[
        Literal["linear", "pacejka"],
        "Lateral force of the tyres: linear in the slip angle (c_sf, c_sr), without a limit, or by"
        " Pacejka's formula (b_f to e_r), with a peak of mu times d_f and d_r times the load.",
    ] = "linear"
    b_f: Annotated[float, _B, "Stiffness factor B of the front tyres."] = 6.6185
    c_f: Annotated[float, _C, "Shape factor C of the front tyres."] = 1.6102
    d_f: Annotated[float, _D, "Peak factor D of the front tyres."] = 0.652
    e_f: Annotated[float, _E, "Curvature factor E of the front tyres."] = 0.7826
    b_r: Annotated[float, _B, "Stiffness factor B of the rear tyres."] = 7.9507
    c_r: Annotated[float, _C, "Shape factor C of the rear tyres."] = 3.692
    d_r: Annotated[float, _D, "Peak factor D of the rear tyres."] = 0.6691
    e_r: Annotated[float, _E, "Curvature factor E of the rear tyres."] = 0.5595
    steer_lag: Annotated[
        float,
        Interval(ge=0.0, le=2.0),
        "Time constant of the steering servo, s; its rate limit applies to the lagged motion.",
    ] = 0.0
    speed_delay: Annotated[
        float,
        Interval(ge=0.0, le=MAX_DELAYED * COMMAND_PERIOD),
        MultipleOf(COMMAND_PERIOD),
        "Delay of speed commands, s; until the first command the car keeps its speed.",
    ] = 0.0
    speed_lag: Annotated[
        float,
        Interval(ge=0.05, le=5.0),
        "Time constant of the speed's approach to its command, s.",
    ] = 0.1
    speed_noise: Annotated[
        float,
        Interval(ge=0.0, le=5.0),
        "Standard deviation of the disturbance of every speed command, m/s; independent draws.",
    ] = 0.0
    lidar_x: Annotated[
        float,
        _MOUNT,
        "Position of the lidar, ahead of the centre of gravity, m; planners take it for 0.",
    ] = 0.0
    lidar_y: Annotated[float, _MOUNT, "Position of the lidar, to the left, m."] = 0.0
    lidar_yaw: Annotated[
        float,
        Interval(ge=-np.pi, le=np.pi),
        "Heading of the lidar minus the car's, rad; planners take it for 0.",
    ] = 0.0
    lidar_fov: Annotated[
        float,
        Interval(ge=0.0, le=2.0 * np.pi),
        "Field of view of the lidar, centred on its heading, rad; beams outside it read the max"
        " range.",
    ] = 2.0 * np.pi
    lidar_noise: Annotated[
        float, Interval(ge=0.0, le=10.0), "Standard deviation of the noise of each range, m."
    ] = 0.0
    lidar_lost: Annotated[
        float, Interval(ge=0.0, le=1.0), "Share of lost beams, which read the max range."
    ] = 0.0
    lidar_bias: Annotated[
        float, Interval(ge=-10.0, le=10.0), "Error added to each range below the max range, m."
    ] = 0.0
    lidar_step: Annotated[
        float, Interval(ge=0.0, le=10.0), "Step between two reported ranges, m; 0 for none."
    ] = 0.0
    pose_noise: Annotated[
        float,
        _ERROR,
        "Standard deviation of the error of the own x and of the own y, m; drawn for each command.",
    ] = 0.0
    pose_drift: Annotated[
        float,
        _ERROR,
        "Standard deviation of a slow error of the own x and y, m: between independent draws 4 s"
        " apart it turns from one into the next.",
    ] = 0.0
    pose_bias: Annotated[
        float,
        _ERROR,
        "Standard deviation of a constant error of the own x and y, m; drawn for each race.",
    ] = 0.0
    heading_noise: Annotated[
        float, _TURN, "Standard deviation of the error of the own heading, rad; as pose_noise."
    ] = 0.0
    heading_drift: Annotated[
        float, _TURN, "Standard deviation of a slow error of the own heading, rad; as pose_drift."
    ] = 0.0
    heading_bias: Annotated[
        float,
        _TURN,
        "Standard deviation of a constant error of the own heading, rad; as pose_bias.",
    ] = 0.0
    opponent_delay: Annotated[
        float,
        Interval(ge=0.0, le=MAX_DELAYED * COMMAND_PERIOD),
        MultipleOf(COMMAND_PERIOD),
        "Delay of the view of other cars, s; until then they are seen at their start.",
    ] = 0.0
    opponent_lost: Annotated[
        float, Interval(ge=0.0, le=1.0), "Share of the time without sight of any other car."
    ] = 0.0
    opponent_lost_time: Annotated[
        float,
        Interval(ge=COMMAND_PERIOD, le=60.0),
        "Length of the intervals, each lost with the probability opponent_lost, s.",
    ] = 0.5

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, m."""
        return self.lf + self.lr

    def as_row(self) -> NDArray[np.float64]:
        """Return the parameters as the row of numbers that compiled code reads, shape (48,)."""
        return self._row.copy()

    @cached_property
    def _row(self) -> NDArray[np.float64]:
        noise = RULES_NOISE if self.steer_noise is None else self.steer_noise
        steer_delay = round(self.steer_delay / COMMAND_PERIOD)
        speed_delay = round(self.speed_delay / COMMAND_PERIOD)
        opponent = round(self.opponent_delay / COMMAND_PERIOD), self.opponent_lost
        steering = (*_physical(self), steer_delay, noise)
        tyres = (self.tyres == "pacejka", *_pacejka(self))
        actuators = (self.steer_lag, speed_delay, self.speed_lag, self.speed_noise)
        sensors = (*_measured(self), *opponent, self.opponent_lost_time)
        return np.array([*steering, *tyres, *actuators, *sensors], dtype=np.float64)


F1TENTH = VehicleParams()

F1TENTH_PACEJKA = VehicleParams(tyres="pacejka")
"""The F1TENTH car with the Pacejka tyres of gymkhana's ``f1tenth_stp``, identified by ForzaETH's
On-Track-SysID.
"""

FORZAETH_NUC2 = VehicleParams(
    tyres="pacejka",
    mu=1.0,
    lf=0.162,
    lr=0.145,
    h=0.014,
    m=3.54,
    inertia=0.05797,
    b_f=4.798521,
    c_f=2.164028,
    d_f=0.650230,
    e_f=0.373221,
    b_r=20.0,
    c_r=1.5,
    d_r=0.618418,
    e_r=0.0,
    steer_lag=0.158,
)
"""Car NUC2 of ForzaETH's race_stack (``NUC2_pacejka.yaml``), with the F1TENTH car's limits."""

VEHICLES = {
    "f1tenth": F1TENTH,
    "f1tenth-pacejka": F1TENTH_PACEJKA,
    "forzaeth-nuc2": FORZAETH_NUC2,
}
"""Shipped cars by name."""


def load_vehicle(
    source: VehicleParams | Mapping[str, Any] | str | os.PathLike[str],
) -> VehicleParams:
    """Return a car from parameters, a mapping of changes to F1TENTH, a name of :data:`VEHICLES`, or
    a YAML file.

    Examples
    --------
    >>> load_vehicle({"mu": 0.8}).mu
    0.8
    """
    return load_settings("vehicle", F1TENTH, source, VEHICLES)


def load_vehicles(source: Any, cars: int = 2) -> tuple[VehicleParams, ...]:
    """Return a race's cars: one source of :func:`load_vehicle` for all, or a list, car 0 first."""
    if not isinstance(source, list | tuple):
        return (load_vehicle(source),) * cars
    if len(source) != max(2, cars):  # a single-car race ignores the second entry
        wanted = "both, or two" if cars <= 2 else f"all, or {cars}"
        raise ConfigError(f"vehicle lists {len(source)} cars; give one for {wanted}")
    return tuple(map(load_vehicle, source))[:cars]


# Columns of a parameter row.
(
    MU,
    C_SF,
    C_SR,
    LF,
    LR,
    H,
    M,
    INERTIA,
    STEER_MAX,
    STEER_RATE_MAX,
    V_SWITCH,
    A_MAX,
    V_MIN,
    V_MAX,
    WIDTH,
    LENGTH,
) = range(16)
STEER_DELAY = 16  # in commands
STEER_NOISE = 17  # rad; below 0: set by the race's rules
TYRES = 18  # 1: Pacejka
B_F, C_F, D_F, E_F, B_R, C_R, D_R, E_R = range(19, 27)
STEER_LAG, SPEED_DELAY, SPEED_LAG, SPEED_NOISE = range(27, 31)  # s; commands; s; m/s
(
    LIDAR_X,
    LIDAR_Y,
    LIDAR_YAW,
    LIDAR_FOV,
    LIDAR_NOISE,
    LIDAR_LOST,
    LIDAR_BIAS,
    LIDAR_STEP,
    POSE_NOISE,
    POSE_DRIFT,
    POSE_BIAS,
    HEADING_NOISE,
    HEADING_DRIFT,
    HEADING_BIAS,
    OPPONENT_DELAY,  # in commands
    OPPONENT_LOST,
    OPPONENT_LOST_TIME,
) = range(31, 48)
PARAMS_SIZE = 48
RULES_NOISE = -1.0

_physical = attrgetter(*(field.name for field in fields(VehicleParams)[:STEER_DELAY]))
_pacejka = attrgetter(*(field.name for field in fields(VehicleParams)[B_F : E_R + 1]))
_measured = attrgetter(*(field.name for field in fields(VehicleParams)[LIDAR_X : HEADING_BIAS + 1]))


def half_sizes(vehicles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return half length and half width, m, from cars' parameter rows, shape (..., 48)."""
    return 0.5 * np.asarray(vehicles)[..., [LENGTH, WIDTH]]


class Handling(NamedTuple):
    """Coefficients of the equations of motion, computed from a car's parameters.

    The tyres' stiffness times their load is ``front - front_shift a`` and ``rear + rear_shift a``
    under the longitudinal acceleration a.
    """

    steer_max: float
    steer_rate_max: float
    v_min: float
    v_max: float
    a_max: float
    v_switch: float
    lf: float
    lr: float
    front: float
    front_shift: float
    rear: float
    rear_shift: float
    yaw_gain: float
    slip_gain: float


@inner_kernel(forceinline=True)
def handling(p):
    """Compute :class:`Handling` from a row of parameters."""
    ends = p[STEER_MAX], p[STEER_RATE_MAX], p[V_MIN], p[V_MAX], p[A_MAX], p[V_SWITCH]
    # Above this height, the acceleration would lift wheels.
    h = min(p[H], GRAVITY * min(p[LF], p[LR]) / p[A_MAX])
    return handling_within(p, *ends, h, max_mass_share(p))


@inner_kernel(forceinline=True)
def handling_within(p, steer_max, steer_rate_max, v_min, v_max, a_max, v_switch, h, mass_share):
    """Compute :class:`Handling` from the first parameters of a row, up to `INERTIA`, and limits.

    ``h`` is the height of the centre of gravity; ``mass_share`` limits the mass per yaw inertia.
    """
    slip_gain = p[MU] / (p[LF] + p[LR])
    return Handling(
        steer_max,
        steer_rate_max,
        v_min,
        v_max,
        a_max,
        v_switch,
        p[LF],
        p[LR],
        p[C_SF] * GRAVITY * p[LR],
        p[C_SF] * h,
        p[C_SR] * GRAVITY * p[LF],
        p[C_SR] * h,
        min(slip_gain * p[M] / p[INERTIA], slip_gain * mass_share),
        slip_gain,
    )


@inner_kernel(forceinline=True)
def cornering_stiffness(p):
    """Return lateral force per load, friction and slip angle of front and rear tyres, 1/rad."""
    if p[TYRES] == 0.0:
        return p[C_SF], p[C_SR]
    return p[B_F] * p[C_F] * p[D_F], p[B_R] * p[C_R] * p[D_R]


@inner_kernel(forceinline=True)
def max_mass_share(p):
    """Return the max mass per yaw inertia that the model resolves, 1/m^2 (`MAX_DECAY`)."""
    front, rear = cornering_stiffness(p)
    grip = p[MU] * GRAVITY * p[LF] * p[LR] * (p[LF] * front + p[LR] * rear)
    return MAX_DECAY * (p[LF] + p[LR]) / grip


@inner_kernel
def eigenvalue(p, car, v):
    """Return the max eigenvalue of yaw rate and slip angle at small slip and a speed, 1/s."""
    front, rear = cornering_stiffness(p)
    front, rear = front * GRAVITY * car.lr, rear * GRAVITY * car.lf
    decay = car.yaw_gain * (car.lf * car.lf * front + car.lr * car.lr * rear)
    half = 0.5 * (decay + car.slip_gain * (front + rear)) / v
    turn, wheelbase = car.lr * rear - car.lf * front, (car.lf + car.lr) / v
    product = car.yaw_gain * (car.slip_gain * front * rear * wheelbase * wheelbase + turn)
    root = half * half - product
    return half + np.sqrt(root) if root > 0.0 else np.sqrt(product)


@inner_kernel
def peak_acceleration(p, braking):
    """Return the max lateral acceleration that both axles hold; infinity for linear tyres, m/s^2.

    Under the longitudinal acceleration ``braking`` (below 0, m/s^2) the rear axle holds less.
    """
    if p[TYRES] == 0.0:
        return np.inf
    front = p[D_F] * GRAVITY * pacejka_peak(p[C_F], p[E_F])
    rear = p[D_R] * (GRAVITY + braking * p[H] / p[LF]) * pacejka_peak(p[C_R], p[E_R])
    return max(p[MU] * min(front, rear), 0.1)


@inner_kernel
def tyres_of(p):
    """Compute :class:`pcs_racing.car.tyres.Tyres` from a row of parameters of Pacejka's tyres."""
    front, rear = cornering_stiffness(p)
    grip, lf, lr = p[MU] / (p[LF] + p[LR]), p[LF], p[LR]
    mass_share = min(p[M] / p[INERTIA], max_mass_share(p))
    # The sum of the model's eigenvalues times the speed, at small slip. A Runge-Kutta step is
    # stable up to 2.78 divided by the larger one.
    decay = lr * front + lf * rear + mass_share * lf * lr * (lf * front + lr * rear)
    return Tyres(
        p[B_F],
        p[C_F],
        p[E_F],
        p[B_R],
        p[C_R],
        p[E_R],
        grip * p[D_F],
        grip * p[D_R],
        p[H],
        mass_share,
        0.5 * grip * GRAVITY * decay,
    )


@inner_kernel(forceinline=True)
def _limited_acceleration(v, a, car):
    least = -car.a_max if v > car.v_min else 0.0
    most = car.a_max * (car.v_switch / v if v > car.v_switch else 1.0)
    return min(max(a, least), most if v < car.v_max else 0.0)


class State(NamedTuple):
    """State of a vehicle, or its derivative, in the units of the module."""

    x: float
    y: float
    delta: float
    v: float
    psi: float
    psi_dot: float
    beta: float


@inner_kernel
def _kinematic_derivative(state, rate, a, lr, wheelbase):
    """Return the right-hand side of the model at low speed, with tyres rolling without slip."""
    v = state.v
    sin_delta, cos_delta = sine_cosine(state.delta)
    tan_delta = sin_delta / cos_delta
    slip = arctangent(tan_delta * lr / wheelbase)
    slip_dot = lr * rate / (wheelbase * cos_delta**2 * (1.0 + (tan_delta * lr / wheelbase) ** 2))
    _, cos_slip = sine_cosine(slip)
    yaw = v * cos_slip * tan_delta / wheelbase
    sin_beta, cos_beta = sine_cosine(state.beta)
    yaw_dot = (
        a * cos_beta * tan_delta
        - v * sin_beta * slip_dot * tan_delta
        + v * cos_beta * rate / cos_delta**2
    ) / wheelbase
    sine, cosine = sine_cosine(state.psi + slip)
    return v * cosine, v * sine, rate, a, yaw, yaw_dot, slip_dot


@inner_kernel(forceinline=True)
def derivative(state, rate, acceleration, car, tyres, rolls_below):
    """Return the right-hand side of the model, the derivative of a :class:`State`.

    ``tyres`` are None for linear tyres. Below the speed ``rolls_below`` (m/s) tyres roll without
    slip.
    """
    delta, v, psi_dot, beta = state.delta, state.v, state.psi_dot, state.beta
    least = -car.steer_rate_max if delta > -car.steer_max else 0.0
    rate = min(max(rate, least), car.steer_rate_max if delta < car.steer_max else 0.0)
    a = _limited_acceleration(v, acceleration, car)
    if v < rolls_below:
        return State(*_kinematic_derivative(state, rate, a, car.lr, car.lf + car.lr))
    if tyres is not None:
        return State(*sliding_derivative(state, rate, a, car.lf, car.lr, tyres))
    # Braking (a < 0) puts load on the front axle and takes it from the rear.
    front = car.front - car.front_shift * a
    rear = car.rear + car.rear_shift * a
    front_moment = car.lf * front
    rear_moment = car.lr * rear
    turn = rear_moment - front_moment
    # One division instead of two: it is the slowest of these operations.
    per_v = 1.0 / v
    turned = psi_dot * per_v
    yaw_dot = car.yaw_gain * (
        front_moment * delta + turn * beta - (car.lf * front_moment + car.lr * rear_moment) * turned
    )
    beta_dot = (
        car.slip_gain * per_v * (front * delta - (rear + front) * beta + turn * turned) - psi_dot
    )
    sine, cosine = sine_cosine(state.psi + beta)
    return State(v * cosine, v * sine, rate, a, psi_dot, yaw_dot, beta_dot)


@inner_kernel(forceinline=True)
def _moved(state, change, dt):
    """Return a state after ``dt`` s with a constant derivative."""
    return State(
        state.x + dt * change.x,
        state.y + dt * change.y,
        state.delta + dt * change.delta,
        state.v + dt * change.v,
        state.psi + dt * change.psi,
        state.psi_dot + dt * change.psi_dot,
        state.beta + dt * change.beta,
    )


@inner_kernel(forceinline=True)
def _bounded(turn):
    """Return a yaw rate or slip angle within `MAX_SPIN`: without grip it would grow for ever."""
    return min(max(turn, -MAX_SPIN), MAX_SPIN)


@kernel(forceinline=True)
def runge_kutta(state, rate, acceleration, car, tyres, dt, rolls_below):
    """Return a car's :class:`State` after a classic Runge-Kutta step of ``dt`` s.

    Steering rate (rad/s) and longitudinal acceleration (m/s^2) are constant, and limited inside the
    derivative, in all four stages. With ``rolls_below`` ``-np.inf`` and no ``tyres`` there is no
    branch, so that loops over many cars use vector instructions.
    """
    a = derivative(state, rate, acceleration, car, tyres, rolls_below)
    b = derivative(_moved(state, a, 0.5 * dt), rate, acceleration, car, tyres, rolls_below)
    c = derivative(_moved(state, b, 0.5 * dt), rate, acceleration, car, tyres, rolls_below)
    d = derivative(_moved(state, c, dt), rate, acceleration, car, tyres, rolls_below)
    w = dt / 6.0
    psi = state.psi + w * (a.psi + 2.0 * b.psi + 2.0 * c.psi + d.psi)
    return State(
        state.x + w * (a.x + 2.0 * b.x + 2.0 * c.x + d.x),
        state.y + w * (a.y + 2.0 * b.y + 2.0 * c.y + d.y),
        state.delta + w * (a.delta + 2.0 * b.delta + 2.0 * c.delta + d.delta),
        state.v + w * (a.v + 2.0 * b.v + 2.0 * c.v + d.v),
        # Into [0, 2 pi): sines are exact for moderate angles only.
        psi - 2.0 * np.pi * np.floor(psi * (0.5 / np.pi)),
        _bounded(state.psi_dot + w * (a.psi_dot + 2.0 * b.psi_dot + 2.0 * c.psi_dot + d.psi_dot)),
        _bounded(state.beta + w * (a.beta + 2.0 * b.beta + 2.0 * c.beta + d.beta)),
    )


@inner_kernel(forceinline=True)
def state_of(row):
    """Return the :class:`State` of a row of numbers."""
    return State(row[X], row[Y], row[DELTA], row[V], row[PSI], row[PSI_DOT], row[BETA])


@inner_kernel
def _move(state, rate, acceleration, car, tyres, dt):
    """Advance a row of a state in place by `runge_kutta`."""
    before = State(state[0], state[1], state[2], state[3], state[4], state[5], state[6])
    after = runge_kutta(before, rate, acceleration, car, tyres, dt, KINEMATIC_BELOW)
    for k in range(STATE_SIZE):
        state[k] = after[k]


@inner_kernel
def step_linear(state, rate, acceleration, p, car, dt):
    """Advance one vehicle with linear tyres like `step`."""
    decay = dt * eigenvalue(p, car, max(state[V] - dt * car.a_max, KINEMATIC_BELOW))
    # The loads vary up to twofold with the acceleration.
    count = 1 if decay <= STABLE else 1 + int(2.0 / STABLE * decay)
    for _ in range(count):
        _move(state, rate, acceleration, car, None, dt / count)


@kernel
def step(state, rate, acceleration, p, dt):
    """Advance one vehicle with parameter row ``p`` in place by one step (`runge_kutta`).

    The inputs are constant within the step.
    """
    car = handling(p)
    if p[TYRES] == 0.0:
        step_linear(state, rate, acceleration, p, car, dt)
        return
    tyres = tyres_of(p)
    count = substeps_of(tyres, max(state[V], KINEMATIC_BELOW), dt)
    count = max(count, 1 + int(dt * eigenvalue(p, car, np.inf)))
    for _ in range(count):
        _move(state, rate, acceleration, car, tyres, dt / count)
    if state[V] < KINEMATIC_BELOW:
        _roll(state, car)


@inner_kernel
def _roll(state, car):
    """Set yaw rate and slip angle of a slow car to the values of rolling without slip.

    A car that has spun moves on along its wheels.
    """
    sin_delta, cos_delta = sine_cosine(state[DELTA])
    turn = sin_delta / cos_delta / (car.lf + car.lr)
    state[BETA] = arctangent(turn * car.lr)
    _, cos_beta = sine_cosine(state[BETA])
    state[PSI_DOT] = state[V] * cos_beta * turn


class Actuators(NamedTuple):
    """Coefficients of the controllers of steering and speed, for one length of the step."""

    share: float  #: Share of the missing steering angle that the servo moves in a step.
    gain: float  #: Acceleration per missing speed, 1/s.


@inner_kernel
def actuators(p, dt):
    """Compute :class:`Actuators` from a row of parameters."""
    lag = p[STEER_LAG]
    return Actuators(1.0 - exponential(-dt / lag) if lag > 0.0 else 1.0, 1.0 / p[SPEED_LAG])


@inner_kernel(forceinline=True)
def target_inputs(delta, v, steer, speed, car, actuators, dt):
    """Return inputs that reach a target steering angle and speed without chatter or overshoot.

    The steering moves at its full rate and arrives exactly; with a lag it covers the same share of
    the missing angle in every step of ``dt`` s, and no more than its full rate. The speed error
    decays with its time constant, within the limits of the engine and the brakes.
    """
    steer = min(max(steer, -car.steer_max), car.steer_max)
    rate = actuators.share * (steer - delta) / dt
    rate = min(max(rate, -car.steer_rate_max), car.steer_rate_max)
    return rate, _limited_acceleration(v, actuators.gain * (speed - v), car)


@inner_kernel
def step_to_target(state, steer, speed, p, dt):
    """Advance one vehicle in place by one step towards a target steering angle (rad) and speed
    (m/s).
    """
    rate, acceleration = target_inputs(
        state[DELTA], state[V], steer, speed, handling(p), actuators(p, dt), dt
    )
    step(state, rate, acceleration, p, dt)


_MODES: dict[str, int] = {"rates": 0, "target": 1}


@compiled
def _simulate(states, controls, mode, dt, params):
    for b in range(states.shape[0]):
        p = params[b]
        for k in range(controls.shape[1]):
            # Advanced in place in the next row, without allocating a state.
            states[b, k + 1] = states[b, k]
            state = states[b, k + 1]
            first = controls[b, k, 0]
            second = controls[b, k, 1]
            if mode == 1:
                first, second = target_inputs(
                    state[DELTA], state[V], first, second, handling(p), actuators(p, dt), dt
                )
            step(state, first, second, p, dt)


def simulate(
    initial_state: ArrayLike,
    controls: ArrayLike,
    *,
    control_mode: ControlMode = "target",
    dt: float = 0.01,
    params: VehicleParams | list[VehicleParams] = F1TENTH,
) -> NDArray[np.float64]:
    """Simulate one vehicle, or a batch of vehicles, with given controls, and return all states.

    Parameters
    ----------
    initial_state : array_like, shape (7,) or (B, 7)
        x, y (m), delta (rad), v (m/s), psi (rad), psi_dot (rad/s), beta (rad).
    controls : array_like, shape (T, 2) or (B, T, 2)
        ``"rates"``: steering rate (rad/s) and acceleration (m/s^2). ``"target"``: steering angle
        (rad), reached at full rate without overshoot, and speed (m/s), both with the car's lags.
    control_mode : {"target", "rates"}
    dt : float
        Length of a step in s, in (0, 0.05].
    params : VehicleParams or list of B VehicleParams
        One set for all vehicles, or one set for each.

    Returns
    -------
    ndarray, shape (T + 1, 7) or (B, T + 1, 7)
        States, with the initial state first; psi is wrapped to [0, 2 pi) after each step.

    Examples
    --------
    >>> import numpy as np
    >>> states = simulate(np.zeros(7), np.tile([0.1, 2.0], (100, 1)))
    >>> states.shape
    (101, 7)
    """
    initial = np.asarray(initial_state, dtype=np.float64)
    commands = np.asarray(controls, dtype=np.float64)
    if control_mode not in _MODES:
        raise InputError(f"control_mode is {control_mode!r}; it must be one of {', '.join(_MODES)}")
    if initial.ndim not in (1, 2) or initial.shape[-1] != STATE_SIZE:
        raise InputError(f"initial_state has shape {initial.shape}; it must be (7,) or (B, 7)")
    if (
        commands.ndim != initial.ndim + 1
        or commands.shape[-1] != 2
        or commands.shape[:-2] != initial.shape[:-1]
    ):
        raise InputError(
            f"controls have shape {commands.shape}; for initial_state of shape {initial.shape} they"
            f" must be {(*initial.shape[:-1], 'T', 2)}"
        )
    if not np.isfinite(initial).all() or not np.isfinite(commands).all():
        raise InputError("initial_state and controls must be finite; found NaN or infinity")
    if not 0.0 < dt <= 0.05:
        raise InputError(f"dt is {dt!r}; it must be above 0 and at most 0.05 s")
    batch = np.atleast_2d(initial)
    rows = [params] * len(batch) if isinstance(params, VehicleParams) else list(params)
    if len(rows) != len(batch):
        raise InputError(
            f"params holds {len(rows)} sets for {len(batch)} vehicles; give one set, or one for"
            " each"
        )
    states = np.empty((len(batch), commands.shape[-2] + 1, STATE_SIZE))
    states[:, 0] = batch
    _simulate(
        states,
        np.ascontiguousarray(commands.reshape(len(batch), -1, 2)),
        _MODES[control_mode],
        dt,
        np.array([row.as_row() for row in rows]).reshape(len(batch), PARAMS_SIZE),
    )
    return states.reshape(*initial.shape[:-1], -1, STATE_SIZE)
