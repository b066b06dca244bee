"""User code as a racer: ``file.py``, ``file.py:name`` or ``package.module:name``.

Functions here run user code, and only for a request that says ``code``: an argument of the command
line or of a program, never a name from a file.
"""

import importlib
import inspect
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError, one_line
from pcs_racing.planners.imported import drivers_from, is_driver, object_policy
from pcs_racing.planners.own_files import own_file
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import Racer, Reader, Request, racer, renamed
from pcs_racing.planners.shipped import split_name


def read_code(request: Request) -> Racer | None:
    """Return the racer of user code, or of an object with ``plan``.

    A driver's class becomes its policy (:func:`pcs_racing.drivers_from`). Any other class or
    function is called, with the game if it needs an argument. The racer's name is the text, so
    another process can find the code. A file without a name means its first driver.
    """
    if not request.text:
        return object_policy(request.given) if is_driver(type(request.given)) else None
    place, separator, name = split_name(request.text)
    file = place.endswith(".py")
    if not file and not (place.replace(".", "").isidentifier() and name.isidentifier()):
        return None
    if not request.code:
        raise UnknownNameError(
            f"{request.text!r} names code, and no file may run code by a name: give the object,"
            " racer(text, code=True); on the command line the name runs its code (in 'view' after"
            " --agents)"
        )
    with one_line(request.text):
        if file and not separator:
            return replace(next(iter(drivers_from(place).values())), name=request.text)
        made = _made(place, name, request)
        if made is None:
            raise InputError(f"{request.text} gives None; it must give a planner or an agent")
        found = racer(made, request.game, like=request.like, seed=request.seed)
        return renamed(found, request.text)


def _made(place: str, name: str, request: Request) -> Any:
    """Return the object with a name in a file or a module."""
    file = place.endswith(".py")
    module = own_file(place).module if file else _imported(place)
    made: Any = getattr(module, name, None)
    if made is None:
        raise InputError(f"{place} has no class and no function {name!r}")
    if is_driver(made):
        # The planner has the path as given, as on a command line that names the file.
        known = drivers_from(place if file else inspect.getfile(made))
        return known[name if name in known else made.__name__]
    if not callable(made) or isinstance(made, Policy):
        return made
    parameters = inspect.signature(made).parameters.values()
    needs_game = any(one.default is one.empty for one in parameters)
    return made(request.asked_game) if needs_game else made()


def _imported(place: str) -> Any:
    """Import a module; the search includes the working directory, after the installed packages."""
    here = str(Path.cwd())
    if here not in sys.path:
        # As with "python -m", but at the end: a file here hides no installed package.
        sys.path.append(here)
    try:
        if find_spec(place) is None:
            raise ImportError(f"there is no module {place}")
        return importlib.import_module(place)
    except (ImportError, ValueError) as error:
        raise InputError(f"{place} can't be imported: {error}") from error


CODE = Reader(read_code)
