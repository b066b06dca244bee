"""Races of the study: racers, opponents, circuits, and the pairings of all of them.

Race k of a circuit has the same start line, side, noise and start policies for every pair. Every
start line is raced from both sides.
"""

from collections.abc import Mapping
from pathlib import Path

from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.registry import planner_names
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.tournament.pairings import Pairing, draw_schedule, schedule_pairing
from studies.circuits import real_circuits

CONTROL = ("line-ppo", "lidar-ppo")
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
    "lane-switcher:any",
    "random-moves",
    "cfr-argmax",
    "lattice",
    "pure-pursuit",
)
CROSS_PLAY = (*CONTROL, "ppo", "cfr-argmax", "best-fixed", "lattice")
"""Racers of the payoff table, all against all."""
ARCHIVES = {"contest": "contest", "paper": "default"}
"""Archive of the agents by rules."""
CIRCUITS = ("training", "held-out")
"""Kinds of circuits."""
TRAINING = {"contest": ("Brackwater", "Pipkin"), "paper": ("Tarnfjord", "Kestrelheim")}
"""Circuits that all networks of the rules were trained on."""
HELD_OUT = {"contest": ("Saltmere", "Vellindra"), "paper": ("Saltmere",)}
"""Shipped circuits that no network of the rules was trained on."""
REAL = ("Austin", "Monza", "Sepang", "Zandvoort")
"""Real circuits, held out of all training."""
RACES, SMALL = 100, 4
"""Races of each pair on each circuit; the same in the small study."""
SEED = 4901

Key = tuple[str, str, str, str]
"""Rules, kind of circuits, racer and opponent."""


def racers() -> dict[str, str]:
    """Return the level of each racer, in the order of the tables."""
    absent = set(CONTROL) - set(planner_names())
    return {name: level for level, names in LEVELS.items() for name in names if name not in absent}


def pairs() -> list[tuple[str, str]]:
    """Return the pairs: all racers against all opponents, and the rest of the cross-play."""
    raced = [(racer, opponent) for racer in racers() for opponent in OPPONENTS]
    cross = [name for name in CROSS_PLAY if name in racers()]
    further = [(one, other) for k, one in enumerate(cross) for other in cross[k + 1 :]]
    return raced + [pair for pair in further if not {pair, pair[::-1]} & set(raced)]


def circuits(rules: str, small: bool, maps: Path | None) -> dict[str, tuple[Track, ...]]:
    """Load the circuits of each kind; the small study has the first of each.

    ``maps``: folder of the real circuits; by default ``$PCS_RACING_MAPS``.
    """
    names = TRAINING[rules], (*HELD_OUT[rules], *real_circuits(REAL, maps))
    return {
        kind: tuple(load_track(name) for name in own[: 1 if small else None])
        for kind, own in zip(CIRCUITS, names, strict=True)
    }


def make_pairings(
    rules: str, tracks: Mapping[str, tuple[Track, ...]], races: int
) -> list[tuple[Key, Pairing]]:
    """Return the pairings of all pairs on all circuits, with their keys."""
    spec = make_game(None, ARCHIVES[rules], rules)
    cars = {name: competitor(name, spec) for name in (*racers(), *OPPONENTS)}
    found: list[tuple[Key, Pairing]] = []
    for kind, track in [(one, track) for one, several in tracks.items() for track in several]:
        game = RaceGame(track, spec.archive, spec.rules)
        schedule = draw_schedule(track, spec.rules.for_game, races, SEED)
        for racer, opponent in pairs():
            pairing = schedule_pairing(game, cars[racer], cars[opponent], schedule, SEED)
            found.append(((rules, kind, racer, opponent), pairing))
    return found
