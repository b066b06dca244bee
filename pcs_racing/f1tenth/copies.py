"""Copies of the gym that programs bring along: their defaults are read from the text, and nothing of them is run."""

import ast
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import say
from pcs_racing.base.files import read_limited
from pcs_racing.f1tenth import env, maps

VARIABLE = "PCS_RACING_GYM_COPY"
"""Environment variable with the folder of the copy, for the worker processes of a program."""

_PACKAGES = {"f110_gym": env.DEFAULTS_A, "f1tenth_gym": env.DEFAULTS_B}
_NAMES = (
    "seed", "num_agents", "timestep", "ego_idx", "integrator", "lidar_dist", "num_beams", "fov", "params", "model",
    "control_input",
)  # fmt: skip
_LARGEST = 1_000_000  # bytes of a file


def find_copy(program: Path) -> Path | None:
    """Return the package of the gym in a program's folder, in a folder above it of its repository, or in one of these.

    A repository ends at the folder that holds ``.git``; without one it is the program's folder and the one above.
    """
    above = program.resolve().parents
    root = next((i for i, folder in enumerate(above) if (folder / ".git").exists()), 1)
    for folder in above[: root + 1]:
        for pattern in (f"{start}{package}/envs/f110_env.py" for start in ("", "*/", "*/*/") for package in _PACKAGES):
            for found in sorted(folder.glob(pattern)):
                return found.parents[1]
    return None


def drive_by(copy: Path) -> str:
    """Let environments have the defaults of a copy, and return in words which of them differ from the gym's."""
    defaults = _PACKAGES[copy.name]
    found = {key: value for key, value in read_defaults(copy).items() if key in defaults}
    if isinstance(params := found.get("params", {}), dict):
        found["params"] = {**defaults["params"], **params}
    if type(found.get("integrator")) is not type(defaults["integrator"]):
        found.pop("integrator", None)  # of a class that this generation does not ask
    found = {key: value for key, value in found.items() if value != defaults[key]}
    defaults.update(found)
    maps.own_folders[:] = [copy / "envs" / "maps"]
    changed = {key: value for key, value in found.items() if key != "params"}
    own = found.get("params", {})
    changed |= {name: value for name, value in own.items() if value != env.DEFAULT_PARAMS.get(name)}
    return ", ".join(f"{key} {getattr(value, 'name', value)}" for key, value in changed.items())


def read_defaults(copy: Path) -> dict[str, Any]:
    """Return the defaults that stand in the text of a copy, of the names that are served."""
    found: dict[str, Any] = {}
    cars = _classes(copy / "envs" / "base_classes.py")
    for name in ("RaceCar", "Simulator"):  # what the one hands to the other counts
        if name in cars:
            found |= {key: value for key, value in _arguments(cars[name]) if key in ("num_beams", "fov", "integrator")}
    for node in (node for name in ("RaceCar", "Simulator") if name in cars for node in ast.walk(cars[name])):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("RaceCar", "ScanSimulator2D"):
            given = [*zip(("num_beams", "fov"), node.args if "Scan" in node.func.id else (), strict=False)]  # type: ignore[attr-defined]
            given += [(key.arg or "", key.value) for key in node.keywords]
            found |= {key: value for key, value in _known(given) if key in ("num_beams", "fov")}
    return found | dict(_environment(_classes(copy / "envs" / "f110_env.py").get("F110Env")))


def _classes(file: Path) -> dict[str, ast.ClassDef]:
    if not file.is_file():
        return {}
    try:
        tree = ast.parse(read_limited(file, _LARGEST, "a file of a copy of the gym"))
    except (SyntaxError, ValueError, RecursionError):
        return {}
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _arguments(cls: ast.ClassDef) -> Iterator[tuple[str, Any]]:
    """Defaults of the arguments of ``__init__``."""
    for function in cls.body:
        if isinstance(function, ast.FunctionDef) and function.name == "__init__":
            named, values = function.args.args, function.args.defaults
            last = named[len(named) - len(values) :]
            yield from _known([(one.arg, value) for one, value in zip(last, values, strict=True)])
            pairs = zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
            yield from _known([(one.arg, value) for one, value in pairs if value is not None])


def _environment(cls: ast.ClassDef | None) -> Iterator[tuple[str, Any]]:
    """Defaults of the environment: arguments, what ``self.NAME`` is without a keyword, ``kwargs.get``, and a config."""
    if cls is None:
        return
    yield from _arguments(cls)
    for function in (node for node in cls.body if isinstance(node, ast.FunctionDef)):
        for node in ast.walk(function) if function.name in ("__init__", "default_config") else ():
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    if isinstance(target, ast.Attribute) and getattr(target.value, "id", "") == "self":
                        yield from _known([(target.attr, node.value)])
            elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "get" and len(node.args) == 2:
                yield from _known([(getattr(node.args[0], "value", ""), node.args[1])])
            elif isinstance(node, ast.Dict) and function.name == "default_config":
                yield from _known(
                    [(getattr(key, "value", ""), value) for key, value in zip(node.keys, node.values, strict=True)]
                )


def _known(pairs: list[tuple[Any, ast.expr]]) -> Iterator[tuple[str, Any]]:
    """Names that are served, with the values of expressions that are plain values or members of ``Integrator``."""
    for name, value in pairs:
        if name == "integrator" and isinstance(value, ast.Attribute) and value.attr in ("RK4", "Euler"):
            yield name, env.Integrator[value.attr]
        elif name in _NAMES:
            try:
                found = ast.literal_eval(value)
            except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
                continue
            if found is not None:
                yield name, found


def use_copy(program: Path | None = None) -> None:
    """Drive by the copy that a program brings along, if it does; a worker, without a program, by the same one."""
    found = find_copy(program) if program is not None else Path(os.environ.get(VARIABLE, ""))
    if found is not None and found.name in _PACKAGES:
        os.environ[VARIABLE] = str(found)
        words = drive_by(found)
        if words and program is not None:
            say(f"{found} has defaults of its own, which are used: {words}")
