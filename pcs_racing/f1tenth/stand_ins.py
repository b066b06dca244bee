"""Replacement modules for programs (gym, f110_gym, f1tenth_gym, pyglet), and names of older numpy.

They hold the names that programs use. Other names raise an error of one sentence.
"""

import math
import multiprocessing
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np

from pcs_racing import f1tenth
from pcs_racing.base.errors import InputError
from pcs_racing.f1tenth import env, old_gym, rendering, simulator
from pcs_racing.f1tenth.maps import find_yaml
from pcs_racing.f1tenth.observations import FEATURES


class _NotServedError(InputError, ImportError):
    """Error for an unsupported name of the gym."""

    def __init__(self, module: str, name: str) -> None:
        hint = (
            " (EnvConfig and its like belong to the gym's development line: use a dictionary as"
            " config)"
        )
        hint = hint if "f1tenth_gym" in module else ""
        super().__init__(
            f"{module} has no {name!r} here: pcs_racing.f1tenth serves the names that racing"
            f" programs use{hint}"
        )


_A = "f110_env base_classes dynamic_models collision_models laser_models rendering"
_B = (
    "f110_env base_classes action integrator dynamic_models collision_models laser_models"
    " observation reset utils rendering rendering.renderer track track.track track.raceline"
    " track.cubic_spline track.utils"
)
_GL = (
    "GL_POINTS GL_LINES GL_LINE_LOOP GL_LINE_STRIP GL_TRIANGLES GL_TRIANGLE_STRIP GL_TRIANGLE_FAN"
    " GL_QUADS GL_QUAD_STRIP GL_POLYGON GL_BLEND GL_SRC_ALPHA GL_ONE_MINUS_SRC_ALPHA GL_LINE_SMOOTH"
    " GL_POINT_SMOOTH GL_LINE_SMOOTH_HINT GL_NICEST"
)
_CALLS = (
    "glPointSize glLineWidth glEnable glDisable glBlendFunc glClearColor glHint glColor3f glColor4f"
)


def _ignored(*args: Any, **named: Any) -> None:
    """Take any arguments, and do nothing."""


def _contents() -> dict[str, dict[str, Any]]:
    """Return the content of each module; gym modules hold all supported names of the gym."""
    known = {name: getattr(f1tenth, name) for name in f1tenth.NAMES} | {"gym": gymnasium, "np": np}
    track = {"find_track_dir": lambda name: find_yaml(name).parent, "FEATURES": FEATURES}
    shared = "Env Space make register spaces logger"
    gym = {name: getattr(gymnasium, name) for name in shared.split()}
    vector = dict.fromkeys(("SyncVectorEnv", "AsyncVectorEnv"), old_gym.SyncVectorEnv)
    gym |= old_gym.WRAPPERS
    wrappers = [f"gym.wrappers.{name}" for name in old_gym.MODULES.split()]
    own = ("gym.spaces", "gym.error", "gym.utils", "gym.utils.seeding", "gym.envs.registration")
    a = known | {"F110Env": env.GenerationA, "vehicle_dynamics_st": simulator.old_dynamics_st}
    b = known | track | {"F110Env": env.GenerationB}
    return {
        **dict.fromkeys(("gym", "gym.core", "gym.wrappers", "gym.envs", *wrappers), gym),
        **dict.fromkeys(
            ("gym.vector", "gym.vector.sync_vector_env", "gym.vector.async_vector_env"), vector
        ),
        **{name: vars(import_module(name.replace("gym", "gymnasium", 1))) for name in own},
        "gym.logger": vars(gymnasium.logger) | dict.fromkeys(("set_level", "setLevel"), _ignored),
        **dict.fromkeys(
            ("f110_gym", "f110_gym.envs", *(f"f110_gym.envs.{name}" for name in _A.split())), a
        ),
        **dict.fromkeys(
            (
                "f1tenth_gym",
                "f1tenth_gym.envs",
                *(f"f1tenth_gym.envs.{name}" for name in _B.split()),
            ),
            b,
        ),
        "pyglet": {"options": {}, "version": "1.4"},
        "pyglet.gl": (
            dict(zip(_GL.split(), range(17), strict=True)) | dict.fromkeys(_CALLS.split(), _ignored)
        ),
        "pyglet.graphics": {"Batch": rendering.Batch},
        "pyglet.text": {"Label": rendering.Drawing},
        "pyglet.window": {},
        "pyglet.shapes": {},
    }


class _Finder(MetaPathFinder):
    """Import hook that refuses unsupported gym modules in one sentence, even if installed.

    Modules of Stable-Baselines3 adapt environments of gym.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Raise an error for unsupported modules; return None for modules that need no change."""
        package, _, rest = fullname.partition(".")
        if (
            package == "gym"
            and rest
            and find_spec("gymnasium")
            and not rest.startswith("wrappers.")
        ):
            sys.modules[fullname] = import_module(f"gymnasium.{rest}")
            return sys.modules[fullname].__spec__
        if package in ("gym", "f110_gym", "f1tenth_gym") and rest:
            raise _NotServedError(*fullname.rsplit(".", 1))
        return old_gym.adapted_spec(fullname, path)


def install() -> None:
    """Change this process for a program of the gym; only the runner and its workers call this.

    Everything that holds for the whole process is changed here, and nowhere else:

    - modules: ``gym``, ``f110_gym``, ``f1tenth_gym`` and ``pyglet`` are ours, even if they are
      installed (a real pyglet would open windows of its own)
    - ``numpy``: its removed names are back
    - ``math``: its functions take arrays of one number
    - ``gymnasium.Env``: it has a ``seed``
    - Stable-Baselines3: it adapts environments of gym when it is imported
    - worker processes of the program: they are changed in the same way
    """
    for name, values in _contents().items():
        _add_module(name, values)
    sys.meta_path.insert(0, _Finder())
    vars(np).update({name: value for name, value in _REMOVED.items() if name not in vars(np)})
    _let_math_take_arrays()
    setattr(gymnasium.Env, "seed", old_gym.seed_generator)  # noqa: B010
    if "forkserver" in multiprocessing.get_all_start_methods():
        multiprocessing.set_forkserver_preload(["pcs_racing.f1tenth.in_workers"])


def _add_module(name: str, values: dict[str, Any]) -> None:
    """Add a module with some names; unknown names of gym are refused or Gymnasium's."""
    module: Any = ModuleType(name, f"Names of {name} that programs use, by pcs_racing.f1tenth.")
    module.__path__ = []
    vars(module).update({key: value for key, value in values.items() if key[:2] != "__"})
    if name == "gym":
        module.__version__ = "0.21.0"
    if not name.startswith("pyglet"):
        module.__getattr__ = _missing(name)
    sys.modules[name] = module
    parent, _, child = name.rpartition(".")
    if parent:
        setattr(sys.modules[parent], child, module)


def _missing(module: str) -> Any:
    def get(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if module.startswith("gym") and not module.startswith("gym.wrappers"):
            return getattr(import_module(module.replace("gym", "gymnasium", 1)), name)
        raise _NotServedError(module, name)

    return get


_REMOVED = {
    "float": float,
    "int": int,
    "complex": complex,
    "object": object,
    "str": str,
    "float_": np.float64,
    "Inf": np.inf,
    "infty": np.inf,
    "NaN": np.nan,
    "product": np.prod,
    "in1d": np.isin,
    "row_stack": np.vstack,
    "bool8": np.bool_,
}
_TAKE_ARRAYS = (
    "acos asin atan ceil cos degrees exp fabs floor log radians sin sqrt tan atan2 copysign"
    " fmod pow"
)


def _let_math_take_arrays() -> None:
    """Replace ``math``: its functions take arrays of one number, as they did up to numpy 2.3."""
    from numba.core.registry import cpu_target

    # numba must register its own use of ``math`` before a module takes its name.
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    module = ModuleType("math", math.__doc__)
    own = {name: value for name, value in vars(math).items() if not name.startswith("__")}
    vars(module).update(own | {name: _for_arrays(own[name]) for name in _TAKE_ARRAYS.split()})
    sys.modules["math"] = module


def _for_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of ``math`` that takes arrays of one number; compiled, it is itself."""
    from numba.extending import overload

    def call(*values: Any) -> Any:
        return function(
            *[v.item() if isinstance(v, np.ndarray) and v.size == 1 else v for v in values]
        )

    def one(x):
        return lambda x: function(x)

    def two(x, y):
        return lambda x, y: function(x, y)

    call.__name__, call.__module__ = function.__name__, "math"
    overload(call)(two if function.__name__ in ("atan2", "copysign", "fmod", "pow") else one)
    return call
