"""What a motion planner must offer to drive a car inside the compiled race.

A :class:`Planner` is two small functions and the names of its parameters. ``plan`` runs ten times a second and writes a
path; ``control`` runs fifty times a second and turns it into a target steering angle and speed (by default pure
pursuit). Both are written in the subset of Python that numba compiles and are called by their address, so that
third parties' planners run inside the same compiled, GIL-free loop as ours; a planner in plain Python gives one
function ``drive`` instead, and is called between steps of that loop. A :class:`Policy` is a planner with one vector of
parameters: a point that synthesis can move and an archive can keep.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.planners.calling import control_address, plan_address
from pcs_racing.planners.pursuit import COMMAND_SLOTS, follow_path, hold_command, leave_path


@dataclass(frozen=True)
class Parameter:
    """One number of a policy's parameter vector."""

    name: str  #: Unique within its planner.
    low: float  #: Lower bound; a policy outside the bounds is refused.
    high: float  #: Upper bound, above ``low``.
    default: float  #: The value of a sensible driver.
    meaning: str  #: What it does, with the unit ("log10 weight of ..." for weights on a log scale).

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(f"parameter {self.name!r} has bounds [{self.low}, {self.high}]; low must be below high")
        if not self.low <= self.default <= self.high:
            raise InputError(f"parameter {self.name!r} has default {self.default}, outside [{self.low}, {self.high}]")


@dataclass(frozen=True)
class Planner:
    """A family of policies: compiled driving code and the parameters that tell its members apart.

    ``track`` is a :class:`pcs_racing.track.frenet.TrackArrays`; ``view`` holds the numbers of
    :data:`pcs_racing.planners.view.VIEW`. All other arguments are float64 arrays. The functions must return nothing,
    should not raise (what one raises ends all races of the batch), and must depend on nothing but their arguments: that
    is what makes a race a value that can be saved and restored.
    """

    name: str  #: Name under which it is registered.
    parameters: tuple[Parameter, ...]  #: What ``theta`` holds, in order.
    #: ``plan(track, theta, view, memory, scratch, path) -> None``, ten times a second: writes ``path`` (12, 4).
    plan: Callable[..., None] = leave_path
    #: ``control(track, theta, view, memory, scratch, path, command) -> None``, fifty times a second: writes the target
    #: steering angle (rad) and speed (m/s).
    control: Callable[..., None] = follow_path
    #: Numbers that the planner keeps from call to call; they belong to the race's state and start at 0.
    memory_size: int = 0
    #: Numbers that it may scribble on within a call; their contents are undefined at the start of each call.
    scratch_size: int = 0
    #: For planners in plain Python: ``drive(track, theta, view, memory) -> (steer, speed)``, fifty times a second, in
    #: place of ``plan`` and ``control``. It gets the :class:`pcs_racing.Track` itself, and may keep what it remembers
    #: in ``memory`` (``memory_size`` numbers).
    drive: Callable[..., tuple[float, float]] | None = None
    #: ``candidates(track, theta, view, memory) -> (points (C, P, 2), costs (C,))`` for pictures; rejected candidates
    #: cost infinity.
    candidates: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]] | None = None
    #: Named parameter vectors beside "default", or the values in which each differs from the defaults.
    variants: Mapping[str, Any] = field(default_factory=dict, hash=False)
    #: Distance in m, counted along the track the shorter way round, beyond which ``plan`` and ``control`` do the same
    #: whatever the opponent does there. Infinite unless the planner promises it. Game trees then need not drive every
    #: pair of moves of two cars that are far apart.
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
        vectors = {name: self._vector(values) for name, values in self.variants.items()}
        object.__setattr__(self, "variants", vectors)

    def _vector(self, values: Mapping[str, float] | Sequence[float]) -> tuple[float, ...]:
        """Return a parameter vector, of which values may be given by name over the defaults."""
        if not isinstance(values, Mapping):
            return tuple(values)
        self.indices(list(values))
        return tuple(values.get(parameter.name, parameter.default) for parameter in self.parameters)

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
        """Return the addresses of the compiled ``plan`` and ``control``, which the race kernel calls."""
        plan, control = (self.plan, self.control) if self.drive is None else (leave_path, hold_command)
        return plan_address(plan), control_address(control)

    def indices(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Where parameters stand in ``theta``, by name."""
        for name in names:
            if name not in self.parameter_names:
                raise UnknownNameError(
                    f"planner {self.name!r} has no parameter {name!r}; it has {', '.join(self.parameter_names)}"
                )
        return np.array([self.parameter_names.index(name) for name in names], np.int64)

    def without(self, fixed: Sequence[str]) -> tuple[str, ...]:
        """Names of the parameters that are left when some keep their defaults."""
        self.indices(fixed)
        return tuple(name for name in self.parameter_names if name not in fixed)

    def complete(self, names: Sequence[str], values: ArrayLike) -> NDArray[np.float64]:
        """Parameter vectors (K, P) of policies of which some parameters are given; the others keep their defaults.

        ``values``, shape (K, len(names)), are those of the parameters ``names``.
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
        """Make a policy from a vector, from named values over the defaults, or from the name of a variant."""
        if parameters is None:
            parameters = "default"
        if isinstance(parameters, str):
            if parameters == "default":
                return Policy(self, self.default, name or self.name)
            if parameters not in self.variants:
                known = choices(parameters, ["default", *self.variants])
                raise UnknownNameError(f"planner {self.name!r} has no variant {parameters!r}; {known}")
            return Policy(self, np.array(self.variants[parameters]), name or f"{self.name}:{parameters}")
        if isinstance(parameters, Mapping):
            parameters = self._vector(parameters)
        return Policy(self, np.asarray(parameters, dtype=np.float64), name or self.name)


@dataclass(frozen=True, eq=False)
class Policy:
    """A planner with one parameter vector."""

    planner: Planner  #: The family it belongs to.
    parameters: NDArray[np.float64]  #: shape (P,): Its parameter vector; read-only.
    name: str  #: What tables and replays call it.

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
