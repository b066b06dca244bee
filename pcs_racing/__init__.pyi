from pcs_racing.base.errors import ConfigError as ConfigError
from pcs_racing.base.errors import InputError as InputError
from pcs_racing.base.errors import MapError as MapError
from pcs_racing.base.errors import UnknownNameError as UnknownNameError
from pcs_racing.car.lidar import Lidar as Lidar
from pcs_racing.car.vehicle import F1TENTH as F1TENTH
from pcs_racing.car.vehicle import VehicleParams as VehicleParams
from pcs_racing.car.vehicle import simulate as simulate
from pcs_racing.envs.duel import env as env
from pcs_racing.envs.duel import parallel_env as parallel_env
from pcs_racing.game.archive import PolicyArchive as PolicyArchive
from pcs_racing.game.archive_files import list_archives as list_archives
from pcs_racing.game.archive_files import load_archive as load_archive
from pcs_racing.game.archive_files import save_archive as save_archive
from pcs_racing.game.config import GameConfig as GameConfig
from pcs_racing.game.config import load_game_config as load_game_config
from pcs_racing.game.make import make_game as make_game
from pcs_racing.game.rules import RaceGame as RaceGame
from pcs_racing.game.state import GameState as GameState
from pcs_racing.planners.imported import drivers_from as drivers_from
from pcs_racing.planners.planner import Parameter as Parameter
from pcs_racing.planners.planner import Planner as Planner
from pcs_racing.planners.planner import Policy as Policy
from pcs_racing.planners.registry import get_planner as get_planner
from pcs_racing.planners.registry import parse_policy as parse_policy
from pcs_racing.planners.registry import planner_names as planner_names
from pcs_racing.planners.registry import register_planner as register_planner
from pcs_racing.race.config import CONTEST as CONTEST
from pcs_racing.race.config import PAPER as PAPER
from pcs_racing.race.config import ROBORACER as ROBORACER
from pcs_racing.race.config import RaceConfig as RaceConfig
from pcs_racing.race.config import load_race_config as load_race_config
from pcs_racing.race.races import RaceResult as RaceResult
from pcs_racing.race.races import RaceSetup as RaceSetup
from pcs_racing.race.races import advance as advance
from pcs_racing.race.races import draw_starts as draw_starts
from pcs_racing.race.races import run_field as run_field
from pcs_racing.race.races import run_races as run_races
from pcs_racing.race.races import start_races as start_races
from pcs_racing.race.recording import record_race as record_race
from pcs_racing.race.replay import Replay as Replay
from pcs_racing.race.replay import read_replay as read_replay
from pcs_racing.race.replay import save_replay as save_replay
from pcs_racing.race.start_grid import Starts as Starts
from pcs_racing.race.state import RaceState as RaceState
from pcs_racing.track.loading import load_track as load_track
from pcs_racing.track.maps import list_tracks as list_tracks
from pcs_racing.track.track import Track as Track
from pcs_racing.track.track import build_track as build_track

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
