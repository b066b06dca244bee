from . import view as view
from .imported import drivers_from as drivers_from
from .kit import KAPPA as KAPPA
from .kit import LEFT as LEFT
from .kit import PSI as PSI
from .kit import RIGHT as RIGHT
from .kit import SPEED as SPEED
from .kit import Lidar as Lidar
from .kit import angle_between as angle_between
from .kit import compiled as compiled
from .kit import sine_cosine as sine_cosine
from .kit import to_cartesian as to_cartesian
from .planner import Parameter as Parameter
from .planner import Planner as Planner
from .planner import Policy as Policy
from .planner import PolicySet as PolicySet
from .racers import racer as racer
from .registry import get_planner as get_planner
from .registry import parse_policy as parse_policy
from .registry import planner_names as planner_names
from .registry import register_planner as register_planner
from .view import PATH_KAPPA as PATH_KAPPA
from .view import PATH_POINTS as PATH_POINTS
from .view import PATH_SPEED as PATH_SPEED
from .view import PATH_X as PATH_X
from .view import PATH_Y as PATH_Y
from .view import VIEW as VIEW

__all__ = [
    "KAPPA",
    "LEFT",
    "PATH_KAPPA",
    "PATH_POINTS",
    "PATH_SPEED",
    "PATH_X",
    "PATH_Y",
    "PSI",
    "RIGHT",
    "SPEED",
    "VIEW",
    "Lidar",
    "Parameter",
    "Planner",
    "Policy",
    "PolicySet",
    "angle_between",
    "compiled",
    "drivers_from",
    "get_planner",
    "parse_policy",
    "planner_names",
    "racer",
    "register_planner",
    "sine_cosine",
    "to_cartesian",
    "view",
]
