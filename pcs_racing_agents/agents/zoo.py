"""The zoo: a registry of agents and fixed policies by name.

:data:`SHIPPED` lists the agents of this package. A distribution adds agents in the entry point
group ``pcs_racing.agents``: ``name = "package.module:function"``. The function takes a
:class:`pcs_racing_agents.agents.GameSpec`, the keywords ``name`` and ``seed``, and options of its
own; it returns an agent, a fixed policy, or any object with ``act``. A program calls
:func:`register_agent`. A module is imported when its agent is built.
"""

import difflib
import inspect
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError, one_line
from pcs_racing.base.files import plain_yaml
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.competitor import is_model
from pcs_racing.game.config import GameConfig
from pcs_racing.planners.registry import parse_policy, planner_names
from pcs_racing.planners.shipped import split_name
from pcs_racing.race.config import RaceConfig
from pcs_racing_agents.agents.agent import Agent, Competitor, Driver, as_agent
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.own_code import is_code, own_code
from pcs_racing_agents.agents.shipped import SHIPPED

ENTRY_POINTS = "pcs_racing.agents"
"""Entry point group for the agents of a distribution: ``name = "package.module:function"``."""

ALWAYS = "always-"
_ALWAYS = "pcs_racing_agents.agents.blind:always"


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
    if (
        not isinstance(name, str)
        or not name
        or any(sign in name for sign in ":=, \t\n")
        or name.startswith(ALWAYS)
    ):
        raise InputError(
            f"agent name {name!r} must be text without ':', '=', ',' and spaces, not beginning with"
            " always-"
        )
    existing = _registered.get(name)
    if name in SHIPPED or (existing is not None and existing.build is not build):
        raise InputError(f"there is an agent {name!r} already; give yours another name")
    _registered[name] = Entry(build, summary or _first_line(build), source)


def entries() -> dict[str, Entry]:
    """Return all entries by name, without importing the modules of other distributions."""
    declared = {
        name: Entry(_late_function(name, source), f"from {source}")
        for name, source in _declared().items()
    }
    return {
        **declared,
        **_registered,
        **{name: resolve_name(reference) for name, reference in SHIPPED.items()},
    }


def names(
    archive: PolicyArchive | str | Path = "default",
    race: GameConfig | RaceConfig | str | Path = "paper",
) -> list[str]:
    """Return the names of all agents and fixed policies for an archive, sorted.

    Trained agents also need a network or a fit (:class:`Entry`).
    """
    constant = [
        f"{ALWAYS}{''.join(move.split())}" for move in make_game_spec(archive, race).moves[:-1]
    ]
    return sorted({*_declared(), *_registered, *SHIPPED, *constant})


def make(
    name: str,
    *,
    archive: PolicyArchive | str | Path = "default",
    race: GameConfig | RaceConfig | str | Path = "paper",
    seed: int = 0,
    **options: Any,
) -> Any:
    """Make an agent or a fixed policy by name.

    A third-party agent may be any object with ``act``.

    Parameters
    ----------
    name : str
        Name from :func:`names`; a policy as text, such as ``"lattice:pace=0.8"``; or the ``.zip``
        of a control policy (:func:`pcs_racing_agents.agents.sb3_files.save_model`).
    archive, race
        Game of the agent, as in :func:`pcs_racing.make_game`.
    seed : int
        Seed of the draws of mixed strategies.
    **options
        Options of the agent; ``docs/agents.md`` lists them.

    Examples
    --------
    >>> make("always-aggressiveness+").name
    'always-aggressiveness+'
    """
    return build(name, make_game_spec(archive, race), seed=seed, **options)


def build(name: str, spec: GameSpec, *, seed: int = 0, **options: Any) -> Any:
    """Make an agent or a fixed policy for a game spec; see :func:`make`."""
    if not isinstance(name, str):
        raise InputError(f"agent {name!r} must be a name")
    available = entries()
    if name.startswith(ALWAYS):
        for key in options:
            raise InputError(f"agent {name!r} has no option {key!r}; it has none")
        return resolve_name(_ALWAYS)(
            spec, name.removeprefix(ALWAYS), name="".join(name.split()), seed=seed
        )
    if is_model(name):
        return as_agent(name)
    # An agent may have the name of a planner. Any other text that begins with a planner's name is
    # a policy.
    if name not in available:
        if split_name(name)[0] in planner_names() and not options:
            return as_agent(parse_policy(name))
        near = difflib.get_close_matches(name, available, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        every = f"{', '.join(sorted(available))}, {ALWAYS}MOVE"
        raise UnknownNameError(f"agent {name!r} is unknown; {hint}there are: {every}")
    entry = available[name]
    _check_options(name, entry.build, options)
    agent = entry.build(spec, name=name, seed=seed, **{**entry.defaults, **options})
    if not isinstance(agent, Agent | Driver):
        return as_agent(agent, name)
    facts = {"does": entry.summary, "source": entry.source, **agent.facts}
    return replace(agent, facts={key: value for key, value in facts.items() if value})


def parse_agent(text: str, spec: GameSpec, *, seed: int = 0, code: bool = False) -> Competitor:
    """Make an agent from its name, or with options as in ``"cfr-argmax:network=out/net"``.

    A text that begins with the name of a planner is a policy, as in ``"lane-switcher:3"``. With
    ``code``, the text may name user code, which is run (:mod:`pcs_racing_agents.agents.own_code`):
    never set it for a text from a file.
    """
    text = str(text).strip()
    name, separator, rest = split_name(text)
    # "lane-switcher:3" is a variant of the planner, not an option of the agent "lane-switcher".
    if not separator or name not in entries() or name in planner_names():
        own = own_code(text, spec) if code else None
        if own is not None:
            with one_line(text):
                return as_agent(own, text)
        if is_code(text) and name not in planner_names() and not code:
            raise UnknownNameError(
                f"agent {text!r} is unknown: no file may name code. If it is yours, register it, or"
                f" name it on the command line (view: --agents {shlex.quote(text)})"
            )
        return build(text, spec, seed=seed)
    options: dict[str, Any] = {}
    for option in rest.split(","):
        key, equals, value = option.partition("=")
        if not equals or key.strip() in options or key.strip() in ("name", "seed", "spec"):
            raise InputError(
                f"agent {text!r}: {option!r} is not of the form option=value, each option once"
            )
        try:
            options[key.strip()] = plain_yaml(value)
        except InputError:
            raise InputError(
                f"agent {text!r}: {value!r} is no value; it must be a number or plain text"
            ) from None
    agent = build(name, spec, seed=seed, **options)
    return as_agent(agent, text)


def _late_function(name: str, reference: str) -> Callable[..., Any]:
    """Return a function of another distribution, imported when it is called."""

    def build(spec: GameSpec, **options: Any) -> Any:
        try:
            function = resolve_name(reference)
        except Exception as error:  # any error in the import of a third-party module
            raise InputError(f"agent {name!r} can't be loaded from {reference}: {error}") from error
        return function(spec, **options)

    return build


@lru_cache(maxsize=1)
def _declared() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}


def options(name: str) -> dict[str, Any]:
    """Return the options of an entry with their defaults (None: computed).

    The result is empty for an entry of another distribution.
    """
    entry = entries()[name]
    free = _free_options(entry.build)
    return {key: entry.defaults.get(key, value) for key, value in free.items()}


def _free_options(function: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters
    return {
        key: None if parameter.default is parameter.empty else parameter.default
        for key, parameter in parameters.items()
        if key not in ("spec", "name", "seed") and parameter.kind is not parameter.VAR_KEYWORD
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


def load_entrant(
    text: str,
    spec: GameSpec,
    *,
    weights: Path | None = None,
    name: str | None = None,
) -> Competitor:
    """Return the competitor that an argument of the command line names; it may name user code.

    Parameters
    ----------
    text : str
        Text for :func:`pcs_racing_agents.agents.parse_agent`; or path of a ``.zip`` file of
        Stable-Baselines3 (only its numbers are read); with ``weights``, ``module:function``, a
        function of the game spec and the path of the weights that returns a competitor; or the
        folder of a learned planner (:func:`pcs_racing.planners.learned.load_planner`).
    weights : path, optional
        File of weights for the function.
    name : str, optional
        Name on the card, in place of the competitor's name.
    """
    from pcs_racing.planners.learned import load_planner
    from pcs_racing_agents.agents.sb3_files import load_sb3_policy

    if Path(text).is_dir():
        return as_agent(load_planner(text).policy({}), name)
    # A control policy has the arguments of its environment next to the zip, and is read below.
    if is_model(text) and not Path(text).with_suffix(".yaml").is_file():
        return as_agent(load_sb3_policy(Path(text)), name or Path(text).stem)
    if weights is None:
        return as_agent(parse_agent(text, spec, code=True), name)
    if not weights.is_file():
        raise InputError(f"there is no file of weights {weights}")
    made = own_code(text, spec, weights)
    if made is None:
        raise InputError(
            f"can't find {text}; give module:function, where the module can be imported"
        )
    return as_agent(made, name or text.partition(":")[2])
