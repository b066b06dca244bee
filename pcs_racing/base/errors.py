"""Errors for bad input, and the rule for their use.

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
"""

import difflib
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec

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
    near = difflib.get_close_matches(str(name), names, n=1)
    return f"{f'did you mean {near[0]!r}? ' if near else ''}there are: {', '.join(names)}"


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
                f'{name} is needed for this: pip install "pcs-racing[{extra}]"', name=name
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
