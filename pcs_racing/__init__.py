"""Head-to-head autonomous racing in Policy Characteristic Space.

Examples
--------
>>> import pcs_racing
>>> track = pcs_racing.load_track("Tarnfjord")
>>> calm, bold = (pcs_racing.parse_policy(f"lattice:pace={pace}") for pace in (0.3, 0.8))
>>> result = pcs_racing.run_races(track, [calm] * 10, bold, pcs_racing.PAPER, seed=1)
>>> result.winner.shape
(10,)
"""

from importlib import import_module
from typing import Any

from pcs_racing.envs import register_environments
from pcs_racing.f1tenth import register_environments as register_old_environments

_PLACES = {
    "base.errors": "ConfigError InputError MapError UnknownNameError",
    "car.lidar": "Lidar",
    "car.vehicle": "F1TENTH VehicleParams simulate",
    "envs.duel": "env parallel_env",
    "game.archive": "PolicyArchive",
    "game.archive_files": "list_archives load_archive save_archive",
    "game.config": "GameConfig load_game_config",
    "game.make": "make_game",
    "game.rules": "RaceGame",
    "game.state": "GameState",
    "planners.imported": "drivers_from",
    "planners.planner": "Parameter Planner Policy",
    "planners.registry": "get_planner parse_policy planner_names register_planner",
    "race.config": "CONTEST PAPER ROBORACER RaceConfig load_race_config",
    "race.races": "RaceResult RaceSetup advance draw_starts run_field run_races start_races",
    "race.recording": "record_race",
    "race.replay": "Replay read_replay save_replay",
    "race.start_grid": "Starts",
    "race.state": "RaceState",
    "track.loading": "load_track",
    "track.maps": "list_tracks",
    "track.track": "Track build_track",
}
"""Public names by file. A file is imported on first use: all files together take a second."""

_FILES = {name: file for file, names in _PLACES.items() for name in names.split()}
__all__ = sorted(_FILES)

register_environments()
register_old_environments()


def __getattr__(name: str) -> Any:
    """Import a public name on first use; ``__init__.pyi`` has the types."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, getattr(import_module(f"pcs_racing.{_FILES[name]}"), name))


def __dir__() -> list[str]:
    return [*globals(), *__all__]
