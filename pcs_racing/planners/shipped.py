"""Names of the planners of this package, without their code, which takes a second to import."""

import re

SHIPPED = {
    "alpha-racer": "pcs_racing.planners.field.alpha_racer:ALPHA_RACER",
    "bimatrix-game": "pcs_racing.planners.field.bimatrix:BIMATRIX",
    "disparity-extender": "pcs_racing.planners.field.disparity_extender:DISPARITY_EXTENDER",
    "follow-the-gap": "pcs_racing.planners.field.follow_the_gap:FOLLOW_THE_GAP",
    "gap-follower": "pcs_racing.planners.field.gap_follower:GAP_FOLLOWER",
    "iterated-best-response": "pcs_racing.planners.field.best_response:BEST_RESPONSE",
    "lane-switcher": "pcs_racing.planners.lane_switcher:LANE_SWITCHER",
    "lattice": "pcs_racing.planners.lattice:LATTICE",
    "lidar-ppo": "pcs_racing.planners.field.lidar_ppo:LIDAR_PPO",
    "line-ppo": "pcs_racing.planners.line_ppo:LINE_PPO",
    "line-ppo-robust": "pcs_racing.planners.line_ppo:LINE_PPO_ROBUST",
    "mppi": "pcs_racing.planners.field.mppi:MPPI",
    "predictive-spliner": "pcs_racing.planners.field.predictive_spliner:PREDICTIVE_SPLINER",
    "pure-pursuit": "pcs_racing.planners.field.pure_pursuit:PURE_PURSUIT",
    "spliner": "pcs_racing.planners.field.spliner:SPLINER",
    "stanley": "pcs_racing.planners.field.stanley:STANLEY",
}
"""Planners of this package: name and place. A new planner is a file and a line here."""


def split_name(text: str) -> tuple[str, str, str]:
    """Return the name of a planner or an agent, the colon after it, and the rest.

    The result is as in ``str.partition``. The name may be the path of a Python file, with spaces
    and a drive of Windows.
    """
    file = re.match(r"\s*((?:[A-Za-z]:[\\/])?[^:]*\.py)\s*(?:(:)(.*))?$", text, re.DOTALL)
    name, separator, rest = file.groups("") if file else text.partition(":")
    return name.strip(), separator, rest
