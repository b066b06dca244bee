"""Calls from the compiled race to a planner's functions, by the address of their machine code."""

from collections.abc import Callable
from functools import cache, partial
from types import FunctionType
from typing import Any

from numba import types
from numba.core.errors import NumbaError

from pcs_racing.base.compilation import compiled, inner_kernel
from pcs_racing.base.errors import InputError
from pcs_racing.base.numba_parts import address_of, call_with, config
from pcs_racing.track.frenet import TrackArrays

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")

TRACK = types.NamedTuple(
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
        types.Array(types.int32, 1, "C"),  # corners_start
        _MATRIX,  # corners
        types.Array(types.int32, 2, "C"),  # lookup
        types.float64,  # lookup_cell
        _MATRIX,  # moving
    ),
    TrackArrays,
)
"""Type of a track in compiled code."""

_PLAN = (TRACK, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX)
"""Argument types of ``plan``: track, theta, view, memory, scratch and path."""
_CONTROL = (*_PLAN, _VECTOR)
"""Argument types of ``control``: the same, and the command to write."""


@cache
def _address(arguments: tuple[types.Type, ...], function: Callable[..., None]) -> Any:
    """Compile a planner's function and return the address of its machine code.

    Without compilation (``NUMBA_DISABLE_JIT``), return the function itself.
    """
    python = getattr(function, "py_func", function)
    if config.DISABLE_JIT:
        return python
    checked = getattr(function, "bounds_checked", False)
    # Compiled without the wrapper for Python, a tenth of the time before a first race.
    own = _renamed(python, "checked" if checked else "driven")
    try:  # without reference counts where the function allocates nothing
        dispatcher: Any = inner_kernel(own, boundscheck=checked)
        dispatcher.compile(arguments)
    except (RuntimeError, NumbaError):
        dispatcher = compiled(own, boundscheck=checked)
        try:
            dispatcher.compile(arguments)
        except NumbaError as error:
            said = " ".join(str(error).split())
            raise InputError(
                f"a planner's {python.__name__!r} can't be compiled: {said}"
            ) from error
    code = dispatcher.overloads[arguments]
    if code.signature.return_type != types.none:
        raise InputError(
            f"a planner's {python.__name__!r} returns {code.signature.return_type}; it must write"
            " its results into its arguments and return nothing"
        )
    _kept.append(code)
    return address_of(code)


plan_address, control_address = partial(_address, _PLAN), partial(_address, _CONTROL)
"""Compile a planner's ``plan`` or ``control``, and return its address for the calls below."""


def bounds_checked(function: Callable[..., None]) -> Callable[..., None]:
    """Return a copy of a planner's function that raises an IndexError beyond an array's end.

    Reads and writes are checked, but not in the compiled functions that it calls.
    """
    own = _renamed(getattr(function, "py_func", function), "checked")
    own.bounds_checked = True  # type: ignore[attr-defined]
    return own


def _renamed(python: Any, what: str) -> FunctionType:
    """Return a copy of a function under its own name.

    Under a shared name, numba would take code with other options from its cache.
    """
    own = FunctionType(
        python.__code__,
        python.__globals__,
        python.__name__,
        python.__defaults__,
        python.__closure__,
    )
    own.__module__, own.__qualname__ = python.__module__, f"{python.__qualname__}.{what}"
    return own


_kept: list[Any] = []
"""Machine code with addresses in use."""


call_plan, call_control = call_with(_PLAN), call_with(_CONTROL)
"""Calls of a planner's functions at an address, with a tuple of their arguments."""
