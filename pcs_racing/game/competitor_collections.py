"""Registry of other packages' competitors.

It is a file of its own, since the rest of a game takes a second to import.
"""

from functools import lru_cache
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError

ENTRY_POINTS = "pcs_racing.opponents"
"""Entry point group for a distribution's module of competitors."""

_registered: dict[str, str] = {}


def register_competitors(name: str, module: str) -> None:
    """Register the competitors of a module in this process, under the name of their collection.

    The module, as ``"package.module"``, is imported when a name is not known otherwise.
    """
    if _registered.setdefault(name, module) != module:
        raise InputError(
            f"there are competitors {name!r} already, of {_registered[name]}; give yours another"
            " name"
        )


def collections() -> list[Any]:
    """Return the modules of all collections."""
    modules = []
    for name, place in {**_declared(), **_registered}.items():
        try:
            modules.append(resolve_name(place))
        except Exception as error:  # any error of a third-party module at its import
            raise InputError(
                f"the competitors {name!r} can't be loaded from {place}: {error}"
            ) from error
    return modules


@lru_cache(maxsize=1)
def _declared() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}
