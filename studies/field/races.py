"""Races of the table: circuits, opponents, and the pairings of all entrants with them.

Race k of a circuit has the same start line, side and noise for every pair with the same number of
races. Every start line is raced from both sides.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track
from pcs_racing_agents.policies.tuning import TUNING_TRACKS
from pcs_racing_agents.tournament.pairings import Pairing, draw_schedule, schedule_pairing
from pcs_racing_agents.tournament.races import RaceTable
from studies.circuits import real_circuits
from studies.field.entrants import SEED, Entrant, Size

ARCHIVE = "contest"
"""Archive of the agents."""
RULES = ("contest", "roboracer")
"""Rules; agents and planners with fewer races only race in the first."""
OPPONENTS = ("lattice", "line-ppo", "iterated-best-response", "pure-pursuit")
"""Opponents of all entrants; the best planner is one more."""
REAL = ("Austin", "Hockenheim", "MoscowRaceway", "Nuerburgring")
"""Real circuits, held out like the shipped circuits without a tuning."""
CIRCUITS = ("training", "held-out")
"""Kinds of circuits."""

Tracks = dict[str, tuple[Track, ...]]
"""Circuits by kind."""
Key = tuple[str, str, str]
"""Kind of circuits, label of the entrant, and opponent."""
Raced = dict[Key, list[RaceTable]]
"""Races by key, a table for each circuit."""
Play = Callable[[Sequence[Pairing], str], list[RaceTable]]
"""Function that plays pairings, or loads their races, under a name."""


def circuits(size: Size, maps: Path | None) -> Tracks:
    """Load the circuits of each kind.

    ``maps``: folder of the real circuits; by default ``$PCS_RACING_MAPS``.
    """
    shipped = [name for name in list_tracks() if name not in TUNING_TRACKS]
    return {
        kind: tuple(load_track(name) for name in names[: size.circuits])
        for kind, names in zip(
            CIRCUITS, (TUNING_TRACKS, (*shipped, *real_circuits(REAL, maps))), strict=True
        )
    }


def spec_of(rules: str) -> RaceGame:
    """Return the game of the archive under rules of a race, with the duration of the race."""
    return make_game(None, ARCHIVE, rules)


def play_all(
    spec: RaceGame,
    tracks: Tracks,
    entrants: Sequence[Entrant],
    opponents: Sequence[Entrant],
    races: int,
    play: Play,
    name: str,
) -> Raced:
    """Play the races of all entrants against all opponents on all circuits."""
    keys: list[Key] = []
    pairings: list[Pairing] = []
    cars = {one: one.competitor(spec) for one in (*entrants, *opponents)}
    for kind, track in [(kind, track) for kind, several in tracks.items() for track in several]:
        game = RaceGame(track, spec.archive, spec.rules)
        schedule = draw_schedule(track, spec.rules.for_game, races, SEED)
        for opponent in opponents:
            for one in entrants:
                pairing = schedule_pairing(game, cars[one], cars[opponent], schedule, SEED)
                pairings.append(pairing)
                keys.append((kind, one.label, opponent.label))
    raced: Raced = {}
    for key, table in zip(keys, play(pairings, name), strict=True):
        raced.setdefault(key, []).append(table)
    return raced


def hashes(tracks: Mapping[str, Sequence[Track]]) -> list[str]:
    """Return the content hashes of all circuits."""
    return [track.content_hash for several in tracks.values() for track in several]
