"""Declared settings: a frozen dataclass whose fields state type, default, range and meaning in one place::

    @dataclass(frozen=True)
    class Soup(Settings):
        salt: float = setting(0.5, number(0.0, 1.0), "Salt, g.")

Everything else follows from the declaration: the checks when settings are made, the attributes in the docstring,
loading from YAML (:func:`load_settings`), the plain form for manifests (:func:`plain_settings`) and the words of a
command line (:func:`setting_words`). A setting whose default is None may be None.
"""

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, fields, replace
from functools import partial
from inspect import cleandoc, get_annotations
from pathlib import Path
from textwrap import wrap
from typing import Any, ClassVar, TypeVar, get_origin

from pcs_racing.base.checks import (
    check_choice,
    check_flag,
    check_names,
    check_number,
    check_text,
    check_whole,
    check_wholes,
    did_you_mean,
    is_number,
    is_whole,
    within,
)
from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError
from pcs_racing.base.files import MAX_YAML, parse_yaml, read_limited

S = TypeVar("S", bound="Settings")


@dataclass(frozen=True)
class Rule:
    """What a setting may be."""

    #: ``check(name, value)`` returns the value as it is kept, or raises a :class:`ConfigError` that names it.
    check: Callable[[str, Any], Any]
    words: str = ""  #: The range, for docstrings and help texts: ``from 0 to 1``; empty where the type says all.
    read: Callable[[str], Any] = str  #: Turns a word of a command line into a value.
    several: bool = False  #: Whether the value is a list.


ANYTHING = Rule(lambda name, value: value)
"""What is checked where it is used, by one who knows more of it."""


def whole(minimum: int, maximum: int) -> Rule:
    """A whole number from ``minimum`` to ``maximum``."""
    words = within(minimum, maximum).strip()
    return Rule(partial(check_whole, minimum=minimum, maximum=maximum, error=ConfigError), words, int)


def number(minimum: float, maximum: float) -> Rule:
    """A finite number from ``minimum`` to ``maximum``."""
    words = within(minimum, maximum).strip()
    return Rule(partial(check_number, minimum=minimum, maximum=maximum, error=ConfigError), words, float)


def tenths(minimum: float, maximum: float) -> Rule:
    """A multiple of 0.1 from ``minimum`` to ``maximum``."""

    def check(name: str, value: Any) -> float:
        checked = check_number(name, value, minimum, maximum, error=ConfigError)
        if abs(checked * 10.0 - round(checked * 10.0)) > 1e-9:
            raise ConfigError(f"{name} is {value!r}; it must be a multiple of 0.1")
        return checked

    return Rule(check, f"{within(minimum, maximum).strip()}, a multiple of 0.1", float)


def number_range(what: str, minimum: float, maximum: float, is_kind: Callable[[Any], bool] = is_number) -> Rule:
    """Two numbers within limits, the second one not below the first; a single number stands for both."""

    def check(name: str, value: Any) -> tuple[Any, Any]:
        pair = [value, value] if is_kind(value) else value
        fine = isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_kind, pair))
        if not fine or not minimum <= pair[0] <= pair[1] <= maximum:
            wanted = f"[low, high] with {minimum:g} <= low <= high <= {maximum:g}"
            raise ConfigError(f"{name}{what} is {value!r}; it must be {wanted}")
        kind = float if is_kind is is_number else int
        return kind(pair[0]), kind(pair[1])

    return Rule(check, f"[low, high] from {minimum:g} to {maximum:g}")


def flag() -> Rule:
    """True or false."""
    return Rule(partial(check_flag, error=ConfigError))


def text() -> Rule:
    """A text that is not empty, such as a name or a path."""
    return Rule(partial(check_text, error=ConfigError))


def choice(known: Iterable[str]) -> Rule:
    """One of several names."""
    known = tuple(known)
    return Rule(partial(check_choice, choices=known, error=ConfigError), f"one of {', '.join(known)}")


def names(minimum: int = 1) -> Rule:
    """A list of at least ``minimum`` different names."""
    return Rule(partial(check_names, minimum=minimum, error=ConfigError), several=True)


def wholes(minimum: int, maximum: int, *, shortest: int = 0, longest: int = 1000, different: bool = False) -> Rule:
    """A list of ``shortest`` to ``longest`` whole numbers from ``minimum`` to ``maximum``."""
    count = shortest, longest
    check = partial(check_wholes, minimum=minimum, maximum=maximum, count=count, different=different, error=ConfigError)
    return Rule(check, f"{shortest} to {longest} numbers{within(minimum, maximum)}", int, True)


def weights(minimum: int, maximum: int) -> Rule:
    """A mapping of names to whole numbers from ``minimum`` to ``maximum``."""

    def check(name: str, value: Any) -> dict[str, int]:
        if not isinstance(value, Mapping) or not value:
            raise ConfigError(f"{name} is {value!r}; it must be a mapping of names to whole numbers")
        for key, weight in value.items():
            if not isinstance(key, str) or not key or not is_whole(weight) or not minimum <= weight <= maximum:
                raise ConfigError(
                    f"{name} holds {key!r}: {weight!r}; give names with whole numbers{within(minimum, maximum)}"
                )
        return {key: int(weight) for key, weight in value.items()}

    return Rule(check, f"weights{within(minimum, maximum)}")


def checked(function: Callable[[Any], Any], words: str = "") -> Rule:
    """What a function makes of a value; an :class:`InputError` of it becomes a :class:`ConfigError`."""

    def check(_: str, value: Any) -> Any:
        try:
            return function(value)
        except (ConfigError, UnknownNameError):
            raise
        except InputError as error:
            raise ConfigError(str(error)) from None

    return Rule(check, words)


def setting(default: Any, rule: Rule, meaning: str) -> Any:
    """Declare a setting: a dataclass field with its rule and its meaning, one sentence with the unit.

    The default must obey the rule, or be None where the setting may be None; ``dataclasses.MISSING`` stands for no
    default.
    """
    metadata = {"rule": rule, "meaning": meaning}
    # Each object gets a mapping of its own, and frozen settings stay hashable.
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), hash=False, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Settings:
    """Base of declared settings; checks between fields go into ``__post_init__`` after the base's."""

    other_names: ClassVar[Mapping[str, str]] = {}  #: Names of settings elsewhere, for the hint in an error: ours.

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        # From Python 3.13 on the docstring is not indented anyway; before, both parts must be.
        own = cleandoc(cls.__dict__.get("__doc__") or "")
        cls.__doc__ = "\n".join([own, "", "Attributes", "----------", *listed_settings(cls, defaults=True), ""])

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            kept = field.metadata["rule"].check(field.name, value)
            # A rule may bring a value into another form, such as a list into a tuple; the settings are frozen by now.
            if kept is not value:
                object.__setattr__(self, field.name, kept)


def load_settings(
    kind: str,
    default: S,
    source: "str | os.PathLike[str] | Mapping[str, Any] | Settings | None" = None,
    named: Mapping[str, "S | Path"] | None = None,
    base_key: str | None = None,
    /,
    **changes: Any,
) -> S:
    """Return settings from a name out of ``named``, a YAML file, a mapping or settings, with some fields changed.

    ``default`` is what a field is that a file leaves out, or all of them without a source; a file's key ``base_key``
    names other settings, out of ``named``, that take its place. ``kind`` ("race") is for messages.
    """
    known = dict(named or {})
    if isinstance(source, Mapping):
        changes = {**source, **changes}
        source = None
    if source is None or isinstance(source, type(default)):
        _check_keys(kind, default, changes, "the arguments")
        return replace(default if source is None else source, **changes)
    if not isinstance(source, str | os.PathLike):
        raise ConfigError(f"{kind} settings are {source!r:.80}; use a name, a mapping or the path of a YAML file")
    place = known.get(source, Path(source)) if isinstance(source, str) else Path(source)
    if not isinstance(place, str | os.PathLike):
        return load_settings(kind, default, place, **changes)
    if not os.path.isfile(place):
        raise UnknownNameError(
            f"{kind} settings {str(source)!r} are unknown; use {', '.join(known) or 'none'} or the path of a YAML file"
            f"{did_you_mean(source, known)}"
        )
    values = read_settings(place)
    if base_key is not None and base_key in values:
        name = check_choice(f"{place}: {base_key}", values.pop(base_key), known, ConfigError)
        default = load_settings(kind, default, name, named)
    _check_keys(kind, default, values, str(place))
    _check_keys(kind, default, changes, "the arguments")
    # In one step: a value of the file may be possible only together with a change.
    try:
        return replace(default, **{**values, **changes})
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None


def read_settings(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Read a YAML file that holds a mapping; no code in it is run."""
    values = parse_yaml(path, read_limited(path, MAX_YAML, "a file of settings", ConfigError), ConfigError)
    if not isinstance(values, dict):
        raise ConfigError(f"{path} holds {type(values).__name__}; it must be a mapping of settings")
    return dict(values)


def plain_settings(settings: Settings) -> dict[str, Any]:
    """Return settings as plain values that YAML can hold; tuples become lists."""
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


def _check_keys(kind: str, settings: Settings, changes: Mapping[Any, Any], where: str) -> None:
    known = [field.name for field in fields(settings)]
    for key in changes:
        if key not in known:
            ours = settings.other_names.get(key)
            hint = f" (did you mean {ours!r}?)" if ours else did_you_mean(key, known)
            raise ConfigError(f"{where}: unknown {kind} setting {key!r}; known are {', '.join(known)}{hint}")


def listed_settings(cls: type[Settings], *without: str, defaults: bool = False) -> list[str]:
    """Return lines of a docstring, two or more for each setting of a class: its name and type, and its meaning."""
    lines: list[str] = []
    for name, (kind, field) in _declared(cls).items():
        if name not in without:
            lines += listed_argument(name, kind, setting_words(field, defaults))
    return lines


def listed_argument(name: str, kind: str, meaning: str) -> list[str]:
    """Return lines of a docstring about one argument."""
    indent = " " * 4
    first = name if kind == "Any" else f"{name} : {kind}"
    return [first, *wrap(meaning, 108, initial_indent=indent, subsequent_indent=indent)]


def _declared(cls: type) -> dict[str, tuple[str, "Field[Any]"]]:
    """Types and declarations of the settings of a class, which need not have become a dataclass yet."""
    declared = {}
    # Derived classes last: what they declare anew takes the place of what they inherit.
    for base in reversed(cls.__mro__):
        made = base.__dict__.get("__dataclass_fields__", {})
        for name, kind in get_annotations(base).items():
            field = made.get(name, base.__dict__.get(name))
            if isinstance(field, Field) and "rule" in field.metadata:
                declared[name] = type_name(kind), field
    return declared


def type_name(kind: Any) -> str:
    """Return a type as a docstring writes it."""
    plain = kind.__name__ if isinstance(kind, type) and get_origin(kind) is None else str(kind)
    return plain.replace("collections.abc.", "").replace("typing.", "")


def setting_words(field: "Field[Any]", with_default: bool = True) -> str:
    """Return the meaning, the range and the default of a setting as a sentence."""
    rule, meaning = field.metadata["rule"], field.metadata["meaning"].rstrip(".")
    default = field.default if field.default_factory is MISSING else field.default_factory()
    said = f" (default: {default!r})" if with_default and default is not None and default is not MISSING else ""
    return f"{meaning}{f'; {rule.words}' if rule.words else ''}{said}."
