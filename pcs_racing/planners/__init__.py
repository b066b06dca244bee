"""The policy families: motion planners that drive a car inside the compiled race."""

from pcs_racing.planners.gap_follower import GAP_FOLLOWER
from pcs_racing.planners.lane_switcher import LANE_SWITCHER
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.pure_pursuit import PURE_PURSUIT

__all__ = ["BUILT_IN", "GAP_FOLLOWER", "LANE_SWITCHER", "LATTICE", "PURE_PURSUIT"]

BUILT_IN: dict[str, Planner] = {
    planner.name: planner for planner in (LATTICE, PURE_PURSUIT, GAP_FOLLOWER, LANE_SWITCHER)
}
"""The planners of this package by name."""
