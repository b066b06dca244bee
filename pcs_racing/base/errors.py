"""Errors for bad input. A message is one line that names the value and the correct form."""

__all__ = ["ConfigError", "InputError", "MapError", "UnknownNameError"]


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


def _shortened(message: str) -> str:
    line = "\\n".join(message.splitlines())
    return line if len(line) <= _LONGEST else f"{line[:1500]} ... {line[-400:]}"
