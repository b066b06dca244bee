"""Declared configurations: frozen dataclasses whose annotations state type, range and meaning in
one place::

    @dataclass(frozen=True)
    class Soup(Settings):
        salt: Annotated[float, Interval(ge=0.0, le=1.0), "Salt, g."] = 0.5

The notes behind a type are notes of ``annotated_types`` and a text, the meaning. Everything else
follows: the checks of new settings, the attributes in the docstring, loading from YAML
(:func:`load_settings`), the plain form for manifests (:func:`plain_settings`), the help texts of a
command line (:func:`option_words`) and the JSON schema of a file (``dev/tools/write_schemas.py``).
An option with the default None may be None. Defaults are not checked. An option of another class of
settings may be written as a mapping.
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from enum import Enum
from functools import reduce
from inspect import cleandoc, get_annotations
from operator import or_
from pathlib import Path
from textwrap import indent, wrap
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import numpy as np
from annotated_types import Interval, Len, MinLen, MultipleOf, Predicate

from pcs_racing.base.errors import (
    ConfigError,
    InputError,
    UnknownNameError,
    check_choice,
    did_you_mean,
    is_number,
    is_whole,
    within,
)
from pcs_racing.base.files import MAX_YAML, parse_yaml, read_limited

S = TypeVar("S", bound="Settings")
_NOUNS = {int: "a whole number", float: "a number", bool: "true or false", str: "a non-empty text"}
_PLURALS = {int: "whole numbers", float: "numbers", str: "names"}
_IS_KIND: dict[Any, Callable[[object], bool]] = {int: is_whole, float: is_number}


@dataclass(frozen=True)
class Checked:
    """Note for values with a check of their own.

    A function of name and value returns the stored value, or raises an error.
    """

    function: Callable[[str, Any], Any]
    words: str = ""  #: Range, for docstrings and help texts.


class OneOf:
    """Note for texts that are one of several names."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)


def _different(values: tuple[Any, ...]) -> bool:
    return len(set(values)) == len(values)


ANYTHING = Checked(lambda _, value: value)
"""No check; the consumer checks the value."""

DIFFERENT = Predicate(_different)
"""All values of a list differ."""

Text = Annotated[str, MinLen(1)]
"""Non-empty text, such as a name or a path."""

Names = Annotated[tuple[Text, ...], MinLen(1), DIFFERENT]
"""List of different names."""

OptionalNames = Annotated[tuple[Text, ...], DIFFERENT]
"""List of different names, possibly empty."""

Layers = Annotated[tuple[Annotated[int, Interval(ge=1, le=4096)], ...], Len(0, 8)]
"""Units of each hidden layer of a network."""


def number_range(
    minimum: float, maximum: float, what: str = "", is_kind: Callable[[Any], bool] = is_number
) -> Checked:
    """Return a note for two numbers within limits, in order; a single number is both."""

    def check(name: str, value: Any) -> tuple[Any, Any]:
        pair = [value, value] if is_kind(value) else value
        fine = isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_kind, pair))
        if not fine or not minimum <= pair[0] <= pair[1] <= maximum:
            wanted = f"[low, high] with {minimum:g} <= low <= high <= {maximum:g}"
            raise ConfigError(f"{name}{what} is {value!r}; it must be {wanted}")
        kind = float if is_kind is is_number else int
        return kind(pair[0]), kind(pair[1])

    return Checked(check, f"[low, high] from {minimum:g} to {maximum:g}")


@dataclass(frozen=True)
class Option:
    """Declared field."""

    kind: Any  #: Type without its notes and without None.
    notes: tuple[Any, ...]  #: Notes behind the type, its meaning among them.
    default: Any  #: Default value; ``dataclasses.MISSING`` without one.

    @property
    def meaning(self) -> str:
        """Text among the notes."""
        return next(note for note in self.notes if isinstance(note, str))

    def checked(self, name: str, value: Any) -> Any:
        """Return a value in the form that settings store."""
        for note in self.notes:
            if isinstance(note, Checked):
                try:
                    return note.function(name, value)
                except (ConfigError, UnknownNameError):
                    raise
                except InputError as error:
                    raise ConfigError(str(error)) from None
        if isinstance(self.kind, type) and issubclass(self.kind, Settings):
            if isinstance(value, self.kind):
                return value
            if not isinstance(value, Mapping):
                raise ConfigError(f"{name} is {value!r:.80}; it must be a mapping of settings")
            _check_keys(name, self.kind(), value, "the arguments")
            return self.kind(**value)
        plain = _plain(value)
        if not _fits(plain, self.kind, self.notes):
            wrong = f"is {value!r}"
            if get_origin(self.kind) is Mapping and isinstance(plain, Mapping):
                odd = [key for key in plain if not _fits({key: plain[key]}, self.kind, ())]
                wrong = f"holds {odd[0]!r}: {plain[odd[0]]!r}" if odd else wrong
            hint = did_you_mean(value, _choices(self.kind, self.notes))
            raise ConfigError(
                f"{name} {wrong}; it must be {''.join(_wanted(self.kind, self.notes))}{hint}"
            )
        return plain


def _plain(value: Any) -> Any:
    """Return a value with numbers of Python, tuples and dicts in place of numbers of numpy, members
    of enumerations, sequences and mappings.
    """
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return tuple(map(_plain, value))
    return {key: _plain(one) for key, one in value.items()} if isinstance(value, Mapping) else value


def _fits(value: Any, kind: Any, notes: Iterable[Any]) -> bool:
    """Return whether a plain value has a type and obeys its notes."""
    origin, inner = get_origin(kind), [split(one) for one in get_args(kind)]
    if known := _choices(kind, notes):
        return isinstance(value, str) and value in known
    if origin is tuple:
        fine = isinstance(value, tuple) and all(_fits(one, *inner[0]) for one in value)
    elif origin is Mapping:
        pairs = value.items() if isinstance(value, Mapping) else [(None, None)]
        fine = all(_fits(key, *inner[0]) and _fits(one, *inner[1]) for key, one in pairs)
    else:
        fine = _IS_KIND[kind](value) if kind in _IS_KIND else isinstance(value, kind)
    return fine and all(_obeys(value, note) for note in notes)


def _obeys(value: Any, note: Any) -> bool:
    match note:
        case Interval():
            return bool(note.ge <= value <= note.le)
        case MultipleOf():
            # 1.1 is no multiple of 0.1 in floating point.
            return bool(abs(value / note.multiple_of - round(value / note.multiple_of)) < 1e-6)
        case MinLen() | Len():
            return note.min_length <= len(value) <= (getattr(note, "max_length", None) or np.inf)
        case Predicate():
            return bool(note.func(value))
    return True


def split(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a declared type without notes and without None, and its notes."""
    kind, *notes = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        kind, inner = split(reduce(or_, (one for one in get_args(kind) if one is not NoneType)))
        notes = [*inner, *notes]
    return kind, tuple(notes)


def _choices(kind: Any, notes: Iterable[Any]) -> tuple[str, ...]:
    known = get_args(kind) if get_origin(kind) is Literal else ()
    return next((note.names for note in notes if isinstance(note, OneOf)), known)


def _wanted(kind: Any, notes: Iterable[Any], largest: float = np.inf) -> tuple[str, str]:
    """Return a noun for the values of a type, and their limits, without a maximum above
    ``largest``.
    """
    if known := _choices(kind, notes):
        return "one of", f" {', '.join(known)}"
    by_type = {type(note): note for note in notes}
    if Checked in by_type:
        return "", f" {by_type[Checked].words}"
    limits = ""
    if limit := by_type.get(Interval):
        limits = within(limit.ge, limit.le if limit.le <= largest else None)
    if MultipleOf in by_type:
        limits += f", a multiple of {by_type[MultipleOf].multiple_of:g}"
    form = {tuple: "a list of", Mapping: "a mapping of names to"}.get(get_origin(kind))
    if form is None:
        return _NOUNS.get(kind, ""), limits
    few = by_type.get(Len)
    count = f" {few.min_length} to {few.max_length}".replace(" 0 to", " at most") if few else ""
    different = " different" if DIFFERENT in by_type.values() else ""
    inner = split(get_args(kind)[-1 if form.startswith("a mapping") else 0])
    noun = f"{form}{count}{different} {_PLURALS.get(inner[0], 'values')}"
    return noun, _wanted(*inner, largest)[1]


@dataclass(frozen=True)
class Settings:
    """Base of declared configurations.

    Checks between fields are in ``__post_init__``, after the call of the base's.
    """

    #: Names of settings elsewhere, for the hint in an error: ours.
    other_names: ClassVar[Mapping[str, str]] = {}
    _options: ClassVar[Mapping[str, Option]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._options = options_of(cls)
        own = cleandoc(cls.__dict__.get("__doc__") or "")
        cls.__doc__ = "\n".join([own, "", "Attributes", "----------", *listed_settings(cls), ""])

    def __post_init__(self) -> None:
        for name, option in self._options.items():
            value = getattr(self, name)
            if value is option.default:
                continue
            try:
                # A check may bring a value into another form, such as a list into a tuple.
                object.__setattr__(self, name, option.checked(name, value))
            except InputError:
                raise
            except (RecursionError, ValueError):
                raise ConfigError(
                    f"{name} holds itself, or a number of more than 4300 digits; it must hold"
                    " numbers, texts, lists and mappings"
                ) from None


def options_of(cls: type[Settings]) -> dict[str, Option]:
    """Return the options of a class, which need not have become a dataclass yet."""
    found = {}
    # Derived classes last: their declarations replace inherited ones.
    for base in reversed(cls.__mro__):
        made = base.__dict__.get("__dataclass_fields__", {})
        for name, kind in get_annotations(base).items():
            default = made.get(name, base.__dict__.get(name, MISSING))
            if isinstance(default, Field):
                factory = default.default_factory
                default = default.default if factory is MISSING else factory()
            if get_origin(kind) is Annotated:
                found[name] = Option(*split(kind), default)
    return found


def load_settings(
    kind: str,
    default: S,
    source: "str | os.PathLike[str] | Mapping[str, Any] | Settings | None" = None,
    named: Mapping[str, "S | Path"] | None = None,
    base_key: str | None = None,
    /,
    **changes: Any,
) -> S:
    """Return settings from a name, a YAML file, a mapping or settings, with some fields changed.

    Parameters
    ----------
    kind : str
        Kind of the settings for messages, such as "race".
    default : Settings
        Fields that a file or mapping leaves out; all fields without a source.
    named : mapping, optional
        Settings or YAML files by name.
    base_key : str, optional
        Key in a file that names other settings, out of ``named``, in place of ``default``.
    """
    known = dict(named or {})
    if isinstance(source, Mapping):
        changes = {**source, **changes}
        source = None
    if source is None or isinstance(source, type(default)):
        _check_keys(kind, default, changes, "the arguments")
        made = default if source is None else source
        return replace(made, **changes) if changes else made
    noun = kind if kind.endswith("s") else f"{kind} settings"
    if not isinstance(source, str | os.PathLike):
        raise ConfigError(
            f"{noun} are {source!r:.80}; use a name, a mapping or the path of a YAML file"
        )
    place = known.get(source, Path(source)) if isinstance(source, str) else Path(source)
    if not isinstance(place, str | os.PathLike):
        return load_settings(kind, default, place, **changes)
    if not os.path.isfile(place):
        raise UnknownNameError(
            f"{noun} {str(source)!r} are unknown; use {', '.join(known) or 'none'} or the path of a"
            f" YAML file{did_you_mean(source, known)}"
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
    content = read_limited(path, MAX_YAML, "a file of settings", ConfigError)
    values = parse_yaml(path, content, ConfigError)
    if not isinstance(values, dict):
        raise ConfigError(f"{path} holds {type(values).__name__}; it must be a mapping of settings")
    return values


def plain_settings(settings: Settings) -> dict[str, Any]:
    """Return settings as plain values for YAML; tuples become lists."""

    def plain(value: Any) -> Any:
        if isinstance(value, Settings):
            return plain_settings(value)
        return list(value) if isinstance(value, tuple) else value

    return {field.name: plain(getattr(settings, field.name)) for field in fields(settings)}


def _check_keys(kind: str, settings: Settings, changes: Mapping[Any, Any], where: str) -> None:
    known = [field.name for field in fields(settings)]
    for key in changes:
        if key not in known:
            ours = settings.other_names.get(key)
            hint = f" (did you mean {ours!r}?)" if ours else did_you_mean(key, known)
            raise ConfigError(
                f"{where}: unknown {kind} setting {key!r}; known are {', '.join(known)}{hint}"
            )


def listed_settings(cls: type[Settings], *without: str) -> list[str]:
    """Return entries of a docstring for the options of a class: name, type and meaning."""
    return [
        f"{name} : {getattr(option.kind, '__name__', 'object')}\n"
        + indent("\n".join(wrap(option_words(option), 104)), "    ")
        for name, option in options_of(cls).items()
        if name not in without
    ]


def option_words(option: Option, with_default: bool = True) -> str:
    """Return the meaning, the range and the default of an option as a sentence."""
    noun, limits = _wanted(option.kind, option.notes, 1e9)
    words = f"{noun}{limits}" if noun == "one of" else limits.strip(" ,")
    hidden = option.default in (None, MISSING) or isinstance(option.default, Settings)
    default = "" if hidden or not with_default else f" (default: {option.default!r})"
    return f"{option.meaning.rstrip('.')}{f'; {words}' if words else ''}{default}."
