"""The zoo: agents and drivers by name.

A distribution adds its own in the entry point group ``pcs_racing.agents``: ``name = "package.module:function"``. The
function takes a :class:`pcs_racing_agents.agents.Setting`, the keywords ``name`` and ``seed``, and options of its
own; it returns an agent, a driver, or any object with ``predict``. A program calls :func:`register_agent`.
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
from pcs_racing_agents.agents import agents, drivers
from pcs_racing_agents.agents.agent import Agent, Competitor, Driver, as_competitor
from pcs_racing_agents.agents.receding_horizon import receding_horizon
from pcs_racing_agents.agents.setting import Setting, make_setting

__all__ = [
    "ENTRY_POINTS",
    "ZOO",
    "Entry",
    "build",
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
        What it must have learned before it can race: "", "fit" or "network"; "agents" for what others must that it is
        made of.
    defaults : Mapping
        Options that tell it from other entries with the same function.
    moves : bool
        Whether it moves between the policies of the archive; drivers do not.
    """

    build: Callable[..., Any]
    summary: str
    source: str = ""
    needs: str = ""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = True


def _network(kind: str, decision: str, summary: str, source: str) -> Entry:
    return Entry(agents.from_network, summary, source, "network", {"kind": kind, "decision": decision})


def _driver(summary: str, source: str, **defaults: Any) -> Entry:
    return Entry(drivers.planner_driver, summary, source, defaults=defaults, moves=False)


ZOO: dict[str, Entry] = {
    "never-switch": Entry(agents.never_switch, "keeps its start policy for the whole race", "the paper's non-GT agent"),
    "random-moves": Entry(agents.random_moves, "draws every move, all with the same probability", "baseline"),
    "best-schedule": Entry(
        agents.best_schedule,
        "makes a fixed sequence of moves, the best one on training races",
        "baseline: open-loop, never observes the race",
        "fit",
    ),
    "best-fixed": Entry(
        agents.best_fixed,
        "moves to one policy of the archive, the best one on training races, and keeps it",
        "baseline: never observes the race",
        "fit",
    ),
    "cfr-argmax": _network(
        "regret",
        "argmax",
        "makes the move with the highest predicted counterfactual regret",
        "the paper's GT agent, Equations 8 and 9",
    ),
    "cfr-regret-matching": _network(
        "regret",
        "regret-matching",
        "draws a move with a probability proportional to its positive predicted counterfactual regret",
        "the paper's remark on regret matching (Zinkevich et al. 2007)",
    ),
    "normalised-regret": _network(
        "normalised",
        "argmax",
        "makes the move with the highest predicted regret, normalised to the same size at every decision",
        "cumulative regret, divided by its largest magnitude at the node",
    ),
    "advantage": _network(
        "advantage",
        "argmax",
        "makes the move with the highest predicted advantage against the exact equilibrium",
        "backward induction over matrix games",
    ),
    "static-q": _network(
        "static-q",
        "argmax",
        "plays a best response to an opponent that does not observe the race",
        "best response to a static opponent",
    ),
    "nash": _network(
        "nash", "sample", "draws its moves from an approximate equilibrium strategy", "backward induction, sampled"
    ),
    "adaptive": Entry(
        agents.adaptive,
        "follows the best blind strategy unless a network predicts a gain above a margin",
        "advantage over the best blind strategy, with a margin",
        "network",
    ),
    "response": _network(
        "gain",
        "argmax",
        "plays an approximate best response to the pool of opponents that it was trained against",
        "advantages in branched races, learned from the last step backwards (`pcs_racing_agents.learning.responses`)",
    ),
    "restricted-response": Entry(
        agents.restricted_response,
        "draws for each game whether to exploit a static opponent or to play an equilibrium",
        "after restricted Nash response (Johanson et al. 2007)",
        "agents",
    ),
    "psro": Entry(
        agents.psro,
        "draws an agent for each game, with the probabilities of an equilibrium of the game of choosing agents",
        "meta-strategy of PSRO (Lanctot et al. 2017)",
        "fit",
    ),
    "ppo": _network(
        "ppo",
        "argmax",
        "makes the most probable move of a policy trained by PPO",
        "Schulman et al. 2017, with Stable-Baselines3",
    ),
    "receding-horizon": Entry(
        receding_horizon,
        "simulates some steps ahead at every decision, and solves the small game of their outcomes",
        "receding horizon control, for the paper's first limitation: trees too deep for many decisions",
    ),
    "random-policy": Entry(
        drivers.random_policy,
        "keeps one of all policies that synthesis evaluated, in the archive or not",
        "the paper's random agent",
        moves=False,
    ),
    "lane-switcher": _driver(
        "race line or overtaking lane; 20 variants. In the paper's race `response`, and with it `adaptive`, learned "
        "against all of them; in either race `ppo` learned against four (1, 6, 11, 16)",
        "after the winner of the F1TENTH race at ICRA 2022, which is the unseen opponent in the paper",
    ),
    "ppo-drive": Entry(
        drivers.trained_driver,
        "a network trained by PPO in races sets steering and speed 25 times a second",
        "Schulman et al. 2017, with Stable-Baselines3",
        moves=False,
    ),
    "gap-follower": _driver("follows the largest gap in its lidar scan; has no map", "Sezer and Gokasan 2012"),
    "pure-pursuit": _driver("follows the race line and never overtakes", "baseline"),
}
"""What this package brings, by name; besides there is ``always-MOVE`` for every move."""

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
    if name in ZOO or (known is not None and known.build is not build):
        raise InputError(f"there is an agent {name!r} already; give yours another name")
    _registered[name] = Entry(build, summary or _first_line(build), source)


def entries() -> dict[str, Entry]:
    """Return everything that has a name, without importing what other distributions declare."""
    declared = {name: Entry(_Place(name, place), f"from {place}") for name, place in _declared().items()}
    return {**declared, **_registered, **ZOO}


def names(
    archive: PolicyArchive | str | Path = "default", race: GameConfig | RaceConfig | str | Path = "paper"
) -> list[str]:
    """Return the names of all agents and drivers that can be asked for with an archive, sorted.

    Those that must learn first also need a network or a fit (:class:`Entry`).
    """
    constant = [f"{ALWAYS}{''.join(move.split())}" for move in make_setting(archive, race).moves[:-1]]
    return sorted([*entries(), *constant])


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
        return agents.always(setting, name.removeprefix(ALWAYS), name="".join(name.split()), seed=seed)
    if name not in known:
        if name.partition(":")[0] in planner_names() and not given:
            return as_competitor(parse_policy(name))
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UnknownNameError(f"agent {name!r} is unknown; {hint}there are: {', '.join(sorted(known))}, {ALWAYS}MOVE")
    entry = known[name]
    if not isinstance(entry.build, _Place):
        _check_options(name, entry.build, given)
    made = entry.build(setting, name=name, seed=seed, **{**entry.defaults, **given})
    if not isinstance(made, Agent | Driver):
        return as_competitor(made, name)
    facts = {"does": entry.summary, "source": entry.source, **made.facts}
    return replace(made, facts={key: value for key, value in facts.items() if value})


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
class _Place:
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
    if isinstance(entry.build, _Place):
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
