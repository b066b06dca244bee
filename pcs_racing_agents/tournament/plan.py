"""Plan of a tournament: all pairs drive the same races, from both sides of each start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import list_archives
from pcs_racing.game.make import make_game
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.racers import own_name
from pcs_racing.race.config import Rules
from pcs_racing.track.loading import as_track
from pcs_racing.track.maps import find_shipped, list_tracks
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.tournament.games import game_between
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    RaceSchedule,
    draw_schedule,
    schedule_pairing,
)

Circuit = Track | str | Path
Entrant = Any
"""A text or an object for :func:`pcs_racing.racer`."""


@dataclass(frozen=True, eq=False)
class TournamentPlan:
    """Checked tournament with drawn races, not yet simulated."""

    competitors: tuple[Competitor, ...]
    tracks: tuple[Track, ...]
    spec: RaceGame  #: Game on any track.
    schedules: tuple[RaceSchedule, ...]  #: Races of each pair, by track.
    races_per_pair: int  #: Number of races of each pair on each track.
    seed: int
    archive: str = ""  #: Source of the archive: name of a shipped archive, or path of a folder.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the competitors, in the order of the table."""
        return tuple(map(own_name, self.competitors))

    @cached_property
    def pairings(self) -> tuple[Pairing, ...]:
        """Races of all pairs on the first track, then of all pairs on the next track, etc."""
        return self.paired(tuple(combinations(self.competitors, 2)))

    def paired(self, pairs: Sequence[tuple[Competitor, Competitor]]) -> tuple[Pairing, ...]:
        """Return the races of some pairs of competitors, in the order of ``pairings``."""
        return tuple(
            schedule_pairing(game, *pair, schedule, self.seed)
            for game, schedule in zip(self.games, self.schedules, strict=True)
            for pair in pairs
        )

    @cached_property
    def games(self) -> tuple[RaceGame, ...]:
        """Games on the tracks."""
        return tuple(replace(self.spec, track=track) for track in self.tracks)

    @property
    def rules(self) -> Rules:
        """Rules with the length of the game as the duration of a race."""
        return self.spec.rules.for_game


def plan_tournament(
    tracks: Circuit | Sequence[Circuit],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    rules: Rules | str | Path = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    code: bool = False,
    like: Any = None,
) -> TournamentPlan:
    """Check the arguments of a tournament, and draw its races; see
    :func:`pcs_racing_agents.tournament.play_tournament`.

    ``code``: True to allow names of user code, as in :func:`pcs_racing.racer`.
    """
    given = [tracks] if isinstance(tracks, Track | str | Path) else tracks
    circuits = [as_track(track) for track in given]
    _check_distinct("tracks", [track.name for track in circuits], 1)
    spec = make_game(None, archive, rules)
    named = entrants.items() if isinstance(entrants, Mapping) else [(None, e) for e in entrants]
    competitors = []
    for name, entrant in named:
        competitors.append(competitor(entrant, spec, code, name=name, like=like, seed=seed))
    _check_distinct("competitors", [own_name(entrant) for entrant in competitors], 2)
    race = spec.rules.for_game
    schedules = tuple(draw_schedule(track, race, races_per_pair, seed) for track in circuits)
    source = spec.identity.archive
    if not isinstance(archive, PolicyArchive) and archive not in list_archives():
        source = str(Path(archive).resolve())
    plan = TournamentPlan(
        tuple(competitors), tuple(circuits), spec, schedules, races_per_pair, seed, source
    )
    for game, entrant in product(plan.games, competitors):
        # A game against itself refuses an unsuitable competitor before any simulation.
        game_between(game, entrant, entrant)
    return plan


def tournament_settings(plan: TournamentPlan) -> dict[str, Any]:
    """Return all inputs of a tournament, for :func:`pcs_racing_agents.base.jobs.open_job`."""
    spec = plan.spec
    own_maps = {
        track.name: str(track.folder)
        for track in plan.tracks
        if track.folder is not None and not _is_shipped(track)
    }
    return {
        "seed": plan.seed,
        "races_per_pair": plan.races_per_pair,
        "rules": spec.rules,
        "archive": plan.archive,
        "archive_sha256": spec.identity.archive_sha256,
        "tracks": {track.name: track.content_hash for track in plan.tracks},
        **({"maps": own_maps} if own_maps else {}),
        "agents": {
            own_name(competitor): competitor_hash(competitor) for competitor in plan.competitors
        },
    }


def _is_shipped(track: Track) -> bool:
    return track.name in list_tracks() and find_shipped(track.name) == track.folder


def _check_distinct(noun: str, names: list[str], minimum: int) -> None:
    if len(names) < minimum:
        raise InputError(f"{len(names)} {noun} given; a tournament needs at least {minimum}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"{noun} must have different names; {', '.join(repeated)} is not unique")
