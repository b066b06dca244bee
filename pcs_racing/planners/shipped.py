"""Names of racers: of the planners of this package, and of distributions; texts with options.

The code of the planners takes a second to import.
"""

import re
from functools import cache
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError

SHIPPED = {
    "bimatrix-game": "pcs_racing.planners.field.bimatrix:BIMATRIX",
    "disparity-extender": "pcs_racing.planners.field.disparity_extender:DISPARITY_EXTENDER",
    "follow-the-gap": "pcs_racing.planners.field.follow_the_gap:FOLLOW_THE_GAP",
    "gap-follower": "pcs_racing.planners.field.gap_follower:GAP_FOLLOWER",
    "iterated-best-response": "pcs_racing.planners.field.best_response:BEST_RESPONSE",
    "lane-switcher": "pcs_racing.planners.lane_switcher:LANE_SWITCHER",
    "lattice": "pcs_racing.planners.lattice:LATTICE",
    "lidar-ppo": "pcs_racing.planners.field.lidar_ppo:LIDAR_PPO",
    "line-ppo": "pcs_racing.planners.line_ppo:LINE_PPO",
    "mppi": "pcs_racing.planners.field.mppi:MPPI",
    "predictive-spliner": "pcs_racing.planners.field.predictive_spliner:PREDICTIVE_SPLINER",
    "pure-pursuit": "pcs_racing.planners.field.pure_pursuit:PURE_PURSUIT",
    "spliner": "pcs_racing.planners.field.spliner:SPLINER",
    "stanley": "pcs_racing.planners.field.stanley:STANLEY",
}
"""Planners of this package: name and place. A new planner is a file and a line here."""


def split_name(text: str) -> tuple[str, str, str]:
    """Return the name of a planner or an agent, the colon after it, and the rest.

    The result is as in ``str.partition``. The name may be the path of a Python file, with spaces
    and a drive of Windows.
    """
    file = re.match(r"\s*((?:[A-Za-z]:[\\/])?[^:]*\.py)\s*(?:(:)(.*))?$", text, re.DOTALL)
    name, separator, rest = file.groups("") if file else text.partition(":")
    return name.strip(), separator, rest


def split_options(text: str, rest: str) -> dict[str, str]:
    """Return the values of the options in the rest of a text, ``name=value,...``, by name."""
    values: dict[str, str] = {}
    # Commas in brackets separate nothing; a longer look ahead would make long texts slow.
    for option in re.split(r",(?![^\[]{0,500}\])", rest):
        name, equals, value = (part.strip() for part in option.partition("="))
        if not equals or name in values:
            raise InputError(f"{text!r}: {option!r} is not of the form name=value, each name once")
        values[name] = value
    return values


def check_new_name(noun: str, name: Any, taken: bool) -> None:
    """Refuse a name that no text can hold, or that is taken."""
    if not isinstance(name, str) or not name or any(sign in name for sign in ":=, \t\n"):
        raise InputError(f"{noun} name {name!r} must be text without ':', '=', ',' and spaces")
    if taken:
        raise InputError(f"there is a {noun} {name!r} already; give yours another name")


@cache
def declared(group: str) -> dict[str, str]:
    """Return the places that distributions declare in an entry point group, by name."""
    return {point.name: point.value for point in entry_points(group=group)}


def load_place(what: str, place: str) -> Any:
    """Return the object at a place, ``"package.module:NAME"``, of any distribution."""
    try:
        return resolve_name(place)
    except Exception as error:  # any error in the import of a third-party module
        raise InputError(f"{what} can't be loaded from {place}: {error}") from error
