from . import envs as envs, game as game, planners as planners
from .base.errors import InputError as InputError
from .envs.duel import env as env, parallel_env as parallel_env
from .game.archive_files import load_archive as load_archive
from .game.make import make_game as make_game
from .planners.imported import drivers_from as drivers_from
from .planners.planner import Parameter as Parameter, Planner as Planner
from .planners.racers import racer as racer
from .planners.registry import register_planner as register_planner
from .race.config import CONTEST as CONTEST, PAPER as PAPER, load_rules as load_rules
from .race.races import run_field as run_field, run_races as run_races
from .race.recording import record_race as record_race
from .race.replay import save_replay as save_replay
from .track.loading import load_track as load_track

__all__ = [
    "CONTEST",
    "PAPER",
    "InputError",
    "Parameter",
    "Planner",
    "drivers_from",
    "env",
    "envs",
    "game",
    "load_archive",
    "load_rules",
    "load_track",
    "make_game",
    "parallel_env",
    "planners",
    "racer",
    "record_race",
    "register_planner",
    "run_field",
    "run_races",
    "save_replay",
]
