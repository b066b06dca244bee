from .archive import PolicyArchive as PolicyArchive
from .archive_files import list_archives as list_archives
from .archive_files import load_archive as load_archive
from .archive_files import save_archive as save_archive
from .characteristics import Characteristic as Characteristic
from .characteristics import Segment as Segment
from .characteristics import get_characteristics as get_characteristics
from .characteristics import measure as measure
from .characteristics import register_characteristic as register_characteristic
from .kit import CONTROL_EVERY as CONTROL_EVERY
from .kit import DT as DT
from .kit import ITTC as ITTC
from .kit import ITTC_SAMPLES as ITTC_SAMPLES
from .kit import RaceSetup as RaceSetup
from .kit import RaceState as RaceState
from .kit import Rules as Rules
from .kit import advance as advance
from .kit import draw_starts as draw_starts
from .kit import pad_parameters as pad_parameters
from .kit import race_seeds as race_seeds
from .kit import start_races as start_races
from .make import make_game as make_game
from .moves import duplicate_moves as duplicate_moves
from .moves import move_table as move_table
from .players import ask_moves as ask_moves
from .rules import RaceGame as RaceGame
from .state import GameState as GameState

__all__ = [
    "CONTROL_EVERY",
    "DT",
    "ITTC",
    "ITTC_SAMPLES",
    "Characteristic",
    "GameState",
    "PolicyArchive",
    "RaceGame",
    "RaceSetup",
    "RaceState",
    "Rules",
    "Segment",
    "advance",
    "ask_moves",
    "draw_starts",
    "duplicate_moves",
    "get_characteristics",
    "list_archives",
    "load_archive",
    "make_game",
    "measure",
    "move_table",
    "pad_parameters",
    "race_seeds",
    "register_characteristic",
    "save_archive",
    "start_races",
]
