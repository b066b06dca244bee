"""The zoo: a registry of agents and fixed policies by name.

:data:`SHIPPED` lists the agents of this package. A distribution adds agents in the entry point
group ``pcs_racing.agents``: ``name = "package.module:function"``. The function takes a
:class:`pcs_racing.game.RaceGame`, the keywords ``name`` and ``seed``, and options of its
own; it returns an agent, a fixed policy, or any object with ``act``. A program calls
:func:`register_agent`. A module is imported when its agent is built.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.base.files import plain_yaml
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.make import make_game
from pcs_racing.game.players import ALWAYS, Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing.planners.racers import Reader, Request, renamed
from pcs_racing.planners.shipped import (
    check_new_name,
    declared,
    load_place,
    split_name,
    split_options,
)
from pcs_racing.race.config import Rules
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.shipped import SHIPPED

ENTRY_POINTS = "pcs_racing.agents"
"""Entry point group for the agents of a distribution: ``name = "package.module:function"``."""


@dataclass(frozen=True, eq=False)
class Entry:
    """An agent or a fixed policy of the zoo."""

    build: Callable[..., Any]  #: Maker: ``build(spec, name=..., seed=..., **options)``.
    summary: str  #: Description in a sentence.
    source: str = ""  #: Source of the idea.
    needs: str = ""  #: Training result that it needs: "", "fit", "network" or "networks".
    #: Options that differ between entries with the same function.
    defaults: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = True  #: True if it makes moves; False for a fixed policy.


_registered: dict[str, Entry] = {}


def register_agent(
    name: str, build: Callable[..., Any], summary: str = "", source: str = ""
) -> None:
    """Register an agent under a name in this process.

    Parameters
    ----------
    build : callable
        Function ``build(spec, name=..., seed=..., **options)``; it returns an agent, a fixed
        policy, or any object with ``act``.
    summary, source : str
        Texts for reports; by default the summary is the first line of the function's docstring.
    """
    existing = _registered.get(name)
    other = existing is not None and existing.build is not build
    check_new_name("agent", name, other or name in SHIPPED or str(name).startswith(ALWAYS))
    _registered[name] = Entry(build, summary or _first_line(build), source)


def entries() -> dict[str, Entry]:
    """Return all entries by name, without importing the modules of other distributions."""
    return {
        **{
            name: Entry(_late_function(name, source), f"from {source}")
            for name, source in declared(ENTRY_POINTS).items()
        },
        **_registered,
        **{name: resolve_name(reference) for name, reference in SHIPPED.items()},
    }


def names(
    archive: PolicyArchive | str | Path = "default",
    rules: Rules | str | Path = "paper",
) -> list[str]:
    """Return the names of all agents and fixed policies for an archive, sorted.

    Trained agents also need a network or a fit (:class:`Entry`).
    """
    constant = [
        f"{ALWAYS}{''.join(move.split())}" for move in make_game(None, archive, rules).moves[:-1]
    ]
    return sorted({*declared(ENTRY_POINTS), *_registered, *SHIPPED, *constant})


def make(
    name: str,
    *,
    archive: PolicyArchive | str | Path = "default",
    rules: Rules | str | Path = "paper",
    seed: int = 0,
    **options: Any,
) -> Any:
    """Make an agent or a fixed policy by name.

    A third-party agent may be any object with ``act``.

    Parameters
    ----------
    name : str
        Text for :func:`pcs_racing.racer`.
    archive, rules
        Game of the agent, as in :func:`pcs_racing.make_game`.
    seed : int
        Seed of the draws of mixed strategies.
    **options
        Options of an agent of the zoo; ``docs/agents.md`` lists them.

    Examples
    --------
    >>> make("always-aggressiveness+").name
    'always-aggressiveness+'
    """
    return build(name, make_game(None, archive, rules), seed=seed, **options)


def build(name: str, spec: RaceGame, *, seed: int = 0, **options: Any) -> Any:
    """Make a racer for a game spec; only agents of the zoo have options."""
    available = entries()
    if name not in available and not options:
        return competitor(name, spec, seed=seed)
    if name not in available:
        raise UnknownNameError(f"agent {name!r} is unknown; {choices(name, sorted(available))}")
    entry = available[name]
    _check_options(name, entry.build, options)
    made = entry.build(spec, name=name, seed=seed, **{**entry.defaults, **options})
    if not isinstance(made, Agent | PolicySet):
        return competitor(made, spec, name=name)
    facts = {"does": entry.summary, "source": entry.source, **made.facts}
    return replace(made, facts={key: value for key, value in facts.items() if value})


def read_agent(request: Request) -> Competitor | None:
    """Return the agent of a text: a name, or a name with options."""
    name, separator, rest = split_name(request.text)
    if name not in entries():
        return None
    values: dict[str, Any] = {}
    for key, value in split_options(request.text, rest).items() if separator else ():
        try:
            values[key] = plain_yaml(value)
        except InputError:
            raise InputError(
                f"agent {request.text!r}: {value!r} is no value; it must be a number or plain text"
            ) from None
    _check_options(name, entries()[name].build, values)
    return renamed(build(name, request.asked_game, seed=request.seed, **values), request.text)


ZOO = Reader(read_agent, lambda: sorted(entries()))


def _late_function(name: str, reference: str) -> Callable[..., Any]:
    """Return a function of another distribution, imported when it is called."""

    def build(spec: RaceGame, **options: Any) -> Any:
        return load_place(f"agent {name!r}", reference)(spec, **options)

    return build


def options(name: str) -> dict[str, Any]:
    """Return the options of an entry with their defaults (None: computed).

    The result is empty for an entry of another distribution.
    """
    entry = entries()[name]
    free = _free_options(entry.build)
    return {key: entry.defaults.get(key, value) for key, value in free.items()}


def _free_options(function: Callable[..., Any]) -> dict[str, Any]:
    _, *parameters = inspect.signature(function).parameters.items()  # without the game
    return {
        key: None if parameter.default is parameter.empty else parameter.default
        for key, parameter in parameters
        if key not in ("name", "seed") and parameter.kind is not parameter.VAR_KEYWORD
    }


def _check_options(name: str, function: Callable[..., Any], options: Iterable[str]) -> None:
    parameters = inspect.signature(function).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return
    free = _free_options(function)
    for key in options:
        if key not in free:
            raise InputError(
                f"agent {name!r} has no option {key!r}; it has {', '.join(free) or 'none'}"
            )


def _first_line(function: Callable[..., Any]) -> str:
    return (inspect.getdoc(function) or "").partition("\n")[0]
