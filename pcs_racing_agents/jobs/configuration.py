"""Settings as data: a frozen dataclass of plain values, from YAML if need be, that refuses what it does not know."""

import os
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError
from pcs_racing.base.reading import MAX_YAML, parse_yaml, read_limited

__all__ = ["check_numbers", "check_source", "check_wholes", "load_settings", "plain_settings", "shipped_configs"]

T = TypeVar("T")


def shipped_configs(kind: str) -> dict[str, Path]:
    """Configurations that come with the package, by name: the files ``configs/KIND_NAME.yaml``."""
    folder = Path(__file__).resolve().parents[1] / "configs"
    return {
        file.stem.removeprefix(f"{kind}_"): file
        for file in sorted(folder.glob(f"{kind}_*.yaml"), key=lambda file: file.stem)
    }


def load_settings(kind: str, default: T, source: Any = None, **changes: Any) -> T:
    """Return settings from a shipped configuration's name, a YAML file or settings, with some fields changed.

    Parameters
    ----------
    kind : str
        What the settings are for, as messages say it, and as the files of shipped ones begin.
    default : dataclass instance
        What a field is that the file leaves out.
    source : str, Path, or settings of the same class, optional
    **changes
        Fields that are to be others.

    Raises
    ------
    ConfigError
        If a key is unknown, or the settings' own checks refuse a value.
    UnknownNameError
        If the name is neither a shipped configuration nor a file.
    """
    cls: Any = type(default)
    if source is None or isinstance(source, cls):
        return replace(source or default, **_known(kind, cls, changes, "the arguments"))  # type: ignore[type-var]
    check_source(kind, source)
    shipped = shipped_configs(kind)
    path = shipped[source] if isinstance(source, str) and source in shipped else Path(source)
    if not os.path.isfile(path):
        names = ", ".join(shipped) or "none"
        raise UnknownNameError(f"{kind} settings {str(source)!r} are unknown; use {names} or the path of a YAML file")
    values = {**_known(kind, cls, read_mapping(path), str(path)), **_known(kind, cls, changes, "the arguments")}
    try:
        return replace(default, **values)  # type: ignore[type-var]
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def check_source(kind: str, source: Any) -> None:
    """Refuse what is neither a name nor a path.

    Raises
    ------
    ConfigError
        If it is not.
    """
    if not isinstance(source, str | os.PathLike):
        raise ConfigError(f"{kind} settings are {source!r:.80}; use a name or the path of a YAML file")


def read_mapping(path: Path) -> dict[Any, Any]:
    """Read a YAML file that holds a mapping; no code in it is run.

    Raises
    ------
    ConfigError
        If it is too large, no YAML, or no mapping.
    """
    try:
        content = read_limited(path, MAX_YAML, "a configuration")
    except OSError as error:
        raise ConfigError(f"can't read {path}: {error.strerror}") from None
    except InputError as error:
        raise ConfigError(str(error)) from None
    values = parse_yaml(path, content, ConfigError)
    if not isinstance(values, dict):
        raise ConfigError(f"{path} holds {type(values).__name__}; it must be a mapping of settings")
    return values


def plain_settings(settings: Any) -> dict[str, Any]:
    """Settings as plain values that YAML can hold; tuples become lists."""
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


def check_wholes(settings: Any, **ranges: tuple[int, int]) -> None:
    """Check that fields are whole numbers within their ranges, both ends included."""
    for key, (low, high) in ranges.items():
        value = getattr(settings, key)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ConfigError(f"{key} is {value!r}; it must be a whole number from {low} to {high}")


def check_numbers(settings: Any, **ranges: tuple[float, float]) -> None:
    """Check that fields are numbers within their ranges, both ends included."""
    for key, (low, high) in ranges.items():
        value = getattr(settings, key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise ConfigError(f"{key} is {value!r}; it must be a number from {low:g} to {high:g}")


def _known(kind: str, cls: Any, values: Mapping[Any, Any], where: str) -> dict[str, Any]:
    names = [field.name for field in fields(cls)]
    for key in values:
        if key not in names:
            raise ConfigError(f"{where}: unknown {kind} setting {key!r}; known are {', '.join(names)}")
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
