"""ONNX graphs of the learned planners: from observations or ranges to commands or candidates."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.car.tyres import GRAVITY
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.field import lidar_ppo
from pcs_racing.planners.lattice import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.line_ppo import (
    CONTEXT,
    LATTICE_SIZE,
    LAYERS,
    MOVE,
    PAIR,
    SHARPNESS,
    SPEED,
    read_line_planner,
)
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE
from pcs_racing.race.config import DT, PLAN_EVERY
from pcs_racing_agents.base.onnx_graph import OnnxGraph, Value

COMMAND = [{"name": "steering angle", "unit": "rad"}, {"name": "speed", "unit": "m/s"}]
_GRIP = F1TENTH.mu * GRAVITY
CAR = {
    "wheelbase": F1TENTH.lf + F1TENTH.lr,
    "rear_axle": F1TENTH.lr,
    "steer_max": F1TENTH.steer_max,
    "rear_slip": 1.0 / (_GRIP * F1TENTH.c_sr),
    "understeer": (1.0 / F1TENTH.c_sf - 1.0 / F1TENTH.c_sr) / _GRIP,
    "understeer_gain": F1TENTH.h
    / (_GRIP * GRAVITY)
    * (1.0 / (F1TENTH.c_sf * F1TENTH.lr) + 1.0 / (F1TENTH.c_sr * F1TENTH.lf)),
}
"""Car of the commands, as in a planner's view: m, rad, rad s^2/m and rad s^4/m^2."""
PERIOD = PLAN_EVERY * DT
REJECTED = -1e30  # score of a rejected candidate


def _layers(flat: NDArray[np.float64], shapes: Sequence[tuple[int, int]]) -> DenseLayers:
    """Return layers of shapes (inputs, outputs) from the numbers of `DenseLayers.flat`."""
    ends = np.cumsum([(below + 1) * above for below, above in shapes])[:-1]
    parts = [
        part.reshape(below + 1, above)
        for part, (below, above) in zip(np.split(flat, ends), shapes, strict=True)
    ]
    return DenseLayers(tuple(part[1:].T for part in parts), tuple(part[0] for part in parts))


def lidar_graph(folder: Path) -> OnnxGraph:
    """Return the network of a lidar planner, from ranges to an arc as `lidar_ppo.plan_by`, and the
    arc's command.
    """
    name, layers = lidar_ppo.read_lidar_planner(folder)
    graph = OnnxGraph(name, PERIOD)
    angle, size, sectors = 0.5 * FIELD_OF_VIEW, lidar_ppo.MEMORY, lidar_ppo.SECTORS
    beams = {"beams": BEAMS, "angle_min": -angle, "angle_max": angle, "max_range": MAX_RANGE}
    ranges = graph.input("ranges", BEAMS, about={"unit": "m", **beams})
    names = {"speed": "m/s", "yaw rate": "rad/s", "steering angle": "rad"}
    own = graph.input("own", 3, about=[{"name": k, "unit": v} for k, v in names.items()])
    memory = graph.input("memory", size)
    first, end = lidar_ppo.EDGES[:-1, None], lidar_ppo.EDGES[1:, None]
    # A narrow sector names its last beam more than once.
    number = graph.constant(np.minimum(first + np.arange((end - first).max()), end - 1), np.int64)
    near = graph.add("ReduceMin", graph.add("Gather", ranges, number, axis=1), axes=[2], keepdims=0)
    now = graph.add("Sqrt", near.clip(0.0, MAX_RANGE)) * (2.0 * MAX_RANGE**-0.5) - 1.0
    both = graph.add("Concat", now, now, axis=1)
    before = graph.add("Where", graph.add("Greater", memory[0:1], 0.0), memory[3:size], both)
    change = ((both - before) * lidar_ppo.CHANGE).clip(-1.0, 1.0)
    scaled = own / [8.0, 4.0, F1TENTH.steer_max]
    x = graph.add("Concat", now, change, scaled, memory[1:3], axis=1)
    x = graph.layers(x, layers, "Relu", "Tanh")
    kept = memory[0:1] * 0.0 + 1.0, x, now, before[0:sectors]
    graph.output("next_memory", graph.add("Concat", *kept, axis=1), size)
    graph.about |= {"state": {"memory": "next_memory"}, "vehicle": CAR}
    _add_command(graph, own[0:1], x[0:1], x[1:2])
    return graph


def _add_command(graph: OnnxGraph, v: Value, turn: Value, push: Value) -> None:
    """Add the arc of `lidar_ppo.lay_command`, and the command of the pursuit at its start."""
    slower = v / lidar_ppo.HALVED
    kappa = turn * lidar_ppo.MAX_KAPPA / (slower * slower + 1.0)
    speed = graph.add("Max", v + push * lidar_ppo.PUSH, lidar_ppo.SLOWEST)
    arc = [{"name": "curvature", "unit": "1/m"}, COMMAND[1]]
    graph.output("arc", graph.add("Concat", kappa, speed, axis=1), 2, about=arc)
    speed = graph.add("Max", speed, v - 0.1 * BRAKING)
    harder = graph.add("Min", (speed - v) * 10.0, 9.5)
    understeer = (harder * CAR["understeer_gain"] + CAR["understeer"]) * v * v * kappa
    steering = graph.add("Atan", kappa * CAR["wheelbase"]) + understeer
    steering = steering.clip(-CAR["steer_max"], CAR["steer_max"])
    graph.output("command", graph.add("Concat", steering, speed, axis=1), 2, about=COMMAND)


def line_graph(folder: Path) -> OnnxGraph:
    """Return the choice among the candidates, by features of `pcs_racing.planners.line_ppo`."""
    fields, numbers = read_line_planner(folder)
    graph, number = OnnxGraph(fields["name"], PERIOD), np.arange(CANDIDATES)
    # Not a chain of layers: each is unpacked by itself.
    flat, parts = numbers[LATTICE_SIZE:], {}
    for layer, (above, below) in LAYERS.items():
        network = _layers(flat[: (below + 1) * above], [(below, above)])
        parts[layer], flat = (network.weights[0], network.biases[0]), flat[(below + 1) * above :]
    sizes = {"situation": (CONTEXT,), "moves": (MOVE, GOALS), "speeds": (SPEED, SPEEDS)}
    sizes["candidates"] = (PAIR, CANDIDATES)
    situation, moves, speeds, own = (
        graph.input(name, *shape, about=f"features of shape {shape}")
        for name, shape in sizes.items()
    )
    inner = graph.add("Tanh", graph.dense(situation, *parts["context"]))
    moves, speeds = (
        graph.add("Gather", one, graph.constant(index, np.int64), axis=2)
        for one, index in ((moves, number % GOALS), (speeds, number // GOALS))
    )
    features = graph.add("Concat", moves, speeds, own, axis=1)
    weight, bias = parts["candidate"]
    hidden = (graph.dense(inner, *parts["situation"]) + bias).unsqueeze(2)
    units = graph.add("Relu", graph.add("MatMul", weight, features) + hidden)
    linear = graph.dense(inner, *parts["weights"]).unsqueeze(1)
    score = graph.add("MatMul", parts["score"][0], units) + graph.add("MatMul", linear, features)
    cost = own[PAIR - 1 : PAIR]
    score = graph.add("Where", graph.add("Less", cost, 0.0), REJECTED, score - cost * SHARPNESS)
    scores = graph.add("Squeeze", score, graph.constant([1], np.int64))
    graph.output("scores", scores, CANDIDATES, about="score of each candidate")
    graph.choose("candidate", scores)
    return graph
