"""The errors that bad input raises: one line that names the value and says what would be right."""

import difflib
from collections.abc import Iterable

__all__ = [
    "ConfigError",
    "InputError",
    "MapError",
    "UnknownArgumentError",
    "UnknownNameError",
    "choices",
    "unknown_argument",
]


_LONGEST = 2000


class InputError(ValueError):
    """A value handed to the package is impossible; the message names it and says what would be right.

    The value may be anything: line breaks in a message are written out, and the middle of one of more than 2000
    characters is left out.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*(_shortened(arg) if isinstance(arg, str) else arg for arg in args))


class MapError(InputError):
    """A map folder, or a file in it, can't be raced on."""


class ConfigError(InputError):
    """A configuration holds an unknown key or an impossible value."""


class UnknownNameError(InputError, KeyError):
    """A name stands for nothing that is registered; the message lists the names that do."""

    def __str__(self) -> str:
        """Show the message itself (``KeyError`` would show its repr)."""
        return str(self.args[0]) if self.args else ""


class UnknownArgumentError(InputError, TypeError):
    """A function or class has no argument of this name."""


def unknown_argument(function: str, name: str, known: Iterable[str]) -> UnknownArgumentError:
    """Make the error for an unknown keyword argument, in Python's words and with the nearest known name."""
    return UnknownArgumentError(f"{function}() got an unexpected keyword argument {name!r}; {choices(name, known)}")


def choices(name: str, known: Iterable[str]) -> str:
    """Return the end of an error message about an unknown name: the nearest known one, and all of them."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f"{f'did you mean {near[0]!r}? ' if near else ''}there are: {', '.join(names)}"


def _shortened(message: str) -> str:
    line = "\\n".join(message.splitlines())
    return line if len(line) <= _LONGEST else f"{line[:1500]} ... {line[-400:]}"
