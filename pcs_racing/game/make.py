"""Construction of a game from the names of a track, an archive and rules."""

from pathlib import Path
from typing import Any

from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner
from pcs_racing.race.config import Rules, load_rules
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track


def make_game(
    track: Track | str | Path | None = None,
    archive: PolicyArchive | str | Path = "default",
    rules: Rules | str | Path = "paper",
    *,
    opponent_planner: Planner | str | None = None,
    threads: int | None = None,
    ego_planner: Planner | str | None = None,
    vehicles: tuple[VehicleParams, ...] = (F1TENTH, F1TENTH),
    max_delays: VehicleParams = F1TENTH,
    **changes: Any,
) -> RaceGame:
    """Make a game from names or objects.

    Without a track it is a game on any track, which an agent is made for. ``rules`` are rules, a
    name or a YAML file; ``changes`` are fields of :class:`pcs_racing.race.config.Rules` to change.
    The other arguments are fields of :class:`RaceGame`.
    """
    on: Any = None if track is None else as_track(track)
    planners = opponent_planner, threads, ego_planner
    own = load_rules(rules, **changes)
    return RaceGame(on, load_archive(archive), own, *planners, vehicles, max_delays)
