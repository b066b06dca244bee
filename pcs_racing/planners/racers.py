"""Readers of racers: a text or an object becomes a policy, a set of policies or an agent.

Every place that asks for a driver reads the answer with :func:`racer`. The kinds of racers have one
reader each (:data:`READERS`); a distribution adds readers in the entry point group
``pcs_racing.racers``. A reader is imported at the first request, so planners need no import from
the floors above them.

No name runs code: a text such as ``"mine.py:Class"`` is refused unless the caller says ``code``,
as the command line does for its arguments.
"""

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError, UnknownNameError, check_text, choices
from pcs_racing.planners.planner import Policy, PolicySet
from pcs_racing.planners.shipped import declared, load_place

READERS = (
    "pcs_racing.planners.registry:PLANNERS",
    "pcs_racing.game.players:PLAYERS",
    "pcs_racing.planners.learned:LEARNED",
)
"""Readers of names and of racers' own types, in order."""

LAST_READERS = ("pcs_racing.envs.models:MODELS", "pcs_racing.planners.own_code:CODE")
"""Readers after the entry points: models in memory, and code."""

ENTRY_POINTS = "pcs_racing.racers"
"""Entry point group of the readers of a distribution: ``name = "package.module:READER"``."""

Racer = Any
"""A policy, a :class:`PolicySet`, or an agent: an object with ``act``."""


@dataclass(frozen=True, eq=False)
class Request:
    """A question for a driver, with the place that asks."""

    given: Any  #: Text without outer spaces, or an object.
    game: Any = None  #: Game of the place, or a function that makes it; None if policies race.
    code: bool = False  #: True if a text may name code to run.
    like: Any = None  #: Training environment of models without their own arguments.
    seed: int = 0  #: Seed of an agent's draws.

    @property
    def text(self) -> str:
        """Text of the request; empty for an object."""
        return self.given if isinstance(self.given, str) else ""

    @cached_property
    def asked_game(self) -> Any:
        """Game of the place; an agent is refused at a place without a game."""
        if self.game is None:
            raise InputError(
                f"{self.given!r:.80} is an agent, which moves between the policies of an archive;"
                " this place takes policies: a planner or a model of steering and speed. Agents"
                " race in 'pcs-racing tournament --agents' and in environments"
            )
        return self.game() if callable(self.game) else self.game


class Reader(NamedTuple):
    """Reader of one kind of racers."""

    #: Racer of a request, or None for a request of another kind.
    read: Callable[[Request], Racer | None]
    #: Names that this reader knows.
    names: Callable[[], Sequence[str]] = tuple


def racer(
    given: Any,
    game: Any = None,
    code: bool = False,
    *,
    name: str | None = None,
    like: Any = None,
    seed: int = 0,
) -> Racer:
    """Return the racer that a text or an object names.

    Parameters
    ----------
    given : str, Path or object
        One of these texts:

        - a planner, with a variant or parameters: ``"lattice"``, ``"lattice:pace=0.8"``,
          ``"lane-switcher:3"``, or ``"lane-switcher:any"`` for all its variants;
        - an agent, with options: ``"never-switch"``, ``"always-restraint+"``, ``"cfr-argmax"``,
          ``"cfr-argmax:network=out/net"``;
        - a policy of an archive: ``"contest[3]"``;
        - a file of Stable-Baselines3 (``.zip``) or of ``pcs-racing export`` (``.onnx``);
        - a folder of a trained planner, a network or a network set;
        - with ``code``: ``"file.py"``, ``"file.py:name"`` or ``"module:name"``.

        Or one of these objects: a policy, planner, agent, model, torch module or function, or a
        driver with ``plan``.
    game : RaceGame or function, optional
        Game of the agents; a function makes it at its first use. Without a game only policies race.
    code : bool
        True to run the code that a text names. Never for a text from a file.
    name : str, optional
        Name in tables, in place of the racer's own.
    like : str, mapping or environment, optional
        Training environment of a model that does not hold its arguments: ``"duel"``,
        ``"drive:beams=27"``, or the environment itself.
    seed : int
        Seed of the draws of an agent given by name.

    Examples
    --------
    >>> racer("lattice:pace=0.8").name
    'lattice:pace=0.8'
    """
    if isinstance(given, str | Path):
        given = str(given).strip()
    elif isinstance(given, type | np.ndarray | np.generic):
        raise _no_racer(given)
    request = Request(given, game, code, like, seed)
    for reader in _readers():
        found = reader.read(request)
        if found is not None:
            return found if name is None else renamed(found, check_text("a racer's name", name))
    if request.text:
        raise _unknown(request.text)
    raise _no_racer(given)


def policy_racer(given: Any, code: bool = False, *, like: Any = None) -> Policy:
    """Return the one policy that a text or an object names, for places without a game."""
    found = racer(given, code=code, like=like)
    if isinstance(found, Policy):
        return found
    if isinstance(found, PolicySet):
        raise InputError(f"{found.name!r} has {len(found.policies)} policies; name one of them")
    Request(given).asked_game  # noqa: B018 refuses an agent
    raise _no_racer(given)


def renamed(found: Racer, name: str) -> Racer:
    """Return a racer with another name."""
    if getattr(found, "name", None) == name:
        return found
    named = copy(found)
    try:
        object.__setattr__(named, "name", name)  # racers may be frozen
    except AttributeError:
        raise InputError(
            f"{found!r} has a name of its own, {found.name!r}; it can't be called {name!r}"
        ) from None
    return named


def own_name(given: Any) -> str:
    """Return an object's name: its own, or the name of its function or class."""
    name = getattr(given, "name", None) or getattr(given, "__name__", None)
    return name if isinstance(name, str) else type(given).__name__


def known_names() -> list[str]:
    """Return the sorted names of all planners and agents."""
    return sorted({name for reader in _readers() for name in reader.names()})


def _readers() -> Iterator[Reader]:
    yield from map(resolve_name, READERS)
    for name, place in declared(ENTRY_POINTS).items():
        yield load_place(f"the racers {name!r}", place)
    yield from map(resolve_name, LAST_READERS)


def _unknown(text: str) -> UnknownNameError:
    near = choices(text.partition(":")[0], known_names())
    return UnknownNameError(
        f"{text!r} is no planner, agent, archive policy, file or folder; {near}, always-MOVE"
    )


def _no_racer(given: Any) -> InputError:
    return InputError(
        f"{given!r:.120} can't race; give a text, a policy, a planner, a model with predict, an"
        " object with act or plan, or a function: of observations, or of an observation and a"
        " generator"
    )
