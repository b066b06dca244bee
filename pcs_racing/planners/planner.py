"""What a motion planner must offer to drive a car inside the compiled race.

A :class:`Planner` is two small functions and the names of its parameters. ``plan`` runs ten times a second and writes a
path; ``control`` runs fifty times a second and turns it into a target steering angle and speed (by default pure
pursuit). Both are written in the subset of Python that numba compiles and are called through function pointers, so that
third parties' planners run inside the same compiled, GIL-free loop as ours; a planner in plain Python gives one
function ``drive`` instead, and is called between steps of that loop. A :class:`Policy` is a planner with one vector of
parameters: a point that synthesis can move and an archive can keep.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numba import cfunc, types
from numba.core import config
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import arctangent, sine_cosine
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.track.frenet import TrackArrays

__all__ = [
    "PATH_POINTS",
    "VIEW",
    "VIEW_SIZE",
    "Parameter",
    "Planner",
    "Policy",
    "calm_speed",
    "follow_path",
    "hold_command",
    "leave_path",
    "pursuit_steering",
]

VIEW: dict[str, str] = {
    "TIME": "time since the start of the race, s",
    "X": "own position, m",
    "Y": "own position, m",
    "DELTA": "own steering angle, rad",
    "V": "own speed, m/s",
    "PSI": "own heading, rad",
    "PSI_DOT": "own yaw rate, rad/s",
    "BETA": "own slip angle, rad; the car moves along PSI + BETA",
    "S": "own arc length on the race line, m",
    "D": "own distance from the race line, m, positive to the left",
    "OPP_X": "opponent's position, m",
    "OPP_Y": "opponent's position, m",
    "OPP_V": "opponent's speed, m/s",
    "OPP_PSI": "opponent's heading, rad",
    "OPP_BETA": "opponent's slip angle, rad",
    "OPP_S": "opponent's arc length on the race line, m",
    "OPP_D": "opponent's distance from the race line, m",
    "OPP_D_DOT": "how fast that distance grows, m/s",
    "GAP": "opponent's progress minus own, m; positive when the opponent leads",
    "LENGTH": "own car's length, m",
    "WIDTH": "own car's width, m",
    "WHEELBASE": "own wheelbase, m",
    "STEER_MAX": "own largest steering angle, rad",
    "UNDERSTEER": "extra steering that the own car needs per lateral acceleration, rad s^2/m",
    "UNDERSTEER_GAIN": "how that grows with the longitudinal acceleration, rad s^4/m^2",
    "OPP_LENGTH": "opponent's length, m",
    "OPP_WIDTH": "opponent's width, m",
    "SPEED_LOW": "speed scale that stands for pace 0 in this race",
    "SPEED_HIGH": "speed scale that stands for pace 1 in this race",
}
"""Every element of the view that a planner gets, by name, with its meaning and unit; their order is their index."""

VIEW_SIZE = len(VIEW)
(
    TIME,
    OWN_X,
    OWN_Y,
    OWN_DELTA,
    OWN_V,
    OWN_PSI,
    OWN_PSI_DOT,
    OWN_BETA,
    OWN_S,
    OWN_D,
    OPP_X,
    OPP_Y,
    OPP_V,
    OPP_PSI,
    OPP_BETA,
    OPP_S,
    OPP_D,
    OPP_D_DOT,
    GAP,
    OWN_LENGTH,
    OWN_WIDTH,
    WHEELBASE,
    STEER_MAX,
    UNDERSTEER,
    UNDERSTEER_GAIN,
    OPP_LENGTH,
    OPP_WIDTH,
    SPEED_LOW,
    SPEED_HIGH,
) = range(VIEW_SIZE)

PATH_POINTS = 12
"""Points of a planned path: rows of x, y (m), speed (m/s) and curvature (1/m)."""

COMMAND_SLOTS = 2  # memory that :func:`hold_command` reads: steering angle and speed

BRAKING = 5.5
"""Braking that :func:`follow_path` asks for at most, m/s^2."""

PATH_X, PATH_Y, PATH_SPEED, PATH_KAPPA = range(4)
PATH_COLUMNS = 4

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
_TRACK = types.NamedTuple(
    (
        types.float64,  # length
        types.float64,  # ds
        _MATRIX,  # line
        types.Array(types.float32, 2, "C"),  # distance
        types.float64,  # origin_x
        types.float64,  # origin_y
        types.float64,  # cell
        _MATRIX,  # walls
        types.Array(types.int32, 1, "C"),  # seen_start
        types.Array(types.int32, 1, "C"),  # seen
        types.Array(types.float32, 1, "C"),  # seen_distance
        _MATRIX,  # seen_middle
        types.float64,  # seen_stretch
        types.Array(types.int32, 2, "C"),  # lookup
        types.float64,  # lookup_cell
    ),
    TrackArrays,
)
# (track, theta, view, memory, scratch, path) and the same with the command to write
_PLAN_SIGNATURE = types.void(_TRACK, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX)
_CONTROL_SIGNATURE = types.void(_TRACK, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _VECTOR)


@cache
def _pointer(function: Callable[..., None], signature: types.Type) -> Any:
    """Compile a planner's function behind the one signature that the race kernel calls."""
    python = getattr(function, "py_func", function)
    if getattr(config, "DISABLE_JIT", 0):  # then the kernel that calls it is an ordinary function, too
        return python
    compile_pointer: Any = cfunc
    options: dict[str, Any] = {"cache": True, "error_model": "numpy"}
    try:  # without reference counts where the function allocates nothing: see pcs_racing.base.compilation.kernel
        return compile_pointer(signature, **options, _nrt=False)(python)
    except (RuntimeError, NumbaError):
        return compile_pointer(signature, **options)(python)


@kernel
def leave_path(track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    """Plan nothing: for drivers that decide everything in ``control``."""


@kernel
def hold_command(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
    """Drive as the first two numbers of the memory say: how commands from outside reach a car."""
    command[0] = memory[0]
    command[1] = memory[1]


@kernel(forceinline=True)
def pursuit_steering(view, x, y, kappa, acceleration):  # type: ignore[no-untyped-def]
    """Steering angle of pure pursuit towards a point.

    The arc starts along the car's velocity (heading plus slip). The car's understeer makes up for the slip of the tyres
    in steady cornering; under braking the load shifts to the front and it turns into oversteer.

    Parameters
    ----------
    view : ndarray
        The driver's view.
    x, y : float
        Point to drive through, m.
    kappa : float
        Curvature of the path there, 1/m.
    acceleration : float
        Longitudinal acceleration that the driver is about to ask for, m/s^2.
    """
    course = view[OWN_PSI] + view[OWN_BETA]
    dx = x - view[OWN_X]
    dy = y - view[OWN_Y]
    sine, cosine = sine_cosine(course)
    across = -dx * sine + dy * cosine
    arc = 2.0 * across / max(dx * dx + dy * dy, 1e-6)
    understeer = view[UNDERSTEER] + view[UNDERSTEER_GAIN] * acceleration
    steer = arctangent(view[WHEELBASE] * arc) + understeer * view[OWN_V] * view[OWN_V] * kappa
    return min(max(steer, -view[STEER_MAX]), view[STEER_MAX])


@kernel(forceinline=True)
def calm_speed(v, speed):  # type: ignore[no-untyped-def]
    """Target speed that asks for no more braking than the car stays stable under, and the acceleration it stands for.

    The controller brakes by 10 times the speed error; beyond about 6 m/s^2 the unloaded rear axle lets go.
    """
    speed = max(speed, v - 0.1 * BRAKING)
    return speed, min(10.0 * (speed - v), 9.5)


@kernel(forceinline=True)
def _share_of_gap(before, after, distance):  # type: ignore[no-untyped-def]
    """How far between two points a distance from the car is reached, in [0, 1], from the squares of their distances."""
    before = np.sqrt(before)
    return min(max((distance - before) / max(np.sqrt(after) - before, 1e-9), 0.0), 1.0)


@kernel
def follow_path(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
    """Follow the planned path by pure pursuit (the default ``control``).

    The look-ahead grows from 0.3 m by 0.1 m per m/s; the speed is the path's at the point reached in a tenth of a
    second.
    """
    x = view[OWN_X]
    y = view[OWN_Y]
    v = view[OWN_V]
    last = path.shape[0] - 1
    # The path starts where the car was when it planned; skip what lies behind by now.
    i = 0
    near = (path[0, PATH_X] - x) ** 2 + (path[0, PATH_Y] - y) ** 2
    while i < last:
        there = (path[i + 1, PATH_X] - x) ** 2 + (path[i + 1, PATH_Y] - y) ** 2
        if there > near:
            break
        near = there
        i += 1
    reach = 0.3 + 0.1 * v
    preview = 0.1 * v
    goal_x = path[last, PATH_X]
    goal_y = path[last, PATH_Y]
    kappa = path[last, PATH_KAPPA]
    speed = path[last, PATH_SPEED]
    speed_found = False
    before = near
    for j in range(i, last):
        after = (path[j + 1, PATH_X] - x) ** 2 + (path[j + 1, PATH_Y] - y) ** 2
        if not speed_found and after >= preview * preview:
            w = _share_of_gap(before, after, preview)
            speed = path[j, PATH_SPEED] + w * (path[j + 1, PATH_SPEED] - path[j, PATH_SPEED])
            speed_found = True
        if after >= reach * reach:
            w = _share_of_gap(before, after, reach)
            goal_x = path[j, PATH_X] + w * (path[j + 1, PATH_X] - path[j, PATH_X])
            goal_y = path[j, PATH_Y] + w * (path[j + 1, PATH_Y] - path[j, PATH_Y])
            kappa = path[j, PATH_KAPPA]
            break
        before = after
    speed, acceleration = calm_speed(v, speed)
    command[0] = pursuit_steering(view, goal_x, goal_y, kappa, acceleration)
    command[1] = speed


@dataclass(frozen=True)
class Parameter:
    """One number of a policy's parameter vector.

    Attributes
    ----------
    name : str
        Unique within its planner.
    low, high : float
        Bounds, ``low < high``; a policy outside them is refused.
    default : float
        The value of a sensible driver.
    meaning : str
        What it does, with the unit ("log10 weight of ..." for weights on a log scale).
    """

    name: str
    low: float
    high: float
    default: float
    meaning: str

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(f"parameter {self.name!r} has bounds [{self.low}, {self.high}]; low must be below high")
        if not self.low <= self.default <= self.high:
            raise InputError(f"parameter {self.name!r} has default {self.default}, outside [{self.low}, {self.high}]")


@dataclass(frozen=True)
class Planner:
    """A family of policies: compiled driving code and the parameters that tell its members apart.

    Attributes
    ----------
    name : str
        Name under which it is registered.
    parameters : tuple of Parameter
        What ``theta`` holds, in order.
    plan : callable
        ``plan(track, theta, view, memory, scratch, path) -> None``, ten times a second: writes ``path`` (12, 4).
    control : callable
        ``control(track, theta, view, memory, scratch, path, command) -> None``, fifty times a second: writes the target
        steering angle (rad) and speed (m/s).
    memory_size : int
        Numbers that the planner keeps from call to call; they belong to the race's state and start at 0.
    scratch_size : int
        Numbers that it may scribble on within a call; their contents are undefined at the start of each call.
    drive : callable or None
        For planners in plain Python: ``drive(track, theta, view, memory) -> (steer, speed)``, fifty times a second, in
        place of ``plan`` and ``control``. It gets the :class:`pcs_racing.Track` itself, and may keep what it remembers
        in ``memory`` (``memory_size`` numbers).
    candidates : callable or None
        ``candidates(track, theta, view, memory) -> (points (C, P, 2), costs (C,))`` for pictures; rejected candidates
        cost infinity.
    variants : Mapping of str to array
        Named parameter vectors beside "default".
    sight : float
        Distance in m, counted along the track the shorter way round, beyond which ``plan`` and ``control`` do the same
        whatever the opponent does there. Infinite unless the planner promises it. Game trees then need not drive every
        pair of moves of two cars that are far apart.

    Notes
    -----
    ``track`` is a :class:`pcs_racing.track.frenet.TrackArrays`; ``view`` holds the numbers of :data:`VIEW`. All other
    arguments are float64 arrays. The functions must not raise, and must depend on nothing but their arguments: that is
    what makes a race a value that can be saved and restored.
    """

    name: str
    parameters: tuple[Parameter, ...]
    plan: Callable[..., None] = leave_path
    control: Callable[..., None] = follow_path
    memory_size: int = 0
    scratch_size: int = 0
    drive: Callable[..., tuple[float, float]] | None = None
    candidates: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]] | None = None
    variants: Mapping[str, tuple[float, ...]] = field(default_factory=dict, hash=False)
    sight: float = float("inf")

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise InputError(f"planner {self.name!r} names a parameter twice: {', '.join(names)}")
        for what, size in (("memory_size", self.memory_size), ("scratch_size", self.scratch_size)):
            if size < 0:
                raise InputError(f"planner {self.name!r} has {what} {size}; it must be 0 or above")
        if not self.sight >= 0.0:
            raise InputError(f"planner {self.name!r} has sight {self.sight}; it must be 0 or above")

    @property
    def memory_total(self) -> int:
        """Numbers of memory that the race's state must hold: the planner's own, and the command of a Python driver."""
        return self.memory_size + (COMMAND_SLOTS if self.drive is not None else 0)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of ``theta``."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper bounds, shape (P, 2)."""
        return np.array([(p.low, p.high) for p in self.parameters], dtype=np.float64).reshape(-1, 2)

    @property
    def default(self) -> NDArray[np.float64]:
        """Parameter vector of the sensible driver, shape (P,)."""
        return np.array([p.default for p in self.parameters], dtype=np.float64)

    def pointers(self) -> tuple[Any, Any]:
        """Return the compiled ``plan`` and ``control`` behind the race kernel's two signatures."""
        if self.drive is not None:
            return _pointer(leave_path, _PLAN_SIGNATURE), _pointer(hold_command, _CONTROL_SIGNATURE)
        return _pointer(self.plan, _PLAN_SIGNATURE), _pointer(self.control, _CONTROL_SIGNATURE)

    def indices(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Where parameters stand in ``theta``, by name.

        Raises
        ------
        UnknownNameError
            If a name is none of the planner's parameters.
        """
        for name in names:
            if name not in self.parameter_names:
                raise UnknownNameError(
                    f"planner {self.name!r} has no parameter {name!r}; it has {', '.join(self.parameter_names)}"
                )
        return np.array([self.parameter_names.index(name) for name in names], np.int64)

    def without(self, fixed: Sequence[str]) -> tuple[str, ...]:
        """Names of the parameters that are left when some keep their defaults.

        Raises
        ------
        UnknownNameError
            If a name is none of the planner's parameters.
        """
        self.indices(fixed)
        return tuple(name for name in self.parameter_names if name not in fixed)

    def complete(self, names: Sequence[str], values: ArrayLike) -> NDArray[np.float64]:
        """Parameter vectors of policies of which some parameters are given; the others keep their defaults.

        Parameters
        ----------
        names : sequence of str
            The parameters that are given.
        values : array_like, shape (K, len(names))

        Returns
        -------
        ndarray, shape (K, P)

        Raises
        ------
        UnknownNameError
            If a name is none of the planner's parameters.
        """
        given = np.asarray(values, np.float64)
        theta = np.tile(self.default, (len(given), 1))
        theta[:, self.indices(names)] = given
        return theta

    def sample(self, rng: np.random.Generator, fixed: Sequence[str] = ()) -> NDArray[np.float64]:
        """Draw a parameter vector uniformly between the bounds, shape (P,).

        Nothing is drawn for the parameters in ``fixed``, which keep their defaults.
        """
        names = self.without(fixed)
        bounds = self.bounds[self.indices(names)]
        return self.complete(names, rng.uniform(bounds[:, 0], bounds[:, 1])[None])[0]

    def policy(
        self, parameters: ArrayLike | Mapping[str, float] | str | None = None, name: str | None = None
    ) -> "Policy":
        """Make a policy from a vector, from named values over the defaults, or from the name of a variant.

        Raises
        ------
        InputError
            If a value is not finite or outside its bounds, or if there are too few or too many.
        UnknownNameError
            If a name is none of the planner's parameters or variants.
        """
        if parameters is None:
            parameters = "default"
        if isinstance(parameters, str):
            if parameters == "default":
                return Policy(self, self.default, name or self.name)
            if parameters not in self.variants:
                raise UnknownNameError(
                    f"planner {self.name!r} has no variant {parameters!r}; it has "
                    f"{', '.join(['default', *self.variants])}"
                )
            return Policy(self, np.array(self.variants[parameters]), name or f"{self.name}:{parameters}")
        if isinstance(parameters, Mapping):
            theta = self.default
            for key, value in parameters.items():
                if key not in self.parameter_names:
                    raise UnknownNameError(
                        f"planner {self.name!r} has no parameter {key!r}; it has {', '.join(self.parameter_names)}"
                    )
                theta[self.parameter_names.index(key)] = value
            parameters = theta
        return Policy(self, np.asarray(parameters, dtype=np.float64), name or self.name)


@dataclass(frozen=True, eq=False)
class Policy:
    """A planner with one parameter vector.

    Attributes
    ----------
    planner : Planner
        The family it belongs to.
    parameters : ndarray, shape (P,)
        Its parameter vector; read-only.
    name : str
        What tables and replays call it.
    """

    planner: Planner
    parameters: NDArray[np.float64]
    name: str

    def __post_init__(self) -> None:
        theta = np.array(self.parameters, dtype=np.float64)
        expected = len(self.planner.parameters)
        if theta.shape != (expected,):
            raise InputError(
                f"policy {self.name!r} has parameters of shape {theta.shape}; planner {self.planner.name!r} takes "
                f"({expected},)"
            )
        for parameter, value in zip(self.planner.parameters, theta, strict=True):
            if not np.isfinite(value):
                raise InputError(f"policy {self.name!r}: parameter {parameter.name!r} is {value}; it must be finite")
            slack = 1e-9 * (parameter.high - parameter.low)
            if not parameter.low - slack <= value <= parameter.high + slack:
                raise InputError(
                    f"policy {self.name!r}: parameter {parameter.name!r} is {value:g}; it must lie in "
                    f"[{parameter.low:g}, {parameter.high:g}]"
                )
        theta.setflags(write=False)
        object.__setattr__(self, "parameters", theta)
