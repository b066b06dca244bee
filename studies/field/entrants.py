"""Entrants of the table: planners at their defaults, tuned planners, and agents of the archive."""

from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError, UnknownNameError, say_once
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.registry import get_planner, parse_policy, planner_names
from pcs_racing_agents.base.jobs import show_progress
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.policies.tuning import (
    MIN_PARAMETERS,
    TUNING_TRACKS,
    TuningConfig,
    TuningProgress,
    tune,
)

PAPER = "lattice:early"
"""Lattice planner with the parameters of the paper; ``lattice`` is tuned by a full search."""
AGENTS = ("cfr-argmax", "response", "best-fixed", "never-switch", "ppo")
"""Agents of the archive; an agent without a shipped network or fit is left out."""
POOL = ("lattice", PAPER, "iterated-best-response", "gap-follower")
"""Opponents of the tuning."""
SEED = 5207
KINDS = ("default", "tuned", "agent")
COLUMNS = ("planner", "policy")
"""Columns of ``tuned.csv``."""


class Size(NamedTuple):
    """Budget of the tuning, and number of races."""

    generations: int
    population: int
    circuits: int | None  #: Number of circuits of each kind; None for all.
    races: Mapping[str, int]  #: Races of a pair on a circuit, by rules.
    title: int  #: Races of each agent against the best planner on a circuit.
    planners: tuple[str, ...] = ()  #: Planners that race; all if empty.


FULL = Size(8, 12, None, {"contest": 40, "roboracer": 12}, 200)
SMALL = Size(1, 4, 1, {"contest": 4, "roboracer": 6}, 4, ("lattice", "pure-pursuit", "stanley"))


class Entrant(NamedTuple):
    """Entrant of the table."""

    name: str  #: Name; a tuned planner has the name of its defaults.
    kind: str  #: One of :data:`KINDS`.
    text: str  #: Policy or agent as text.

    @property
    def label(self) -> str:
        """Name in races and tables."""
        return f"{self.name}, tuned" if self.kind == "tuned" else self.name

    def competitor(self, spec: RaceGame) -> Competitor:
        """Return the agent or policy."""
        if self.kind == "agent":
            return competitor(self.text, spec)
        return competitor(self.text, spec, name=self.label)


def default_texts(size: Size) -> dict[str, str]:
    """Return the policy of each planner with its paper's parameters, by planner."""
    names = size.planners or planner_names()
    return {name: PAPER if name == "lattice" else name for name in names}


def tunable(size: Size) -> list[str]:
    """Return the planners with enough parameters to tune."""
    return [
        name for name in default_texts(size) if len(get_planner(name).parameters) >= MIN_PARAMETERS
    ]


def tuning_config(planner: str, size: Size) -> TuningConfig:
    """Return the search of a planner from its defaults: the same small budget for all planners."""
    return TuningConfig(
        planner=planner,
        against=POOL,
        tracks=TUNING_TRACKS[: size.circuits],
        held_out=(),
        start=default_texts(size)[planner],
        generations=size.generations,
        population=size.population,
        starts=1,
        check_starts=2,
        seed=SEED,
    )


def tuning_races(size: Size) -> int:
    """Return the number of races of the tuning of a planner: search, choice and check."""
    config = tuning_config(tunable(size)[0], size)
    races = len(config.tracks) * len(config.against) * 2
    finalists = 1 + config.generations - config.generations // 2
    return races * (config.generations * config.population + 4 * finalists + 4)


def tuned_policy(planner: str, size: Size, folder: Path, executor: Executor) -> str:
    """Tune a planner, or load the result of an earlier run, and return the policy as text."""
    show = show_progress("generations")

    def update(stage: str, done: int, total: int, state: TuningProgress | None) -> None:
        show(done, total, f"{planner}, {stage}, {state.best if state else 0:.3f}")

    config = tuning_config(planner, size)
    return tune(config, folder / planner, executor=executor, callback=update).policy.name


def read_tuned(out: Path, size: Size) -> dict[str, str]:
    """Return the policies of ``tuned.csv`` by planner."""
    file = out / "tuned.csv"
    if not file.is_file():
        raise InputError(f"{file} does not exist; run --part tune first, with the same --out")
    found = {row["planner"]: row["policy"] for row in read_csv(file).rows()}
    if list(found) != tunable(size):
        raise InputError(
            f"{file} has the planners {', '.join(found)}; it must have"
            f" {', '.join(tunable(size))}: run --part tune again"
        )
    return found


def planner_entrants(tuned: Mapping[str, str], size: Size) -> list[Entrant]:
    """Return the planners at their defaults, the full search of the lattice, and tuned planners.

    A tuned policy that is the default policy is left out.
    """
    entrants = []
    for planner, text in default_texts(size).items():
        entrants.append(Entrant(text, "default", text))
        found = tuned.get(planner, text)
        if not np.allclose(parse_policy(found).parameters, parse_policy(text).parameters, 1e-3):
            entrants.append(Entrant(text, "tuned", found))
        if text == PAPER:
            entrants.append(Entrant(planner, "default", planner))
    return entrants


def agent_entrants(spec: RaceGame) -> list[Entrant]:
    """Return the agents of an archive whose networks and fits are shipped."""
    found = []
    for name in AGENTS:
        try:
            competitor(name, spec)
        except UnknownNameError as error:
            say_once(f"without {name}: {error}")
        else:
            found.append(Entrant(name, "agent", name))
    return found
