from . import view as view
from .field.lidar_ppo import (
    DenseLayers as DenseLayers,
    arc_policy as arc_policy,
    read_lidar_planner as read_lidar_planner,
    save_lidar_planner as save_lidar_planner,
)
from .imported import drivers_from as drivers_from
from .kit import (
    KAPPA as KAPPA,
    LEFT as LEFT,
    PSI as PSI,
    RIGHT as RIGHT,
    SPEED as SPEED,
    Lidar as Lidar,
    angle_between as angle_between,
    compiled as compiled,
    sine_cosine as sine_cosine,
    to_cartesian as to_cartesian,
)
from .line_ppo import (
    network_policy as network_policy,
    save_line_planner as save_line_planner,
)
from .planner import (
    Parameter as Parameter,
    Planner as Planner,
    Policy as Policy,
    PolicySet as PolicySet,
)
from .racers import racer as racer
from .registry import (
    get_planner as get_planner,
    parse_policy as parse_policy,
    planner_names as planner_names,
    register_planner as register_planner,
)
from .view import (
    PATH_KAPPA as PATH_KAPPA,
    PATH_POINTS as PATH_POINTS,
    PATH_SPEED as PATH_SPEED,
    PATH_X as PATH_X,
    PATH_Y as PATH_Y,
    VIEW as VIEW,
)

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
    "DenseLayers",
    "Lidar",
    "Parameter",
    "Planner",
    "Policy",
    "PolicySet",
    "angle_between",
    "arc_policy",
    "compiled",
    "drivers_from",
    "get_planner",
    "network_policy",
    "parse_policy",
    "planner_names",
    "racer",
    "read_lidar_planner",
    "register_planner",
    "save_lidar_planner",
    "save_line_planner",
    "sine_cosine",
    "to_cartesian",
    "view",
]
