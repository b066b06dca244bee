"""Copies of the gym inside programs: defaults are read from the source text, without running it."""

import ast
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import say
from pcs_racing.base.files import read_limited
from pcs_racing.f1tenth import env, maps

VARIABLE = "PCS_RACING_GYM_COPY"
"""Environment variable with the folder of the copy, for the worker processes of a program."""

_PACKAGES = {"f110_gym": env.DEFAULTS_A, "f1tenth_gym": env.DEFAULTS_B}
_NAMES = (
    "seed",
    "num_agents",
    "timestep",
    "ego_idx",
    "integrator",
    "lidar_dist",
    "num_beams",
    "fov",
    "params",
    "model",
    "control_input",
)
_OF_CARS = ("num_beams", "fov", "integrator")
_MAX_BYTES = 1_000_000  # of a file


def find_copy(program: Path) -> Path | None:
    """Return the gym package in or below a program's folder or a parent folder in its repository.

    A package is a folder with a folder ``envs``.

    A repository ends at the folder with ``.git``; without one, it is the program's folder and its
    parent.
    """
    above = program.resolve().parents
    root = next((i for i, folder in enumerate(above) if (folder / ".git").exists()), 1)
    for folder in above[: root + 1]:
        for pattern in (
            f"{start}{package}/envs" for start in ("", "*/", "*/*/") for package in _PACKAGES
        ):
            for found in sorted(folder.glob(pattern)):
                return found.parent
    return None


def drive_by(copy: Path) -> str:
    """Set the environments' defaults to a copy's defaults; return the changes in words."""
    defaults = _PACKAGES[copy.name]
    found = {key: value for key, value in read_defaults(copy).items() if key in defaults}
    params = found.pop("params", {})
    found["params"] = {**defaults["params"], **(params if isinstance(params, dict) else {})}
    if type(found.get("integrator")) is not type(defaults["integrator"]):
        found.pop("integrator", None)  # of another class than this generation's
    found = {key: value for key, value in found.items() if value != defaults[key]}
    defaults.update(found)
    maps.own_folders[:] = [copy / "envs" / "maps"]
    changed = {key: value for key, value in found.items() if key != "params"}
    own = found.get("params", {})
    changed |= {name: value for name, value in own.items() if value != env.DEFAULT_PARAMS.get(name)}
    return ", ".join(f"{key} {getattr(value, 'name', value)}" for key, value in changed.items())


def read_defaults(copy: Path) -> dict[str, Any]:
    """Return the defaults of supported names in the text of a copy; the last value of each counts.

    The environment's defaults override the simulator's, and the simulator's override the car's.
    """
    found: dict[str, Any] = {}
    files = {"base_classes": ("RaceCar", "Simulator"), "f110_env": ("F110Env",)}
    for file, name in (
        (copy / "envs" / f"{file}.py", name) for file, names in files.items() for name in names
    ):
        with suppress(SyntaxError, ValueError, OSError, RecursionError):
            tree = ast.parse(read_limited(file, _MAX_BYTES, "a file of a copy of the gym"))
            pairs = [
                pair
                for node in tree.body
                if getattr(node, "name", "") == name
                for pair in _pairs(node)
            ]
            served = _NAMES if name == "F110Env" else _OF_CARS
            found |= {
                key: value for key, value in _known(pairs) if key in served and value is not None
            }
    return found


def _pairs(cls: ast.stmt) -> Iterator[tuple[Any, ast.expr | None]]:
    """Yield the names and values in a class.

    Sources are defaults and keywords of functions, attributes of self, ``get``, and dictionaries.
    """
    for node in ast.walk(cls):
        if isinstance(node, ast.arguments):
            named = [*node.posonlyargs, *node.args]
            yield from (
                (one.arg, value)
                for one, value in zip(named[::-1], node.defaults[::-1], strict=False)
            )
            yield from (
                (one.arg, value)
                for one, value in zip(node.kwonlyargs, node.kw_defaults, strict=True)
            )
        elif isinstance(node, ast.Assign):
            yield from ((getattr(target, "attr", None), node.value) for target in node.targets)
        elif isinstance(node, ast.Dict):
            yield from (
                (getattr(key, "value", None), value)
                for key, value in zip(node.keys, node.values, strict=True)
            )
        elif isinstance(node, ast.Call):
            yield from ((keyword.arg, keyword.value) for keyword in node.keywords)
            if getattr(node.func, "attr", "") == "get" and len(node.args) == 2:
                yield getattr(node.args[0], "value", None), node.args[1]
            elif getattr(node.func, "id", "") == "ScanSimulator2D":
                yield from zip(("num_beams", "fov"), node.args, strict=False)


def _known(pairs: Iterable[tuple[Any, ast.expr | None]]) -> Iterator[tuple[Any, Any]]:
    """Yield names and values of plain expressions and of members of ``Integrator``."""
    for name, value in pairs:
        if (
            name == "integrator"
            and isinstance(value, ast.Attribute)
            and value.attr in ("RK4", "Euler")
        ):
            yield name, env.Integrator[value.attr]
        elif value is not None:
            with suppress(ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
                yield name, ast.literal_eval(value)


def use_copy(program: Path | None = None) -> None:
    """Use a program's copy of the gym, if any; a worker, without a program, uses the same copy."""
    found = find_copy(program) if program is not None else Path(os.environ.get(VARIABLE, ""))
    if found is not None and found.name in _PACKAGES:
        os.environ[VARIABLE] = str(found)
        words = drive_by(found)
        if program is not None:
            own = f"; it has defaults of its own, which are used: {words}" if words else ""
            say(f"{found} is not run: pcs_racing.f1tenth takes its place{own}")
