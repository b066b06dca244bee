"""Residual learning on a potential field [1]_: a network corrects a planner without a map.

Ten times a second the potential field (:mod:`pcs_racing.planners.field.potential_field`) requests a
steering angle and a speed. The inputs of a network are the nearest range in each of 54 sectors, the
car's measurements of itself and this command. It adds at most `STEERING` and `SPEED` to the
command. It was trained by PPO in races of the planner against itself and alone
(``data/planners/README.md``), rewarded for progress and for gaining on the other car.

Differences: the network is fully connected and its input is one scan; the paper's network is
convolutional, and its input is several scans.

References
----------
.. [1] R. Trumpp, E. Javanmardi, J. Nakazato, M. Tsukada and M. Caccamo, "RaceMOP: Mapless Online
   Path Planning for Multi-Agent Autonomous Racing using Residual Policy Learning", 2024,
   arXiv:2403.07129.
"""

from functools import cache
from typing import Any

import numpy as np

from pcs_racing.base.compilation import compiled, identified
from pcs_racing.base.dense import dense_forward
from pcs_racing.planners import view as _view
from pcs_racing.planners.field.potential_field import (
    NO_LIMIT,
    POTENTIAL_FIELD,
    SLOWEST,
    field_command,
)
from pcs_racing.planners.planner import Parameter
from pcs_racing.planners.scanning import BEAMS, MAX_RANGE, SCAN_SIZE, scan, steer_for

SECTOR = 5  # beams per sector; the last beam of 271 is left out
SECTORS = BEAMS // SECTOR
SEEN = SECTORS + 5  # inputs: sectors from right to left; speed, yaw rate, steering; field command
WIDTH = 64
LAYERS = ((SEEN, WIDTH), (WIDTH, WIDTH), (WIDTH, 2))  # a tanh after each
STEERING, SPEED = 0.2, 3.0  # max corrections, rad and m/s
MEMORY = 0
SCRATCH = SCAN_SIZE + 2 * WIDTH

PARAMETERS = (
    Parameter(
        "correction",
        0.0,
        1.0,
        1.0,
        "share of the network's correction that is added; 0 is the field alone",
    ),
    Parameter("speed_share", 0.6, 1.1, 1.0, "factor of the corrected speed"),
)
VARIANTS = {"calm": {"speed_share": 0.85}, "field": {"correction": 0.0}}
_FIELD, _SIZES = POTENTIAL_FIELD.default, np.array((SEEN, WIDTH, WIDTH, 2))


@compiled
def observe(track, view, scratch, seen):
    """Scan, write the inputs of the network into ``seen`` (SEEN,), and return the field's command.

    All inputs are of order one.
    """
    scan(track, view, scratch)
    ranges = scratch[SCAN_SIZE - BEAMS : SCAN_SIZE]
    steering, speed = field_command(_FIELD, view, ranges)
    for k in range(SECTORS):
        # The root resolves near ranges without losing far ones.
        seen[k] = 2.0 * np.sqrt(ranges[SECTOR * k : SECTOR * (k + 1)].min() / MAX_RANGE) - 1.0
    seen[SECTORS] = view[_view.OWN_V] / 8.0
    seen[SECTORS + 1] = view[_view.OWN_PSI_DOT] / 4.0
    seen[SECTORS + 2] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    seen[SECTORS + 3] = steering / view[_view.STEER_MAX]
    seen[SECTORS + 4] = speed / 8.0
    return steering, speed


@compiled
def lay_corrected(view, steering, speed, turn, faster, share, path):
    """Write the path of a command with corrections ``turn`` and ``faster``, both from -1 to 1."""
    speed = share * max(speed + SPEED * faster, SLOWEST)
    steer_for(view, steering + STEERING * turn, speed, NO_LIMIT, path)


@cache
def frozen_plan(frozen: bytes) -> Any:
    """Compile the planner with the weights of its network as constants of the code."""
    constant = np.frombuffer(frozen, np.float64)

    @compiled
    def plan(track, theta, view, memory, scratch, path):
        x, y = scratch[SCAN_SIZE : SCAN_SIZE + WIDTH], scratch[SCAN_SIZE + WIDTH : SCRATCH]
        steering, speed = observe(track, view, scratch, x)
        dense_forward(constant, _SIZES, x, y, True)
        lay_corrected(view, steering, speed, theta[0] * y[0], theta[0] * y[1], theta[1], path)

    return identified(plan, frozen)
