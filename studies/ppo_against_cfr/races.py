"""Races of the study: racers, opponents, circuits, and the pairings of all of them.

Race k of a circuit has the same start line, side, noise and start policies for every pair. Every
start line is raced from both sides.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.registry import planner_names
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Competitor
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.tournament.pairings import Pairing, draw_schedule, schedule_pairing
from pcs_racing_agents.tournament.play import game_rules
from pcs_racing_agents.tournament.races import RaceTable

CONTROL = ("line-ppo", "ppo-drive", "lidar-ppo")
"""Planners trained by PPO; a name that is not registered is left out."""
LEVELS = {
    "PPO, control": CONTROL,
    "PPO, moves": ("ppo",),
    "CFR, moves": ("cfr-argmax", "cfr-regret-matching"),
    "open loop": ("best-fixed", "never-switch"),
    "planner": ("lattice",),
}
"""Racers by level."""
OPPONENTS = (
    "never-switch",
    "lane-switcher",
    "random-moves",
    "cfr-argmax",
    "lattice",
    "pure-pursuit",
)
CROSS_PLAY = (*CONTROL, "ppo", "cfr-argmax", "best-fixed", "lattice")
"""Racers of the payoff table, all against all."""
ARCHIVES = {"contest": "contest-early", "paper": "default-early"}
"""Archive of the agents by rules."""
TRAINING = {"contest": ("Brackwater", "Pipkin"), "paper": ("Tarnfjord", "Kestrelheim")}
"""Circuits that all networks of the rules were trained on."""
HELD_OUT = {"contest": ("Saltmere", "Vellindra"), "paper": ("Saltmere",)}
"""Shipped circuits that no network of the rules was trained on."""
REAL = ("Austin", "Monza", "Sepang", "Zandvoort")
"""Real circuits, held out of all training."""
CIRCUITS = ("training", "held-out")
"""Kinds of circuits."""
SEED = 4901


class Size(NamedTuple):
    """Size of the study."""

    races: int = 100  #: Races of each pair on each circuit.
    circuits: int | None = None  #: Max number of circuits of each kind; None for all.
    real: bool = True  #: True to race on the real circuits that exist here.


SMALL = Size(races=4, circuits=1, real=False)


@dataclass(frozen=True, eq=False)
class Setup:
    """Racers and circuits under one set of rules."""

    spec: GameSpec
    racers: dict[str, Competitor]  #: Racers and opponents by name.
    training: tuple[Track, ...]
    held_out: tuple[Track, ...]

    @property
    def rules(self) -> str:
        """Name of the rules."""
        return self.spec.config.race.name


def racers() -> dict[str, str]:
    """Return the level of each racer, in the order of the tables."""
    known = planner_names()
    return {
        name: level
        for level, names in LEVELS.items()
        for name in names
        if name in known or name not in CONTROL
    }


def make_setup(rules: str, size: Size, maps: Path | None) -> Setup:
    """Load the circuits, and make the racers and opponents of the rules.

    ``maps``: folder of the real circuits; by default ``$PCS_RACING_MAPS``.
    """
    spec = make_game_spec(ARCHIVES[rules], game_rules(load_race_config(rules)))
    folder = maps or Path(os.environ.get("PCS_RACING_MAPS", ""))
    real = [str(folder / name) for name in REAL if size.real and (folder / name).is_dir()]
    names = (*racers(), *(name for name in OPPONENTS if name not in racers()))
    return Setup(
        spec,
        {name: parse_agent(name, spec) for name in names},
        tuple(load_track(name) for name in TRAINING[rules][: size.circuits]),
        tuple(load_track(name) for name in (*HELD_OUT[rules][: size.circuits], *real)),
    )


def pairs() -> list[tuple[str, str]]:
    """Return the pairs: all racers against all opponents, and the rest of the cross-play."""
    raced = [(racer, opponent) for racer in racers() for opponent in OPPONENTS]
    cross = [name for name in CROSS_PLAY if name in racers()]
    for k, racer in enumerate(cross):
        for opponent in cross[k + 1 :]:
            if (racer, opponent) not in raced and (opponent, racer) not in raced:
                raced.append((racer, opponent))
    return raced


def make_pairings(setup: Setup, races: int) -> list[Pairing]:
    """Return the pairings of all pairs on all circuits."""
    found: list[Pairing] = []
    for track in (*setup.training, *setup.held_out):
        game = RaceGame(track, setup.spec.archive, setup.spec.config)
        schedule = draw_schedule(track, setup.spec.config.race_rules, races, SEED)
        found += [
            schedule_pairing(game, setup.racers[racer], setup.racers[opponent], schedule, SEED)
            for racer, opponent in pairs()
        ]
    return found


def job_settings(setups: Sequence[Setup], races: int) -> dict[str, object]:
    """Return all inputs of the races, for :func:`pcs_racing_agents.base.jobs.open_job`."""
    return {
        "seed": SEED,
        "races": races,
        "games": {one.rules: one.spec.config for one in setups},
        "archives": {one.rules: one.spec.identity.archive_sha256 for one in setups},
        "tracks": {
            one.rules: [track.content_hash for track in (*one.training, *one.held_out)]
            for one in setups
        },
        "pairs": [list(pair) for pair in pairs()],
    }


def by_pair(
    setup: Setup, tables: Sequence[RaceTable]
) -> dict[tuple[str, str, str, str], list[RaceTable]]:
    """Return the results of :func:`make_pairings` by rules, kind of circuits and pair."""
    found: dict[tuple[str, str, str, str], list[RaceTable]] = {}
    kinds = [CIRCUITS[0]] * len(setup.training) + [CIRCUITS[1]] * len(setup.held_out)
    places = [(kind, *pair) for kind in kinds for pair in pairs()]
    for place, table in zip(places, tables, strict=True):
        found.setdefault((setup.rules, *place), []).append(table)
    return found
