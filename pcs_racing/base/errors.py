"""Errors for bad input, the rule for their use, and checks of values that raise them.

A message is one line that names the value and the correct form; it comes before any long work. All
functions of both packages follow the same rule, without repeating it in their docstrings.

- an argument, an array or a game file: :class:`InputError`. It names the argument, and the index
  of the first wrong race or car; or the file that is missing, too large, damaged or of another kind
- a setting or its value: :class:`ConfigError`
- a map or a track: :class:`MapError`
- a name in a registry: :class:`UnknownNameError`, with the known names
- a keyword argument: :class:`UnknownArgumentError`, with the nearest known name
- an optional library: ``ModuleNotFoundError``, with the extra that installs it
- a full disk, a file without permission to write: ``OSError``, with the path; an existing file
  stays unchanged

A function's docstring names any other error that it raises.

A check returns its value. Ends of ranges belong to the ranges; in shapes, None is any length.
"""

import math
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cache
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

_MAX_LENGTH = 300


class InputError(ValueError):
    """Error for an invalid argument; the message names the value and the correct form.

    The value can be any text, so control characters in a message are escaped, and the middle of a
    message of more than 300 characters is left out.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*(_shortened(arg) if isinstance(arg, str) else arg for arg in args))


class MapError(InputError):
    """Error for a map folder, or a file in it, that is not a valid map."""


class ConfigError(InputError):
    """Error for a configuration with an unknown key or an invalid value."""


class UnknownNameError(InputError, KeyError):
    """Error for an unregistered name; the message lists the registered names."""

    def __str__(self) -> str:
        """Show the message itself (``KeyError`` would show its repr)."""
        return str(self.args[0]) if self.args else ""


class UnknownArgumentError(InputError, TypeError):
    """Error for an unknown argument of a function or class."""


def unknown_argument(function: str, name: str, known: Iterable[str]) -> UnknownArgumentError:
    """Make the error for an unknown keyword argument, in Python's words and with the nearest known
    name.
    """
    return UnknownArgumentError(
        f"{function}() got an unexpected keyword argument {name!r}; {choices(name, known)}"
    )


def choices(name: str, known: Iterable[str]) -> str:
    """Return the end of an error message about an unknown name: the nearest and all known names."""
    names = list(known)
    near = nearest(str(name), names)
    return f"{f'did you mean {near!r}? ' if near else ''}there are: {', '.join(names)}"


def nearest(name: Any, known: Iterable[str]) -> str:
    """Return the known name nearest to a name, or "" if none is near."""
    close = get_close_matches(name, list(known), 1) if isinstance(name, str) else []
    return close[0] if close else ""


def say(line: str) -> None:
    """Print a status message to stderr: the cause of a wait or of repeated work."""
    print(f"pcs-racing: {line}", file=sys.stderr, flush=True)


@cache
def say_once(line: str) -> None:
    """Print a status message to stderr, once in this process."""
    say(line)


def require(*modules: str, extra: str = "mapping") -> None:
    """Raise an error that names the extra to install if a module is missing; import nothing."""
    for name in modules:
        if find_spec(name) is None:
            raise ModuleNotFoundError(
                f'{name} is needed for this: pip install "pcs-racing[{extra}]", in a clone'
                f' ".[{extra}]"',
                name=name,
            )


def _shortened(message: str) -> str:
    line = _ends(message)
    # Escape terminal commands: cursor, colours, writing direction.
    return _ends(
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    )


def _ends(line: str) -> str:
    return line if len(line) <= _MAX_LENGTH else f"{line[:195]} ... {line[-100:]}"


@contextmanager
def one_line(what: str, passing: type[Exception] | tuple[()] = InputError) -> Iterator[None]:
    """Turn any error, the end of the process included, into one line.

    Ctrl-C passes, and so do the errors ``passing``, by default our errors.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except passing:
        raise
    except BaseException as error:
        try:
            said = f"{type(error).__name__}: {error}"
        except Exception:  # the text of the error raised an error
            said = type(error).__name__
        raise InputError(f"{what}: {said}") from error


Error = type[InputError]


def all_finite(values: NDArray[np.float64]) -> bool:
    """Return whether no element is infinite or NaN; fast for two numbers as for many."""
    few = values.size <= 32
    return (
        all(map(math.isfinite, values.ravel().tolist())) if few else bool(np.isfinite(values).all())
    )


def is_flag(value: object) -> TypeGuard[bool]:
    """Return whether a value is a truth value of Python or numpy."""
    return isinstance(value, bool | np.bool_)


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number of Python or numpy, and no truth value."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite number of Python or numpy, and no truth value."""
    return is_whole(value) or (isinstance(value, float | np.floating) and math.isfinite(value))


def within(minimum: float | None, maximum: float | None, above: float | None = None) -> str:
    """Return a range as text: ``from 0 to 1``, ``from 1``, ``above 0 up to 1``, or nothing."""
    if above is not None:
        low, to = f" above {above:.12g}", " up to"
    else:
        low, to = ("", " up to") if minimum is None else (f" from {minimum:.12g}", " to")
    return low if maximum is None else f"{low}{to} {maximum:.12g}"


def check_whole(
    name: str,
    value: Any,
    minimum: int | None = 0,
    maximum: int | None = None,
    error: Error = InputError,
) -> int:
    """Return a whole number within a range as an ``int``."""
    if (
        not is_whole(value)
        or (minimum is not None and value < minimum)
        or (maximum is not None and value > maximum)
    ):
        raise error(f"{name} is {value!r}; it must be a whole number{within(minimum, maximum)}")
    return int(value)


def check_number(
    name: str,
    value: Any,
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    above: float | None = None,
    error: Error = InputError,
) -> float:
    """Return a finite number within a range, and above ``above``, as a number of Python."""
    # numpy would convert the limits to the type of the value, such as float16.
    number: float = value.item() if isinstance(value, np.generic) else value
    if (
        not is_number(value)
        or (minimum is not None and number < minimum)
        or (maximum is not None and number > maximum)
        or (above is not None and not number > above)
    ):
        kind = "finite number" if minimum is maximum is above is None else "number"
        exponent = isinstance(value, str) and re.fullmatch(r"[-+]?[\d.]+e[-+]?\d+", value)
        hint = ", in YAML with a point, as 1.0e-2" if exponent else ""
        raise error(
            f"{name} is {value!r}; it must be a {kind}{within(minimum, maximum, above)}{hint}"
        )
    return number


def check_flag(name: str, value: Any, error: Error = InputError) -> bool:
    """Return a truth value as a ``bool``."""
    if not is_flag(value):
        raise error(f"{name} is {value!r}; it must be true or false")
    return bool(value)


def check_text(name: str, value: Any, error: Error = InputError) -> str:
    """Return a non-empty text."""
    if not isinstance(value, str) or not value:
        raise error(f"{name} is {value!r}; it must be a non-empty text")
    return value


def check_path(name: str, value: Any, error: Error = InputError) -> str | os.PathLike[str]:
    """Return a possible name or path of a file; the file need not exist."""
    fine = isinstance(value, str | os.PathLike) and bool(os.fspath(value))
    try:
        fine = fine and b"\0" not in os.fsencode(value)
    except UnicodeEncodeError:  # a lone surrogate
        fine = False
    if not fine:
        raise error(f"{name} is {value!r:.200}; it must be a name or a path")
    return value


def check_choice(name: str, value: Any, choices: Iterable[str], error: Error = InputError) -> str:
    """Return one of several names; the error suggests the nearest name."""
    known = list(choices)
    if not isinstance(value, str) or value not in known:
        raise error(
            f"{name} is {value!r}; it must be one of {', '.join(known)}{did_you_mean(value, known)}"
        )
    return value


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """Return the end of a message that suggests the nearest known name, if one is near."""
    near = nearest(name, known)
    return f" (did you mean {near!r}?)" if near else ""


def check_names(name: str, values: Any, error: Error = InputError) -> tuple[str, ...]:
    """Return a list of different non-empty texts as a tuple."""
    listed = isinstance(values, list | tuple) and len(values) > 0
    if not listed or not all(isinstance(value, str) and value for value in values):
        raise error(f"{name} is {values!r}; it must be a list of names")
    if len(set(values)) < len(values):
        raise error(f"{name} are {', '.join(values)}; name each once")
    return tuple(values)


def check_seed(seed: Any, name: str = "seed", maximum: int | None = None) -> int:
    """Return a seed, a whole number from 0, as an ``int``."""
    return check_whole(name, seed, 0, maximum)


def check_array(
    name: str,
    value: ArrayLike,
    shape: Sequence[int | None],
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    error: Error = InputError,
) -> NDArray[np.float64]:
    """Return a new array of finite numbers within a range."""
    try:
        if np.iscomplexobj(value):
            raise TypeError  # numpy would drop the imaginary part
        # Always a copy: the caller may write to its array later.
        array = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{name} is {value!r:.200}; it must hold numbers") from None
    if not _fits(array, shape):
        wanted = ", ".join("any" if n is None else str(n) for n in shape) + (
            "," if len(shape) == 1 else ""
        )
        raise error(f"{name} has shape {array.shape}; it must have ({wanted})")
    wrong = ~np.isfinite(array) | _outside(array, minimum, maximum)
    if wrong.any():
        raise error(
            f"{name} holds {_first(array, wrong)}; it must be finite{within(minimum, maximum)}"
        )
    return array


def _fits(array: NDArray[Any], shape: Sequence[int | None]) -> bool:
    """Return whether an array has a shape."""
    return array.ndim == len(shape) and all(
        n in (None, m) for n, m in zip(shape, array.shape, strict=True)
    )


def _outside(
    array: NDArray[Any], minimum: float | None, maximum: float | None
) -> NDArray[np.bool_]:
    """Return a mask of the numbers beyond one of two limits."""
    below = False if minimum is None else array < minimum
    above = False if maximum is None else array > maximum
    return np.zeros(array.shape, np.bool_) | below | above


def _first(array: NDArray[Any], wrong: NDArray[np.bool_]) -> str:
    """Return the first of the wrong numbers, with its index."""
    place = tuple(int(i) for i in np.argwhere(wrong)[0])
    at = f" at {place[0] if len(place) == 1 else place}" if place else ""
    return f"{array[place]}{at}"


def as_array(values: Any) -> NDArray[Any]:
    """Return values as an array; of objects for lists of different lengths, to refuse its type."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError):
        return np.empty(0, object)


def check_whole_array(
    name: str,
    value: ArrayLike,
    *shapes: tuple[int | None, ...],
    minimum: int | None = None,
    maximum: int | None = None,
) -> NDArray[np.int64]:
    """Return a new array of whole numbers within a range, in one of the ``shapes`` if any.

    Numbers with a fraction are refused.
    """
    array = as_array(value)
    if array.size == 0 and array.dtype == np.float64:  # numpy's type of an empty list
        array = array.astype(np.int64)
    fits = not shapes or any(_fits(array, shape) for shape in shapes)
    if array.dtype.kind not in "iu" or not fits:
        wanted = " or ".join(str(shape).replace("None", "any") for shape in shapes)
        found = (
            f"has shape {array.shape} and type {array.dtype}" if array.ndim else f"is {value!r:.80}"
        )
        raise InputError(
            f"{name} {found}; it must hold whole numbers"
            + (f" in shape {wanted}" if shapes else "")
        )
    wrong = _outside(array, minimum, maximum)
    if wrong.any():
        has = "holds" if array.ndim else "is"
        raise InputError(
            f"{name} {has} {_first(array, wrong)}; it must be a whole"
            f" number{within(minimum, maximum)}"
        )
    return array.astype(np.int64)


def check_facts(name: str, values: Any) -> Mapping[str, str | int | float | bool]:
    """Return a read-only copy of texts, numbers and truth values by name."""
    if not isinstance(values, Mapping):
        raise InputError(f"{name} is {values!r:.80}; it must hold texts and numbers by name")
    for key, value in values.items():
        if not isinstance(key, str) or not isinstance(value, str | bool | int | float):
            raise InputError(
                f"{name} holds {key!r}: {value!r:.80}; it must hold texts and numbers by name"
            )
    return MappingProxyType(dict(values))
