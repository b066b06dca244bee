from .archive import PolicyArchive as PolicyArchive
from .archive_files import (
    list_archives as list_archives,
    load_archive as load_archive,
    save_archive as save_archive,
)
from .characteristics import (
    Characteristic as Characteristic,
    Segment as Segment,
    get_characteristics as get_characteristics,
    measure as measure,
    register_characteristic as register_characteristic,
)
from .kit import (
    CONTROL_EVERY as CONTROL_EVERY,
    DT as DT,
    ITTC as ITTC,
    ITTC_SAMPLES as ITTC_SAMPLES,
    RaceSetup as RaceSetup,
    RaceState as RaceState,
    Rules as Rules,
    advance as advance,
    draw_starts as draw_starts,
    pad_parameters as pad_parameters,
    race_seeds as race_seeds,
    start_races as start_races,
)
from .make import make_game as make_game
from .moves import duplicate_moves as duplicate_moves, move_table as move_table
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
