"""Planners by name, and policies from text.

The planners of this package are listed in :data:`SHIPPED`. Other planners get a name in one of two
ways: a distribution declares it in the entry point group ``pcs_racing.planners``, or a program
calls :func:`register_planner`. A planner is imported at the first use of its name.
"""

import copyreg
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.planners.planner import Planner, Policy, PolicySet
from pcs_racing.planners.racers import Reader, Request
from pcs_racing.planners.shipped import (
    SHIPPED,
    check_new_name,
    declared,
    load_place,
    split_name,
    split_options,
)

ENTRY_POINTS = "pcs_racing.planners"
"""Entry point group of the planners of a distribution: ``name = "package.module:PLANNER"``."""

_planners: dict[str, Planner] = {}
_places: dict[str, str] = dict(SHIPPED)


def register_planner(planner: Planner | str, *, name: str | None = None) -> None:
    """Register a planner under its name in this process.

    A second registration of the same planner changes nothing. A place
    (``"package.module:PLANNER"``) needs a ``name``, and is imported at the first use of the name. A
    planner has its own name.
    """
    if isinstance(planner, Planner):
        name = planner.name
        taken = name in planner_names() and get_planner(name) is not planner
    else:
        taken = _places.get(str(name), planner) != planner
    # The name of a file is its path, with any characters.
    own_file = isinstance(name, str) and name.endswith(".py")
    check_new_name("planner", "file" if own_file else name, taken)
    names: dict[Any, Any] = _planners if isinstance(planner, Planner) else _places
    names.setdefault(name, planner)


def planner_names() -> list[str]:
    """Return the names of all planners, sorted."""
    return sorted({*_planners, *_declared()})


def get_planner(name: str) -> Planner:
    """Return the planner with a name."""
    if name not in _planners:
        if name not in _declared():
            raise UnknownNameError(f"planner {name!r} is unknown; {choices(name, planner_names())}")
        place = _declared()[name]
        planner = load_place(f"planner {name!r}", place)
        if not isinstance(planner, Planner):
            raise InputError(
                f"planner {name!r}: {place} is of type {type(planner).__name__}; it must be a"
                " Planner"
            )
        _planners[name] = planner
    return _planners[name]


def parse_policy(text: str) -> Policy:
    """Return the policy of a text: a planner's name, with an optional variant or parameters.

    Texts are ``"lattice"``, ``"lattice:pace=0.8,side_margin=0.2"`` (the other parameters as in the
    default), ``"lane-switcher:3"`` (a variant) or ``"lattice:early,pace=0.7"`` (the other
    parameters as in the variant). The text becomes the policy's name.
    """
    if not isinstance(text, str):
        raise InputError(f"policy {text!r} must be text such as 'lattice:pace=0.8'")
    name, _, _ = split_name(text)
    return policy_of(get_planner(name), text)


def policy_of(planner: Planner, text: str) -> Policy:
    """Return the policy of a planner with the settings of a text (:func:`parse_policy`)."""
    name, separator, rest = split_name(text)
    rest = "".join(rest.split())
    if not separator:
        return planner.policy(name=name)
    if "=" not in rest:
        return planner.policy(rest, name=f"{name}:{rest}")
    first, _, others = rest.partition(",")
    variant, settings = (None, rest) if "=" in first else (first, others)
    base, values = planner.policy(variant), {}
    for key, value in split_options(text, settings).items():
        try:
            values[key] = float(value)
        except ValueError:
            raise InputError(f"policy {text!r}: {key} is {value!r}; it must be a number") from None
    (theta,) = planner.complete(list(values), [list(values.values())], base.parameters)
    return planner.policy(theta, name=f"{name}:{rest}")


def _declared() -> dict[str, str]:
    """Return the import paths of declared planners, by name."""
    return {**declared(ENTRY_POINTS), **_places}


def _by_place(planner: Planner) -> Any:
    """Copy and pickle a planner by its place, if it has a place.

    Without this, numba would copy its functions, and compile them again.
    """
    if _planners.get(planner.name) is planner and planner.name in _declared():
        return resolve_name, (_declared()[planner.name],)
    return planner.__reduce_ex__(2)


copyreg.pickle(Planner, _by_place)


ANY = "any"
"""Variant that means all variants of a planner."""


def read_planner(request: Request) -> Policy | PolicySet | None:
    """Return the policy, or the policies, of a planner."""
    if isinstance(request.given, Policy):
        return request.given
    if isinstance(request.given, Planner):
        return request.given.policy()
    name, _, rest = split_name(request.text)
    if name not in planner_names():
        return None
    if name.endswith(".py") and rest and rest.strip() not in get_planner(name).variants:
        return None  # an agent or a function of the file
    if rest.strip() != ANY:
        return parse_policy(request.text)
    planner = get_planner(name)
    if not planner.variants:
        raise InputError(f"planner {name!r} has no variants; {name!r} is its one policy")
    variants = [planner.policy(one, name=f"{name}:{one}") for one in planner.variants]
    return PolicySet(f"{name}:{ANY}", tuple(variants))


PLANNERS = Reader(read_planner, planner_names)
