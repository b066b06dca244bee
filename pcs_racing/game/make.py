"""Construction of a game from the names of a track, an archive and rules."""

from pathlib import Path
from typing import Any

from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track


def make_game(
    track: Track | str | Path,
    archive: PolicyArchive | str | Path = "default",
    rules: GameConfig | RaceConfig | str | Path = "paper",
    *,
    opponent_planner: Planner | str | None = None,
    threads: int | None = None,
    ego_planner: Planner | str | None = None,
    vehicles: tuple[VehicleParams, ...] = (F1TENTH, F1TENTH),
    max_delays: VehicleParams = F1TENTH,
    **settings: Any,
) -> RaceGame:
    """Make a game from names or objects.

    ``rules`` hold the rules of the game, or of the race alone: a config, a preset's name or a YAML
    file; ``settings`` are fields of :class:`GameConfig` to change. The other arguments are fields
    of :class:`RaceGame`.
    """
    config = load_game_config(rules, **settings)
    planners = opponent_planner, threads, ego_planner
    return RaceGame(as_track(track), load_archive(archive), config, *planners, vehicles, max_delays)
