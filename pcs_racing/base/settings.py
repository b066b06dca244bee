"""Declared configurations: frozen dataclasses whose annotations state type, range and meaning in
one place::

    @dataclass(frozen=True)
    class Soup(Settings):
        salt: Annotated[float, Interval(ge=0.0, le=1.0), "Salt, g."] = 0.5

The notes behind a type are those of ``annotated_types``, which pydantic checks, and a text, the
meaning. Everything else follows: the checks when settings are made, the attributes in the
docstring, loading from YAML (:func:`load_settings`), the plain form for manifests
(:func:`plain_settings`), the words of a command line (:func:`option_words`) and the JSON schema of
a file (``dev/tools/write_schemas.py``). An option whose default is None may be None. Defaults are
not checked, so pydantic is only imported for other values (it would double the time of ``import
pcs_racing``).
"""

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from enum import Enum
from functools import cached_property, reduce
from inspect import cleandoc, get_annotations
from operator import or_
from pathlib import Path
from textwrap import wrap
from types import NoneType, SimpleNamespace, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from annotated_types import Interval, Len, MinLen, MultipleOf, Predicate

from pcs_racing.base.checks import check_choice, did_you_mean, is_number, within
from pcs_racing.base.errors import ConfigError, InputError, UnknownNameError
from pcs_racing.base.files import MAX_YAML, parse_yaml, read_limited

if TYPE_CHECKING:
    from pydantic import TypeAdapter

S = TypeVar("S", bound="Settings")
_NOUNS = {int: "a whole number", float: "a number", bool: "true or false", str: "a non-empty text"}
_PLAIN = (bool, int, float, str, NoneType, tuple, dict)
_PLURALS = {int: "whole numbers", float: "numbers", str: "names"}


@dataclass(frozen=True)
class Checked:
    """A note for values in forms of their own: a function of name and value returns the stored
    value, or refuses.
    """

    function: Callable[[str, Any], Any]
    words: str = ""  #: The range, for docstrings and help texts.


class OneOf:
    """A note for texts that are one of several names."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)

    def __get_pydantic_core_schema__(self, _source: Any, _handler: Any) -> Any:
        from pydantic_core.core_schema import literal_schema

        return literal_schema(list(self.names))


def _different(values: tuple[Any, ...]) -> bool:
    return len(set(values)) == len(values)


ANYTHING = Checked(lambda _, value: value)
"""No check; the consumer checks the value."""

DIFFERENT = Predicate(_different)
"""All values of a list differ."""

Text = Annotated[str, MinLen(1)]
"""A text that is not empty, such as a name or a path."""

Names = Annotated[tuple[Text, ...], MinLen(1), DIFFERENT]
"""A list of different names."""

OptionalNames = Annotated[tuple[Text, ...], DIFFERENT]
"""A list of different names, which may be empty."""

Layers = Annotated[tuple[Annotated[int, Interval(ge=1, le=4096)], ...], Len(0, 8)]
"""Units of each hidden layer of a network."""


def number_range(
    minimum: float, maximum: float, what: str = "", is_kind: Callable[[Any], bool] = is_number
) -> Checked:
    """Two numbers within limits, the second one not below the first; a single number is both."""

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
    """A declared field."""

    kind: Any  #: Type without its notes and without None.
    notes: tuple[Any, ...]  #: Notes behind the type, its meaning among them.
    default: Any  #: ``dataclasses.MISSING`` if there is none.
    type: Any  #: As it was declared.

    @property
    def meaning(self) -> str:
        """The text among the notes."""
        return next(note for note in self.notes if isinstance(note, str))

    @cached_property
    def adapter(self) -> "TypeAdapter[Any]":
        """The check of pydantic."""
        from pydantic import TypeAdapter

        kind: Any = Annotated[(self.kind, *self.notes)]
        config: Any = {"strict": True, "allow_inf_nan": False, "arbitrary_types_allowed": True}
        return TypeAdapter(kind, config=config)

    def checked(self, name: str, value: Any) -> Any:
        """Return a value as settings store it."""
        for note in self.notes:
            if isinstance(note, Checked):
                try:
                    return note.function(name, value)
                except (ConfigError, UnknownNameError):
                    raise
                except InputError as error:
                    raise ConfigError(str(error)) from None
        limits = [note for note in self.notes if not isinstance(note, str)]
        within_them = (
            isinstance(note, Interval) and note.ge <= value <= note.le for note in limits
        )
        # A number within its limits, the usual case, needs no pydantic.
        if type(value) is self.kind and (limits or self.kind is bool) and all(within_them):
            return value
        plain = _plain(value)
        from pydantic import ValidationError

        try:
            # Any other object with a __float__ would do for a number.
            self.adapter.validate_python(plain if isinstance(plain, _PLAIN) else None)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            held = isinstance(value, Mapping) and first["loc"]
            wrong = f"holds {first['loc'][0]!r}: {first['input']!r}" if held else f"is {value!r}"
            hint = did_you_mean(value, _choices(self.kind, self.notes))
            raise ConfigError(
                f"{name} {wrong}; it must be {''.join(_wanted(self.kind, self.notes))}{hint}"
            ) from None
        # As it is, since a whole number that pydantic made a fraction would change the hashes of
        # manifests.
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


def _parts(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type without notes and without None, and its notes."""
    kind, *notes = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        kind, inner = _parts(reduce(or_, (one for one in get_args(kind) if one is not NoneType)))
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
    inner, different = (
        _parts(get_args(kind)[form != "a list of"]),
        " different" if DIFFERENT in by_type.values() else "",
    )
    return (
        f"{form}{count}{different} {_PLURALS.get(inner[0], 'values')}",
        _wanted(*inner, largest)[1],
    )


@dataclass(frozen=True)
class Settings:
    """Base of declared configurations; checks between fields go into ``__post_init__`` after the
    base's.
    """

    #: Names of settings elsewhere, for the hint in an error: ours.
    other_names: ClassVar[Mapping[str, str]] = {}
    _options: ClassVar[Mapping[str, Option]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._options = options_of(cls)
        # From Python 3.13 on the docstring is not indented anyway; before, both parts must be.
        own = cleandoc(cls.__dict__.get("__doc__") or "")
        cls.__doc__ = "\n".join(
            [own, "", "Attributes", "----------", *listed_settings(cls, defaults=True), ""]
        )

    def __post_init__(self) -> None:
        for name, option in self._options.items():
            value = getattr(self, name)
            try:
                # By their texts, since 1, 1.0 and True are equal.
                same = isinstance(value, _PLAIN) and repr(value) == repr(option.default)
                if not same and value is not option.default:
                    # A check may bring a value into another form, such as a list into a tuple.
                    object.__setattr__(self, name, option.checked(name, value))
            except InputError:
                raise
            except (RecursionError, ValueError):
                raise ConfigError(
                    f"{name} holds itself, or a number of more than 4300 digits; it must hold"
                    " numbers, texts, lists and mappings"
                ) from None

    @classmethod
    def known(cls, **values: Any) -> Self:
        """Make settings out of values that need no check."""
        made = object.__new__(cls)
        defaults = {name: option.default for name, option in cls._options.items()}
        vars(made).update(defaults | values)
        return made


def options_of(cls: type[Settings]) -> dict[str, Option]:
    """Return the options of a class, which need not have become a dataclass yet."""
    found = {}
    # Derived classes last: their declarations take the place of inherited ones.
    for base in reversed(cls.__mro__):
        made = base.__dict__.get("__dataclass_fields__", {})
        for name, kind in get_annotations(base).items():
            parts, default = _parts(kind), made.get(name, base.__dict__.get(name, MISSING))
            if isinstance(default, Field):
                default = (
                    default.default
                    if default.default_factory is MISSING
                    else default.default_factory()
                )
            if get_origin(kind) is Annotated:
                found[name] = Option(*parts, default, kind)
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
    """Return settings from a name out of ``named``, a YAML file, a mapping or settings, with some
    fields changed.

    ``default`` is what a field is that a file leaves out, or all of them without a source; a file's
    key ``base_key`` names other settings, out of ``named``, that take its place. ``kind`` ("race")
    is for messages.
    """
    known = dict(named or {})
    if isinstance(source, Mapping):
        changes = {**source, **changes}
        source = None
    if source is None or isinstance(source, type(default)):
        _check_keys(kind, default, changes, "the arguments")
        made = default if source is None else source
        return replace(made, **changes) if changes else made
    if not isinstance(source, str | os.PathLike):
        raise ConfigError(
            f"{kind} settings are {source!r:.80}; use a name, a mapping or the path of a YAML file"
        )
    place = known.get(source, Path(source)) if isinstance(source, str) else Path(source)
    if not isinstance(place, str | os.PathLike):
        return load_settings(kind, default, place, **changes)
    if not os.path.isfile(place):
        raise UnknownNameError(
            f"{kind} settings {str(source)!r} are unknown; use {', '.join(known) or 'none'} or the"
            f" path of a YAML file{did_you_mean(source, known)}"
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
    values = parse_yaml(
        path, read_limited(path, MAX_YAML, "a file of settings", ConfigError), ConfigError
    )
    if not isinstance(values, dict):
        raise ConfigError(f"{path} holds {type(values).__name__}; it must be a mapping of settings")
    return dict(values)


def plain_settings(settings: Settings) -> dict[str, Any]:
    """Return settings as plain values that YAML can hold; tuples become lists."""

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


def listed_settings(cls: type[Settings], *without: str, defaults: bool = False) -> list[str]:
    """Return lines of a docstring, two or more for each option of a class: its name and type, and
    its meaning.
    """
    lines: list[str] = []
    for name, option in options_of(cls).items():
        if name not in without:
            lines += listed_argument(name, type_name(option.type), option_words(option, defaults))
    return lines


def listed_argument(name: str, kind: str, meaning: str) -> list[str]:
    """Return lines of a docstring about one argument."""
    indent = " " * 4
    first = name if kind == "Any" else f"{name} : {kind}"
    return [first, *wrap(meaning, 108, initial_indent=indent, subsequent_indent=indent)]


def type_name(kind: Any) -> str:
    """Return a type as a docstring writes it."""
    kind = get_type_hints(SimpleNamespace(__annotations__={"kind": kind}))["kind"]  # without notes
    plain = kind.__name__ if isinstance(kind, type) and get_origin(kind) is None else str(kind)
    return re.sub(
        r"collections\.abc\.|typing\.",
        "",
        re.sub(r"typing\.Optional\[(.+)\]$", r"\1 | None", plain),
    )


def option_words(option: Option, with_default: bool = True) -> str:
    """Return the meaning, the range and the default of an option as a sentence."""
    noun, limits = _wanted(option.kind, option.notes, 1e9)
    words = f"{noun}{limits}" if noun == "one of" else limits.strip(" ,")
    hidden = option.default in (None, MISSING) or isinstance(option.default, Settings)
    shown = with_default and not hidden
    default = f" (default: {option.default!r})" if shown else ""
    return f"{option.meaning.rstrip('.')}{f'; {words}' if words else ''}{default}."
