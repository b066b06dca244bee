from . import envs as envs
from . import game as game
from . import planners as planners
from .base.errors import InputError as InputError
from .envs.duel import env as env
from .envs.duel import parallel_env as parallel_env
from .game.archive_files import load_archive as load_archive
from .game.make import make_game as make_game
from .planners.registry import parse_policy as parse_policy
from .race.config import CONTEST as CONTEST
from .race.config import PAPER as PAPER
from .race.config import load_race_config as load_race_config
from .race.frames import write_gif as write_gif
from .race.races import run_field as run_field
from .race.races import run_races as run_races
from .race.recording import record_race as record_race
from .race.replay import save_replay as save_replay
from .track.loading import load_track as load_track
from .track.maps import list_tracks as list_tracks

__all__ = [
    "CONTEST",
    "PAPER",
    "InputError",
    "env",
    "envs",
    "game",
    "list_tracks",
    "load_archive",
    "load_race_config",
    "load_track",
    "make_game",
    "parallel_env",
    "parse_policy",
    "planners",
    "record_race",
    "run_field",
    "run_races",
    "save_replay",
    "write_gif",
]
