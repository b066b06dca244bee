"""The zoo: agents and drivers by name.

Those of this package are listed in :data:`SHIPPED`. A distribution adds its own in the entry point group
``pcs_racing.agents``: ``name = "package.module:function"``. The function takes a
:class:`pcs_racing_agents.agents.Setting`, the keywords ``name`` and ``seed``, and options of its own; it returns an
agent, a driver, or any object with ``predict``. A program calls :func:`register_agent`. All are imported when they are
asked for.
"""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.reading import plain_yaml
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.planners.registry import parse_policy, planner_names
from pcs_racing.race.config import RaceConfig
from pcs_racing_agents.agents.agent import Agent, Competitor, Driver, as_competitor
from pcs_racing_agents.agents.setting import Setting, make_setting

__all__ = [
    "ENTRY_POINTS",
    "SHIPPED",
    "Entry",
    "build",
    "build_member",
    "entries",
    "make",
    "names",
    "options",
    "parse_agent",
    "register_agent",
]

ENTRY_POINTS = "pcs_racing.agents"
"""Entry point group in which a distribution names its agents: ``name = "package.module:function"``."""

ALWAYS = "always-"
_ALWAYS_PLACE = "pcs_racing_agents.agents.blind:always"


@dataclass(frozen=True, eq=False)
class Entry:
    """An agent or a driver of the zoo.

    Attributes
    ----------
    build : callable
        ``build(setting, name=..., seed=..., **options)`` makes it.
    summary : str
        What it does, in a sentence.
    source : str
        Where the idea comes from.
    needs : str
        What it must have learned before it can race: "", "fit" or "network"; "agents" for what its
        members must have learned.
    defaults : Mapping
        Options that differ from those of other entries with the same function.
    moves : bool
        Whether it moves between the policies of the archive; drivers do not.
    """

    build: Callable[..., Any]
    summary: str
    source: str = ""
    needs: str = ""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = True


SHIPPED = {
    "never-switch": "pcs_racing_agents.agents.blind:NEVER_SWITCH",
    "random-moves": "pcs_racing_agents.agents.blind:RANDOM_MOVES",
    "best-schedule": "pcs_racing_agents.agents.blind:BEST_SCHEDULE",
    "best-fixed": "pcs_racing_agents.agents.blind:BEST_FIXED",
    "cfr-argmax": "pcs_racing_agents.agents.from_network:CFR_ARGMAX",
    "cfr-regret-matching": "pcs_racing_agents.agents.from_network:CFR_REGRET_MATCHING",
    "normalised-regret": "pcs_racing_agents.agents.from_network:NORMALISED_REGRET",
    "advantage": "pcs_racing_agents.agents.from_network:ADVANTAGE",
    "static-q": "pcs_racing_agents.agents.from_network:STATIC_Q",
    "nash": "pcs_racing_agents.agents.from_network:NASH",
    "adaptive": "pcs_racing_agents.agents.from_network:ADAPTIVE",
    "response": "pcs_racing_agents.agents.from_network:RESPONSE",
    "restricted-response": "pcs_racing_agents.agents.mixture:RESTRICTED_RESPONSE",
    "psro": "pcs_racing_agents.agents.mixture:PSRO",
    "ppo": "pcs_racing_agents.agents.from_network:PPO",
    "receding-horizon": "pcs_racing_agents.agents.receding_horizon:RECEDING_HORIZON",
    "random-policy": "pcs_racing_agents.agents.drivers:RANDOM_POLICY",
    "lane-switcher": "pcs_racing_agents.agents.drivers:LANE_SWITCHER",
    "ppo-drive": "pcs_racing_agents.agents.drivers:PPO_DRIVE",
    "gap-follower": "pcs_racing_agents.agents.drivers:GAP_FOLLOWER",
    "pure-pursuit": "pcs_racing_agents.agents.drivers:PURE_PURSUIT",
}
"""Agents and drivers of this package: name and place of the entry. A new one is a file and a line here.

Besides there is ``always-MOVE`` for every move.
"""

_registered: dict[str, Entry] = {}


def register_agent(name: str, build: Callable[..., Any], summary: str = "", source: str = "") -> None:
    """Make an agent known by name in this process.

    Parameters
    ----------
    name : str
    build : callable
        ``build(setting, name=..., seed=..., **options)`` returns an agent, a driver, or any object with ``predict``.
    summary, source : str
        What reports say of it; by default the first line of the function's docstring.

    Raises
    ------
    InputError
        If the name is no plain text or is taken by another one.
    """
    if not isinstance(name, str) or not name or any(sign in name for sign in ":=, \t\n") or name.startswith(ALWAYS):
        raise InputError(
            f"agent name {name!r} must be text without ':', '=', ',' and spaces, not beginning with always-"
        )
    known = _registered.get(name)
    if name in SHIPPED or (known is not None and known.build is not build):
        raise InputError(f"there is an agent {name!r} already; give yours another name")
    _registered[name] = Entry(build, summary or _first_line(build), source)


def entries() -> dict[str, Entry]:
    """Return everything that has a name, without importing what other distributions declare."""
    declared = {name: Entry(_ImportPath(name, place), f"from {place}") for name, place in _declared().items()}
    return {**declared, **_registered, **{name: resolve_name(place) for name, place in SHIPPED.items()}}


def names(
    archive: PolicyArchive | str | Path = "default", race: GameConfig | RaceConfig | str | Path = "paper"
) -> list[str]:
    """Return the names of all agents and drivers that can be asked for with an archive, sorted.

    Those that must learn first also need a network or a fit (:class:`Entry`).
    """
    constant = [f"{ALWAYS}{''.join(move.split())}" for move in make_setting(archive, race).moves[:-1]]
    return sorted({*_declared(), *_registered, *SHIPPED, *constant})


def make(
    name: str,
    *,
    archive: PolicyArchive | str | Path = "default",
    race: GameConfig | RaceConfig | str | Path = "paper",
    seed: int = 0,
    **options: Any,
) -> Any:
    """Make an agent or a driver by name.

    Parameters
    ----------
    name : str
        One of :func:`names`; or a policy as text, such as ``"lattice:pace=0.8"``.
    archive, race
        The game that it is for, as in :func:`pcs_racing.make_game`.
    seed : int
        What mixed strategies draw with.
    **options
        Of the agent; ``docs/agents.md`` lists them.

    Returns
    -------
    Agent or Driver
        Third parties' agents may be any object with ``predict``.

    Raises
    ------
    UnknownNameError
        If there is no such agent, or what it must have learned is not there.
    InputError
        If an option is unknown or impossible, or a network or fit belongs to another game.

    Examples
    --------
    >>> make("always-aggressiveness+").name
    'always-aggressiveness+'
    """
    return build(name, make_setting(archive, race), seed=seed, **options)


def build(name: str, setting: Setting, *, seed: int = 0, **given: Any) -> Any:
    """Make an agent or a driver for a setting; see :func:`make`."""
    if not isinstance(name, str):
        raise InputError(f"agent {name!r} must be a name")
    known = entries()
    if name.startswith(ALWAYS):
        for key in given:
            raise InputError(f"agent {name!r} has no option {key!r}; it has none")
        return resolve_name(_ALWAYS_PLACE)(setting, name.removeprefix(ALWAYS), name="".join(name.split()), seed=seed)
    if name not in known:
        if name.partition(":")[0] in planner_names() and not given:
            return as_competitor(parse_policy(name))
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UnknownNameError(f"agent {name!r} is unknown; {hint}there are: {', '.join(sorted(known))}, {ALWAYS}MOVE")
    entry = known[name]
    if not isinstance(entry.build, _ImportPath):
        _check_options(name, entry.build, given)
    made = entry.build(setting, name=name, seed=seed, **{**entry.defaults, **given})
    if not isinstance(made, Agent | Driver):
        return as_competitor(made, name)
    facts = {"does": entry.summary, "source": entry.source, **made.facts}
    return replace(made, facts={key: value for key, value in facts.items() if value})


def build_member(given: str | Agent, setting: Setting, seed: int) -> Agent:
    """Return an agent that another agent consists of: as it is, or made by name.

    Raises
    ------
    InputError
        If it makes no moves.
    """
    made = given if isinstance(given, Agent) else build(given, setting, seed=seed)
    if not isinstance(made, Agent):
        raise InputError(f"{given!r} makes no moves; only agents can be part of another one")
    return made


def parse_agent(text: str, setting: Setting, *, seed: int = 0) -> Competitor:
    """Make an agent from text: a name, which may be followed by options as in ``"cfr-argmax:network=out/net"``.

    What begins with the name of a planner is a policy, as in ``"lane-switcher:3"``.

    Raises
    ------
    InputError
        As :func:`make`, or if the text is of another form.
    """
    name, separator, rest = str(text).strip().partition(":")
    if not separator or name not in entries() or name in planner_names():
        return build(str(text).strip(), setting, seed=seed)
    given: dict[str, Any] = {}
    for part in rest.split(","):
        key, equals, value = part.partition("=")
        if not equals or key.strip() in given or key.strip() in ("name", "seed", "setting"):
            raise InputError(f"agent {text!r}: {part!r} is not of the form option=value, each option once")
        try:
            given[key.strip()] = plain_yaml(value)
        except InputError:
            raise InputError(f"agent {text!r}: {value!r} is no value; it must be a number or plain text") from None
    made = build(name, setting, seed=seed, **given)
    return as_competitor(made, str(text).strip())


@dataclass(frozen=True)
class _ImportPath:
    """A function of another distribution, imported when it is first called."""

    name: str
    place: str

    def __call__(self, setting: Setting, **options: Any) -> Any:
        try:
            function = resolve_name(self.place)
        except Exception as error:  # whatever a third party's module raises when it is imported
            raise InputError(f"agent {self.name!r} can't be loaded from {self.place}: {error}") from error
        return function(setting, **options)


@lru_cache(maxsize=1)
def _declared() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}


def options(name: str) -> dict[str, Any]:
    """Return the options of an entry with their defaults (None: it is worked out); of another distribution's, none."""
    entry = entries()[name]
    if isinstance(entry.build, _ImportPath):
        return {}
    free = _free_options(entry.build)
    return {key: entry.defaults.get(key, value) for key, value in free.items()}


def _free_options(function: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters
    return {
        key: None if parameter.default is parameter.empty else parameter.default
        for key, parameter in parameters.items()
        if key not in ("setting", "name", "seed") and parameter.kind is not parameter.VAR_KEYWORD
    }


def _check_options(name: str, function: Callable[..., Any], given: Iterable[str]) -> None:
    parameters = inspect.signature(function).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return
    free = _free_options(function)
    for key in given:
        if key not in free:
            raise InputError(f"agent {name!r} has no option {key!r}; it has {', '.join(free) or 'none'}")


def _first_line(function: Callable[..., Any]) -> str:
    return (inspect.getdoc(function) or "").partition("\n")[0]
