"""Interface of a motion planner that drives a car inside the compiled race.

A :class:`Planner` is two small functions and the names of its parameters. ``plan`` runs ten times a
second and writes a path. ``control`` runs fifty times a second and turns the path into a target
steering angle and speed (by default pure pursuit). Both are written in numba's subset of Python and
are called by their address, so that third-party planners run inside the same compiled, GIL-free
loop as ours. A planner in plain Python has one function ``drive`` instead, called between steps of
the loop. A :class:`Policy` is a planner with one vector of parameters: a point that synthesis can
move and an archive can store.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, UnknownNameError, check_number, choices
from pcs_racing.planners.calling import control_address, plan_address
from pcs_racing.planners.pursuit import COMMAND_SLOTS, follow_path, held_command, leave_path


def offsets(*sizes: int) -> tuple[int, ...]:
    """Return where the parts of a memory or a scratch begin, by their sizes, and where all end."""
    return tuple(accumulate(sizes, initial=0))


@dataclass(frozen=True)
class Parameter:
    """Element of a policy's parameter vector."""

    name: str  #: Name, unique within the planner.
    low: float  #: Lower bound; a policy outside the bounds is refused.
    high: float  #: Upper bound, above ``low``.
    default: float  #: Value of a sensible policy.
    meaning: str  #: Effect, with the unit ("log10 weight of ..." for weights on a log scale).

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(
                f"parameter {self.name!r} has bounds [{self.low}, {self.high}]; low must be below"
                " high"
            )
        if not self.low <= self.default <= self.high:
            raise InputError(
                f"parameter {self.name!r} has default {self.default}, outside [{self.low},"
                f" {self.high}]"
            )


@dataclass(frozen=True)
class Planner:
    """Family of policies: compiled driving code, and the parameters that distinguish its members.

    ``track`` is a :class:`pcs_racing.track.frenet.TrackArrays`; ``view`` holds the numbers of
    :data:`pcs_racing.planners.view.VIEW`. All other arguments are float64 arrays. The functions
    must return nothing, should not raise (an error ends all races of the batch), and must depend
    only on their arguments. So a race is a value that can be saved and restored.
    """

    name: str  #: Name in the registry.
    parameters: tuple[Parameter, ...]  #: Elements of ``theta``, in order.
    #: Function ``plan(track, theta, view, memory, scratch, path) -> None``, called ten times a
    #: second; writes ``path`` (12, 4).
    plan: Callable[..., None] = leave_path
    #: Function ``control(track, theta, view, memory, scratch, path, command) -> None``, called
    #: fifty times a second; writes the target steering angle (rad) and speed (m/s).
    control: Callable[..., None] = follow_path
    #: Size of the memory between calls, which belongs to the race's state and starts at 0.
    memory_size: int = 0
    #: Size of the scratch buffer (undefined at the start of each call).
    scratch_size: int = 0
    #: Function of a planner in plain Python, called fifty times a second in place of ``plan`` and
    #: ``control``: ``drive(track, theta, view, memory) -> (steer, speed)``. It gets the
    #: :class:`pcs_racing.track.track.Track` itself, and may store ``memory_size`` numbers in
    #: ``memory``.
    drive: Callable[..., tuple[float, float]] | None = None
    #: Function ``candidates(track, theta, view, memory) -> (points (C, P, 2), costs (C,))`` for
    #: pictures; rejected candidates cost infinity.
    candidates: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]] | None = None
    #: Named parameter vectors in addition to "default", each as a vector or as its values that
    #: differ from the defaults.
    variants: Mapping[str, Any] = field(default_factory=dict, hash=False)
    #: Distance in m along the track, the shorter way round; an opponent beyond it has no effect on
    #: ``plan`` and ``control``. Infinite unless the planner guarantees it. With a finite sight,
    #: game trees need not drive every pair of moves of two cars that are far apart.
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
        """Return a parameter vector from a vector, or from named values over the defaults."""
        if not isinstance(values, Mapping):
            return tuple(values)
        self.indices(list(values))
        for name, value in values.items():
            check_number(f"parameter {name!r} of planner {self.name!r}", value)
        return tuple(values.get(parameter.name, parameter.default) for parameter in self.parameters)

    @property
    def memory_total(self) -> int:
        """Size of the memory in the race's state, with the command of a planner in plain Python."""
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
        """Default parameter vector, shape (P,)."""
        return np.array([p.default for p in self.parameters], dtype=np.float64)

    def pointers(self) -> tuple[Any, Any]:
        """Return the addresses of the compiled ``plan`` and ``control``, for the race kernel."""
        if self.drive is not None:
            return held_command()
        return plan_address(self.plan), control_address(self.control)

    def indices(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the indices of parameters in ``theta``, by name."""
        for name in names:
            if name not in self.parameter_names:
                known = choices(name, self.parameter_names)
                raise UnknownNameError(f"planner {self.name!r} has no parameter {name!r}; {known}")
        return np.array([self.parameter_names.index(name) for name in names], np.int64)

    def without(self, fixed: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the parameters that are not fixed at their defaults."""
        self.indices(fixed)
        return tuple(name for name in self.parameter_names if name not in fixed)

    def complete(
        self, names: Sequence[str], values: ArrayLike, base: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Return parameter vectors (K, P) from the values of some parameters.

        ``values``, shape (K, len(names)), belong to the parameters ``names``. The other parameters
        have the values of ``base``, shape (P,), by default the planner's defaults.
        """
        given = np.asarray(values, np.float64)
        theta = np.tile(self.default if base is None else np.asarray(base), (len(given), 1))
        theta[:, self.indices(names)] = given
        return theta

    def sample(self, rng: np.random.Generator, fixed: Sequence[str] = ()) -> NDArray[np.float64]:
        """Draw a parameter vector uniformly between the bounds, shape (P,).

        The parameters in ``fixed`` keep their defaults, without a draw.
        """
        names = self.without(fixed)
        bounds = self.bounds[self.indices(names)]
        return self.complete(names, rng.uniform(bounds[:, 0], bounds[:, 1])[None])[0]

    def policy(
        self,
        parameters: ArrayLike | Mapping[str, float] | str | None = None,
        name: str | None = None,
    ) -> "Policy":
        """Make a policy from a vector, named values over the defaults, or a variant's name."""
        if parameters is None:
            parameters = "default"
        if isinstance(parameters, str):
            if parameters == "default":
                return Policy(self, self.default, name or self.name)
            if parameters not in self.variants:
                known = choices(parameters, ["default", *self.variants])
                raise UnknownNameError(
                    f"planner {self.name!r} has no variant {parameters!r}; {known}"
                )
            return Policy(
                self, np.array(self.variants[parameters]), name or f"{self.name}:{parameters}"
            )
        vector: Any = parameters  # checked by the policy
        if isinstance(parameters, Mapping):
            vector = self._vector(parameters)
        return Policy(self, vector, name or self.name)


@dataclass(frozen=True, eq=False)
class Policy:
    """Planner with one parameter vector."""

    planner: Planner  #: Family of the policy.
    parameters: NDArray[np.float64]  #: shape (P,): Parameter vector; read-only.
    name: str  #: Name in tables and replays.

    def __post_init__(self) -> None:
        try:
            theta = np.array(self.parameters, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                f"policy {self.name!r} has parameters {self.parameters!r:.80}; they must be numbers"
            ) from None
        expected = len(self.planner.parameters)
        if theta.shape != (expected,):
            raise InputError(
                f"policy {self.name!r} has parameters of shape {theta.shape}; planner"
                f" {self.planner.name!r} takes ({expected},)"
            )
        for parameter, value in zip(self.planner.parameters, theta, strict=True):
            if not np.isfinite(value):
                raise InputError(
                    f"policy {self.name!r}: parameter {parameter.name!r} is {value}; it must be"
                    " finite"
                )
            slack = 1e-9 * (parameter.high - parameter.low)
            if not parameter.low - slack <= value <= parameter.high + slack:
                raise InputError(
                    f"policy {self.name!r}: parameter {parameter.name!r} is {value:g}; it must lie"
                    f" in [{parameter.low:g}, {parameter.high:g}]"
                )
        theta.setflags(write=False)
        object.__setattr__(self, "parameters", theta)


@dataclass(frozen=True, eq=False)
class PolicySet:
    """Policies of one planner; one of them, drawn for each race, drives to the end."""

    name: str  #: Name in tables.
    policies: tuple[Policy, ...]  #: Policies of one planner, at least one.
    facts: Mapping[str, str] = field(default_factory=dict)  #: Facts for documentation and reports.

    def __post_init__(self) -> None:
        object.__setattr__(self, "policies", tuple(self.policies))
        if len(self.policies) == 0:
            raise InputError(f"fixed policy {self.name!r} has no policy; it needs at least one")
        planners = {policy.planner.name for policy in self.policies}
        if len(planners) > 1:
            raise InputError(
                f"fixed policy {self.name!r} has policies of planners"
                f" {', '.join(map(repr, sorted(planners)))}; all must be of one planner"
            )

    @property
    def planner(self) -> Planner:
        """Planner of the policies."""
        return self.policies[0].planner
