"""Racing without a map by a network, trained by PPO: ``lidar-ppo``.

Ten times a second the network (two hidden layers) sees the nearest range in each of 75 sectors,
narrow ones in front and wide ones at the sides, how these ranges changed within the last two tenths
of a second, the car's measurements of itself and its last command. Its two outputs are a curvature,
as a share of `max_curvature`, and a change of speed. The car follows the arc of this curvature
until the next command. The network first imitated a planner with a map in the places where the
network drove, as in DAgger [1]_, and was then improved by PPO [2]_ against itself and other
planners. The critic of the training, and only the critic, knew the map and the opponent [3]_.
``examples/train_lidar_ppo.py`` trains such a network without imitation.

References
----------
.. [1] S. Ross, G. Gordon and J. A. Bagnell, "A reduction of imitation learning and structured
   prediction to no-regret online learning", AISTATS 2011.
.. [2] J. Schulman, F. Wolski, P. Dhariwal, A. Radford and O. Klimov, "Proximal policy optimization
   algorithms", 2017, arXiv:1707.06347.
.. [3] L. Pinto, M. Andrychowicz, P. Welinder, W. Zaremba and P. Abbeel, "Asymmetric actor critic
   for image-based robot learning", RSS 2018, arXiv:1710.06542.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.base.compilation import compiled, identified
from pcs_racing.base.dense import (
    DenseLayers,
    dense_forward,
    layers_from_bytes,
    layers_to_bytes,
    weight_count,
)
from pcs_racing.base.elementary import hyperbolic_tangent
from pcs_racing.base.errors import InputError
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.pursuit import steady_course, within_grip
from pcs_racing.planners.scanning import (
    BEAMS,
    MAX_RANGE,
    SCAN_SIZE,
    follow_scan,
    scan,
    use_odometry,
    write_arc,
)
from pcs_racing.planners.trained import PLANNER_FORMAT

EDGES = np.concatenate([np.arange(0, 90, 6), np.arange(90, 180, 2), np.arange(180, 271, 6)])
"""First beam of each sector, from right to left, and the end of the last one."""
SECTORS = len(EDGES) - 1
FRAMES = 3  # scans: the present scan and two before, 0.1 s apart
OWN = 5  # speed, yaw rate, steering angle, last command
SEEN = FRAMES * SECTORS + OWN  # inputs
WIDTH = 128
SIZES = (SEEN, WIDTH, WIDTH, 2)  # ReLU, ReLU, tanh
MAX_WEIGHT = 100.0
WEIGHTS = weight_count(SIZES)
MEMORY = 3 + (FRAMES - 1) * SECTORS  # 1 after the first scan, last command, earlier scans
SCRATCH = SCAN_SIZE + 2 * SEEN
CHANGE = 6.0  # factor of the change of a sector between two scans
MAX_KAPPA, HALVED = 1.3, 4.0  # max curvature at rest, 1/m, and the speed that halves it, m/s
PUSH = 1.0  # max change of the speed, m/s
SLOWEST = 0.5  # m/s
LATERAL = 6.0  # lateral acceleration that tyres must hold at the trained speeds, m/s^2

PARAMETERS = (
    Parameter(
        "speed_share",
        0.6,
        1.1,
        1.0,
        "factor of the speed; the network sees its own speed divided by it",
    ),
)
VARIANTS = {"calm": {"speed_share": 0.85}, "bold": {"speed_share": 1.05}}


@compiled
def observe(track, view, share, memory, scratch, seen):
    """Scan, and write the inputs of the network, of order one, into ``seen``, shape (SEEN,).

    `remember` keeps the scan, the first `SECTORS` inputs, for the next observations.
    """
    ranges = scan(track, view, scratch)
    begun = memory[0] > 0.0
    for k in range(SECTORS):
        nearest = MAX_RANGE
        for j in range(EDGES[k], EDGES[k + 1]):
            nearest = min(nearest, ranges[j])
        # The root resolves near ranges without losing far ones.
        now = 2.0 * np.sqrt(nearest / MAX_RANGE) - 1.0
        seen[k] = now
        for j in range(1, FRAMES):
            at = 3 + (j - 1) * SECTORS + k
            before = memory[at] if begun else now
            seen[j * SECTORS + k] = min(max(CHANGE * (now - before), -1.0), 1.0)
    own = FRAMES * SECTORS
    seen[own] = view[_view.OWN_V] / (8.0 * share)
    seen[own + 1] = view[_view.OWN_PSI_DOT] / (4.0 * share)
    seen[own + 2] = view[_view.OWN_DELTA] / view[_view.STEER_MAX]
    seen[own + 3] = memory[1]
    seen[own + 4] = memory[2]


@compiled
def remember(memory, scan_now):
    """Keep a scan, as roots, in a memory."""
    begun = memory[0] > 0.0
    memory[0] = 1.0
    for k in range(SECTORS):
        for j in range(FRAMES - 1, 1, -1):
            at = 3 + (j - 1) * SECTORS + k
            memory[at] = memory[at - SECTORS] if begun else scan_now[k]
        memory[3 + k] = scan_now[k]


@compiled
def held_share(view):
    """Return the share of the trained speeds that the own tyres hold in the same bends."""
    return np.sqrt(within_grip(view, LATERAL) / LATERAL)


@compiled
def max_curvature(v):
    """Return the max curvature of a command (1/m) at a speed (m/s)."""
    return MAX_KAPPA / (1.0 + (v / HALVED) ** 2)


@compiled
def lay_command(view, share, memory, turn, push, path):
    """Write the path of a command: ``turn`` and ``push``, clipped to -1 and 1; remember it."""
    use_odometry(view)
    turn, push = min(max(turn, -1.0), 1.0), min(max(push, -1.0), 1.0)
    memory[1], memory[2] = turn, push
    v = view[_view.OWN_V] / share
    kappa = turn * max_curvature(v)
    speed = share * max(v + PUSH * push, SLOWEST)
    write_arc(view, steady_course(view, kappa), kappa, 0.5 + 0.25 * view[_view.OWN_V], speed, path)


@compiled
def plan_by(flat, track, share, view, memory, scratch, path):
    """Plan by the network with the numbers ``flat``."""
    share *= held_share(view)
    x, y = scratch[SCAN_SIZE : SCAN_SIZE + SEEN], scratch[SCAN_SIZE + SEEN : SCRATCH]
    observe(track, view, share, memory, scratch, x)
    remember(memory, x)
    dense_forward(flat, SIZES, x, y, False)
    turn, push = hyperbolic_tangent(y[0]), hyperbolic_tangent(y[1])
    lay_command(view, share, memory, turn, push, path)


@cache
def frozen_plan(frozen: bytes) -> Any:
    """Compile the planner with the weights of its network as constants of the code."""
    constant = np.frombuffer(frozen, np.float64)

    @compiled
    def plan(track, theta, view, memory, scratch, path):
        plan_by(constant, track, theta[0], view, memory, scratch, path)

    return identified(plan, frozen)


@cache
def _numbered(sizes: tuple[int, ...], tanh: bool, squash: bool) -> Planner:
    """Return the planner of all networks with the same layers; its parameters are their numbers."""
    widest, even = max(sizes), len(sizes) % 2 == 1

    @compiled
    def plan(track, theta, view, memory, scratch, path):
        x = scratch[SCAN_SIZE : SCAN_SIZE + widest]
        y = scratch[SCAN_SIZE + widest : SCAN_SIZE + 2 * widest]
        share = held_share(view)
        observe(track, view, share, memory, scratch, x)
        remember(memory, x)
        dense_forward(theta, sizes, x, y, tanh)
        turn, push = (x[0], x[1]) if even else (y[0], y[1])
        if squash:
            turn, push = hyperbolic_tangent(turn), hyperbolic_tangent(push)
        lay_command(view, share, memory, turn, push, path)

    numbers = (
        Parameter(f"number {k}", -1e3, 1e3, 0.0, "weight of a network")
        for k in range(weight_count(sizes))
    )
    return Planner(
        name="arc-network",
        parameters=tuple(numbers),
        plan=identified(plan, f"{sizes} {tanh} {squash}".encode()),
        control=follow_scan,
        memory_size=MEMORY,
        scratch_size=SCAN_SIZE + 2 * widest,
    )


def arc_policy(
    layers: DenseLayers, *, tanh: bool = False, squash: bool = True, name: str = "arc-network"
) -> Policy:
    """Return the policy of a network from sectors to arcs, as `Drive` has them.

    Networks with the same layers share a planner, whose parameters are their numbers: nothing is
    compiled for a network that changes. The arguments are as in :meth:`DenseLayers.forward`.
    """
    sizes = getattr(layers, "sizes", (0,))
    if (sizes[0], sizes[-1]) != (SEEN, 2):
        raise InputError(
            f"{name} has layers of sizes {sizes}; from sectors to an arc they are DenseLayers of"
            f" {SEEN} to 2"
        )
    return _numbered(layers.sizes, tanh, squash).policy(layers.flat().astype(np.float64), name)


# Folders

LIDAR_FORMAT = replace(
    PLANNER_FORMAT,
    noun="lidar driver",
    keys=("name", "beams", "training", "weights_sha256"),
    writer="save_lidar_planner",
)


def save_lidar_planner(
    folder: str | Path, layers: DenseLayers, *, name: str, training: Mapping[str, Any]
) -> Path:
    """Save a lidar planner in a folder, created if missing.

    ``training`` describes the training: texts and numbers by name.
    """
    _check_layers(folder, layers)
    fields = {"name": name, "beams": BEAMS, "training": dict(training)}
    return LIDAR_FORMAT.save(folder, fields, layers_to_bytes(layers))


def read_lidar_planner(source: str | Path) -> tuple[str, DenseLayers]:
    """Return the name and network of a lidar planner, from its shipped name or its folder."""
    folder = LIDAR_FORMAT.find(source)
    fields, content = LIDAR_FORMAT.load(folder)
    layers, _ = layers_from_bytes(folder / LIDAR_FORMAT.data_file, content, list(SIZES[1:-1]))
    _check_layers(folder, layers)
    if (
        not isinstance(fields["name"], str)
        or fields["beams"] != BEAMS
        or not isinstance(fields["training"], dict)
    ):
        raise InputError(
            f"{folder / MANIFEST}: name must be a text, beams {BEAMS} and training a mapping"
        )
    return fields["name"], layers


def load_lidar_planner(source: str | Path) -> Planner:
    """Return a lidar planner; source and errors as for :func:`read_lidar_planner`."""
    name, layers = read_lidar_planner(source)
    return Planner(
        name=name,
        parameters=PARAMETERS,
        plan=frozen_plan(layers.flat().astype(np.float64).tobytes()),
        control=follow_scan,
        memory_size=MEMORY,
        scratch_size=SCRATCH,
        variants=VARIANTS,
    )


def _check_layers(folder: str | Path, layers: DenseLayers) -> None:
    largest = np.abs(layers.flat()).max()
    if layers.sizes != SIZES or largest > MAX_WEIGHT:
        raise InputError(
            f"{folder}: the network has sizes {layers.sizes} and weights up to {largest:g}; a lidar"
            f" planner's has sizes {SIZES} and weights up to {MAX_WEIGHT:g}"
        )


def __getattr__(name: str) -> Any:
    """Return ``LIDAR_PPO``, the shipped planner, loaded at first use."""
    if name != "LIDAR_PPO":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_lidar_planner("lidar-ppo")
    return globals()[name]
