"""Elements of the observation of sectors, as the planner ``lidar-ppo`` sees them."""

from pcs_racing.base.typing import ObservationElement as Element
from pcs_racing.planners.field.lidar_ppo import SECTORS

_SCANS = ("range {} now", "change of range {} in 0.1 s", "change of range {} in 0.2 s")
_OWN = {
    "speed": "own speed, in 8 m/s",
    "yaw rate": "own yaw rate, in 4 rad/s",
    "steering": "own steering angle, as a share of the largest",
    "last turn": "curvature of the last action",
    "last push": "change of the speed of the last action",
}

SECTOR_ELEMENTS = [
    Element(name.format(k), "1", -1.0, 1.0, f"root of the nearest range, sector {k} from the right")
    for name in _SCANS
    for k in range(SECTORS)
] + [Element(name, "1", -5.0, 5.0, text) for name, text in _OWN.items()]
