"""Names for the compiled code of own planners: compilation, track columns, geometry."""

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.car.lidar import Lidar
from pcs_racing.track.frenet import (
    KAPPA,
    LEFT,
    PSI,
    RIGHT,
    SPEED,
    angle_between,
    to_cartesian,
)

__all__ = [
    "KAPPA",
    "LEFT",
    "PSI",
    "RIGHT",
    "SPEED",
    "Lidar",
    "angle_between",
    "compiled",
    "sine_cosine",
    "to_cartesian",
]
