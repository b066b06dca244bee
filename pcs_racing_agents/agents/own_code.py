"""User code as an agent or a planner: ``package.module:name``, ``file.py:name`` or ``model.zip``.

Functions here run user code. Call them with arguments of the command line or of a program, never
with names from files.
"""

import importlib
import inspect
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError, one_line
from pcs_racing.game.competitor import is_model
from pcs_racing.planners.imported import drivers_from, is_driver
from pcs_racing.planners.learned import is_planner_folder, load_planner
from pcs_racing.planners.own_files import run_file
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import parse_policy, planner_names, policy_of
from pcs_racing.planners.shipped import split_name


def is_code(text: str) -> bool:
    """Return whether a text has the form of a code reference, without a lookup."""
    place, _, name = split_name(text)
    return place.endswith(".py") or (place.replace(".", "").isidentifier() and name.isidentifier())


def own_code(text: str, *given: Any) -> Any:
    """Return the object that a text names, or None if it names no code.

    A planner's class becomes its policy (:func:`pcs_racing.drivers_from`). Any other class or
    function is called; it gets the ``given`` arguments if it needs an argument or if several are
    given. The search for a module includes the working directory. A policy's name is the text, so
    another process can find the code. A file without a name means its first planner.
    """
    with one_line(text):
        return _made(text, *given)


def _made(text: str, *given: Any) -> Any:
    place, separator, name = split_name(text)
    file = place.endswith(".py")
    if file and not separator:
        return replace(next(iter(drivers_from(place).values())), name=text)
    if not name.isidentifier() or (place in planner_names() and not file):
        return None
    if file:
        module = run_file(place)
    else:
        here = str(Path.cwd())
        if here not in sys.path:
            # As with "python -m", but at the end: a file here hides no installed package.
            sys.path.append(here)
        if not _is_module(place):
            return None
        try:
            module = importlib.import_module(place)
        except ImportError as error:
            raise InputError(f"{place} can't be imported: {error}") from error
    made: Any = getattr(module, name, None)
    if made is None:
        raise InputError(
            f"{text} is no planner and no agent: {place} has no class and no function {name!r}"
        )
    if is_driver(made):
        # The planner has the path as given, as on a command line that names the file.
        known = drivers_from(place if file else inspect.getfile(made))
        made = known[name if name in known else made.__name__]
    elif callable(made):
        needed = [
            one for one in inspect.signature(made).parameters.values() if one.default is one.empty
        ]
        made = made(*given) if len(given) > 1 else made(*given[: len(needed)])
    if made is None:
        raise InputError(f"{text} gives None; it must give a planner or an agent")
    made = made.policy() if isinstance(made, Planner) else made
    return replace(made, name=text) if isinstance(made, Policy) else made


def _is_module(name: str) -> bool:
    try:
        return name.replace(".", "").isidentifier() and importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False


def parse_own_policy(text: str) -> Policy:
    """Return the policy that a text names: as :func:`pcs_racing.parse_policy`, of a learned
    planner in a folder, or user code.
    """
    place, _, _ = split_name(text)
    if place not in planner_names() and is_planner_folder(place):
        return policy_of(load_planner(place), text)
    if is_model(text):
        from pcs_racing_agents.agents.sb3_files import load_model

        return load_model(text)
    made = own_code(text)
    if made is None:
        return parse_policy(text)
    if not isinstance(made, Policy):
        raise InputError(
            f"{text} gives {type(made).__name__!r}; here it must be a planner, not an agent"
        )
    return made
