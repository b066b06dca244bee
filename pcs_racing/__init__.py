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

from typing import Any

from pcs_racing.base.errors import ConfigError, InputError, MapError, UnknownNameError
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.vehicle import F1TENTH, VehicleParams, simulate
from pcs_racing.envs import register_environments
from pcs_racing.f1tenth import register_environments as register_old_environments
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import list_archives, load_archive, save_archive
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState
from pcs_racing.planners.imported import drivers_from
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.registry import get_planner, parse_policy, planner_names, register_planner
from pcs_racing.race.config import CONTEST, PAPER, ROBORACER, RaceConfig, load_race_config
from pcs_racing.race.races import RaceResult, RaceSetup, advance, draw_starts, run_field, run_races, start_races
from pcs_racing.race.recording import record_race
from pcs_racing.race.replay import Replay
from pcs_racing.race.replay_files import read_replay, save_replay
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track, build_track

__all__ = [
    "CONTEST",
    "F1TENTH",
    "PAPER",
    "ROBORACER",
    "ConfigError",
    "GameConfig",
    "GameState",
    "InputError",
    "Lidar",
    "MapError",
    "Parameter",
    "Planner",
    "Policy",
    "PolicyArchive",
    "RaceConfig",
    "RaceGame",
    "RaceResult",
    "RaceSetup",
    "RaceState",
    "Replay",
    "Starts",
    "Track",
    "UnknownNameError",
    "VehicleParams",
    "advance",
    "build_track",
    "draw_starts",
    "drivers_from",
    "env",
    "get_planner",
    "list_archives",
    "list_tracks",
    "load_archive",
    "load_game_config",
    "load_race_config",
    "load_track",
    "make_game",
    "parallel_env",
    "parse_policy",
    "planner_names",
    "read_replay",
    "record_race",
    "register_planner",
    "run_field",
    "run_races",
    "save_archive",
    "save_replay",
    "simulate",
    "start_races",
]

register_environments()
register_old_environments()


def __getattr__(name: str) -> Any:
    """Import the makers of environments when they are asked for, as the registries do."""
    if name in ("env", "parallel_env"):
        from pcs_racing.envs import duel

        return getattr(duel, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
