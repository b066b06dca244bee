from . import drive as drive, duel as duel, line as line
from .batch import Step as Step
from .drive import (
    DriveEnv as DriveEnv,
    DriveHeadToHeadEnv as DriveHeadToHeadEnv,
    DriveHeadToHeadVectorEnv as DriveHeadToHeadVectorEnv,
    DriveVectorEnv as DriveVectorEnv,
)
from .duel import (
    DuelEnv as DuelEnv,
    DuelVectorEnv as DuelVectorEnv,
    HeadToHeadEnv as HeadToHeadEnv,
    SelfPlayVectorEnv as SelfPlayVectorEnv,
)
from .infos import Result as Result
from .line import (
    LineEnv as LineEnv,
    LineHeadToHeadEnv as LineHeadToHeadEnv,
    LineHeadToHeadVectorEnv as LineHeadToHeadVectorEnv,
    LineVectorEnv as LineVectorEnv,
)
from .line_options import split_observation as split_observation
from .obstacles import Obstacles as Obstacles
from .random_circuits import (
    RandomCircuits as RandomCircuits,
    find_speeds as find_speeds,
    random_circuit as random_circuit,
)
from .registration import (
    GYMNASIUM_IDS as GYMNASIUM_IDS,
    PETTINGZOO_IDS as PETTINGZOO_IDS,
    register_environments as register_environments,
)
from .sb3 import SB3VecEnv as SB3VecEnv, make_sb3_vec_env as make_sb3_vec_env
from .video import RecordRaces as RecordRaces

__all__ = [
    "GYMNASIUM_IDS",
    "PETTINGZOO_IDS",
    "DriveEnv",
    "DriveHeadToHeadEnv",
    "DriveHeadToHeadVectorEnv",
    "DriveVectorEnv",
    "DuelEnv",
    "DuelVectorEnv",
    "HeadToHeadEnv",
    "LineEnv",
    "LineHeadToHeadEnv",
    "LineHeadToHeadVectorEnv",
    "LineVectorEnv",
    "Obstacles",
    "RandomCircuits",
    "RecordRaces",
    "Result",
    "SB3VecEnv",
    "SelfPlayVectorEnv",
    "Step",
    "drive",
    "duel",
    "find_speeds",
    "line",
    "make_sb3_vec_env",
    "random_circuit",
    "register_environments",
    "split_observation",
]
