"""What programs written for an older numpy expect, in one process: names that are gone, and arrays of one number."""

import math
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

_REMOVED = {
    "float": float, "int": int, "complex": complex, "object": object, "str": str, "float_": np.float64, "Inf": np.inf,
    "infty": np.inf, "NaN": np.nan, "product": np.prod, "in1d": np.isin, "row_stack": np.vstack, "bool8": np.bool_,
}  # fmt: skip
_TAKE_ARRAYS = "acos asin atan ceil cos degrees exp fabs floor log radians sin sqrt tan atan2 copysign fmod pow"


def install() -> None:
    """Put the names back, and let functions of ``math`` take arrays of one number, as they did up to numpy 2.3."""
    for name, value in _REMOVED.items():
        if name not in vars(np):
            setattr(np, name, value)
    # numba's own use of ``math`` must have been seen before a module takes its name.
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    module = ModuleType("math", math.__doc__)
    module.__dict__.update({name: value for name, value in vars(math).items() if not name.startswith("__")})
    sys.modules["math"] = module
    for name in _TAKE_ARRAYS.split():
        _replace(module, name, getattr(math, name))


def _replace(module: ModuleType, name: str, function: Callable[..., Any]) -> None:
    from numba.extending import overload

    def call(*values: Any) -> Any:
        return function(*[v.item() if isinstance(v, np.ndarray) and v.size == 1 else v for v in values])

    # Compiled code that names ``math.sin`` means the real one.
    def one(x):  # type: ignore[no-untyped-def]
        return lambda x: function(x)

    def two(x, y):  # type: ignore[no-untyped-def]
        return lambda x, y: function(x, y)

    call.__name__, call.__module__ = name, "math"
    setattr(module, name, call)
    overload(call)(two if name in ("atan2", "copysign", "fmod", "pow") else one)
