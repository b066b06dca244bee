"""ONNX graphs of the learned planners: from observations or ranges to commands or candidates."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.car.tyres import GRAVITY
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.field import lidar_ppo, residual
from pcs_racing.planners.field.lidar_networks import read_lidar_planner
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
from pcs_racing.planners.network import INPUTS, TOP_SPEED
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE
from pcs_racing.planners.trained import read_trained
from pcs_racing.race.config import DT, PLAN_EVERY
from pcs_racing_agents.base.onnx_graph import Exported, OnnxGraph, described

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
    weights, biases = [], []
    for below, above in shapes:
        biases.append(flat[:above])
        weights.append(flat[above : (below + 1) * above].reshape(below, above).T)
        flat = flat[(below + 1) * above :]
    return DenseLayers(tuple(weights), tuple(biases))


def trained_graph(folder: Path) -> Exported:
    """Return the network of a trained planner, from its inputs to the command."""
    network, fields = read_trained(folder)
    graph = OnnxGraph()
    x = graph.layers(graph.end("inputs", "observation", len(INPUTS)), network, "Tanh", "Tanh")
    half = np.array([0.0, 0.5 * TOP_SPEED])
    x = graph.add("Mul", x, np.array([F1TENTH.steer_max, 0.5 * TOP_SPEED]))
    graph.add("Add", x, half, name=graph.end("outputs", "command", 2))
    inputs = {"observation": [{"name": k, "meaning": v} for k, v in INPUTS.items()]}
    outputs, period = {"command": COMMAND}, fields["hold"] * DT
    return graph, described(fields["name"], period, inputs, outputs, vehicle=CAR)


def lidar_graph(folder: Path) -> Exported:
    """Return the network of a lidar planner: a command from ranges, or a correction."""
    name, network, flat = read_lidar_planner(folder)
    export = {"ppo": _lidar_ppo, "residual": _residual}[network]
    graph = OnnxGraph()
    inputs, outputs, state = export(graph, flat)
    return graph, described(name, PERIOD, inputs, outputs, **state)


def _residual(graph: OnnxGraph, flat: NDArray[np.float64]) -> Any:
    x = graph.end("inputs", "observation", residual.SEEN)
    x = graph.layers(x, _layers(flat, residual.LAYERS), "Tanh", "Tanh")
    limits = np.array([residual.STEERING, residual.SPEED])
    graph.add("Mul", x, limits, name=graph.end("outputs", "correction", 2))
    root = f"2 sqrt(r / {MAX_RANGE:g}) - 1 of the min range r (m), from right to left"
    own = ["speed / 8 m/s", "yaw rate / 4 rad/s", "steering angle / max", "field's steering / max"]
    names = [*([root] * residual.SECTORS), *own, "field's speed / 8 m/s"]
    return {"observation": [{"name": one} for one in names]}, {"correction": COMMAND}, {}


def _lidar_ppo(graph: OnnxGraph, flat: NDArray[np.float64]) -> Any:
    """Add the planner from the ranges to the command, as ``lidar_ppo.observe`` and the pursuit."""
    ranges, own = graph.end("inputs", "ranges", BEAMS), graph.end("inputs", "own", 3)
    memory = graph.end("inputs", "memory", lidar_ppo.MEMORY)
    sectors, edges = lidar_ppo.SECTORS, lidar_ppo.EDGES
    # A narrow sector names its last beam more than once.
    widest = np.minimum(edges[:-1, None] + np.arange(np.diff(edges).max()), edges[1:, None] - 1)
    near = graph.add("Gather", ranges, graph.constant(widest, np.int64), axis=1)
    near = graph.add("Clip", graph.add("ReduceMin", near, axes=[2], keepdims=0), 0.0, MAX_RANGE)
    now = graph.add("Sub", graph.add("Mul", graph.add("Sqrt", near), 2.0 * MAX_RANGE**-0.5), 1.0)
    both = graph.add("Concat", now, now, axis=1)
    begun = graph.add("Greater", graph.slice(memory, 0, 1), 0.0)
    before = graph.add("Where", begun, graph.slice(memory, 3, lidar_ppo.MEMORY), both)
    change = graph.add("Mul", graph.add("Sub", both, before), lidar_ppo.CHANGE)
    unit = 1.0 / np.array([8.0, 4.0, F1TENTH.steer_max])
    seen = [now, graph.add("Clip", change, -1.0, 1.0), graph.add("Mul", own, unit)]
    x = graph.add("Concat", *seen, graph.slice(memory, 1, 3), axis=1)
    x = graph.layers(x, _layers(flat, lidar_ppo.LAYERS), "Relu", "Tanh")
    begun = graph.add("Add", graph.add("Mul", graph.slice(memory, 0, 1), 0.0), 1.0)
    kept = [begun, x, now, graph.slice(before, 0, sectors)]
    graph.add("Concat", *kept, name=graph.end("outputs", "next_memory", lidar_ppo.MEMORY), axis=1)
    _pursue(graph, graph.slice(own, 0, 1), graph.slice(x, 0, 1), graph.slice(x, 1, 2))
    angle = 0.5 * FIELD_OF_VIEW
    beams: dict[str, Any] = {"unit": "m", "beams": BEAMS, "angle_min": -angle, "angle_max": angle}
    beams["max_range"] = MAX_RANGE
    names = {"speed": "m/s", "yaw rate": "rad/s", "steering angle": "rad"}
    inputs = {"ranges": beams, "own": [{"name": k, "unit": v} for k, v in names.items()]}
    outputs = {"arc": [{"name": "curvature", "unit": "1/m"}, COMMAND[1]], "command": COMMAND}
    return inputs, outputs, {"state": {"memory": "next_memory"}, "vehicle": CAR}


def _pursue(graph: OnnxGraph, v: str, turn: str, push: str) -> None:
    """Add the command of the pursuit at the start of the arc that the planner lays."""
    halved = graph.add("Div", v, lidar_ppo.HALVED)
    tight = graph.add("Add", graph.add("Mul", halved, halved), 1.0)
    kappa = graph.add("Div", graph.add("Mul", turn, lidar_ppo.MAX_KAPPA), tight)
    speed = graph.add("Add", v, graph.add("Mul", push, lidar_ppo.PUSH))
    speed = graph.add("Max", speed, lidar_ppo.SLOWEST)
    graph.add("Concat", kappa, speed, name=graph.end("outputs", "arc", 2), axis=1)
    speed = graph.add("Max", speed, graph.add("Sub", v, 0.1 * BRAKING))
    harder = graph.add("Min", graph.add("Mul", graph.add("Sub", speed, v), 10.0), 9.5)
    more = graph.add("Add", graph.add("Mul", harder, CAR["understeer_gain"]), CAR["understeer"])
    more = graph.add("Mul", graph.add("Mul", more, kappa), graph.add("Mul", v, v))
    steering = graph.add("Add", graph.add("Atan", graph.add("Mul", kappa, CAR["wheelbase"])), more)
    steering = graph.add("Clip", steering, -CAR["steer_max"], CAR["steer_max"])
    graph.add("Concat", steering, speed, name=graph.end("outputs", "command", 2), axis=1)


def line_graph(folder: Path) -> Exported:
    """Return the choice among the candidates, by features of `pcs_racing.planners.line_ppo`."""
    fields, numbers = read_line_planner(folder)
    flat, parts = numbers[LATTICE_SIZE:], {}
    for layer, (above, below) in LAYERS.items():
        network = _layers(flat, [(below, above)])
        parts[layer] = network.weights[0], network.biases[0]
        flat = flat[(below + 1) * above :]
    graph, number = OnnxGraph(), np.arange(CANDIDATES)
    sizes = {"situation": (CONTEXT,), "moves": (MOVE, GOALS), "speeds": (SPEED, SPEEDS)}
    sizes["candidates"] = (PAIR, CANDIDATES)
    situation, moves, speeds, own = (
        graph.end("inputs", name, *shape) for name, shape in sizes.items()
    )
    inner = graph.add("Tanh", graph.dense(situation, *parts["context"]))
    moves = graph.add("Gather", moves, graph.constant(number % GOALS, np.int64), axis=2)
    speeds = graph.add("Gather", speeds, graph.constant(number // GOALS, np.int64), axis=2)
    features = graph.add("Concat", moves, speeds, own, axis=1)
    weight, bias = parts["candidate"]
    hidden = graph.add("Add", graph.dense(inner, *parts["situation"]), bias)
    units = graph.add("Add", graph.add("MatMul", weight, features), graph.unsqueeze(hidden, 2))
    score = graph.add("MatMul", parts["score"][0], graph.add("Relu", units))
    linear = graph.unsqueeze(graph.dense(inner, *parts["weights"]), 1)
    cost = graph.slice(own, PAIR - 1, PAIR)
    score = graph.add("Add", score, graph.add("MatMul", linear, features))
    score = graph.add("Sub", score, graph.add("Mul", cost, SHARPNESS))
    score = graph.add("Where", graph.add("Less", cost, 0.0), REJECTED, score)
    scores, chosen = (
        graph.end("outputs", "scores", CANDIDATES),
        graph.end("outputs", "candidate", kind=np.int64),
    )
    graph.add("Squeeze", score, graph.constant([1], np.int64), name=scores)
    graph.add("ArgMax", scores, name=chosen, axis=1, keepdims=0)
    inputs = {name: f"features of shape {shape}" for name, shape in sizes.items()}
    outputs = {"scores": "score of each candidate", "candidate": "index of the max score"}
    return graph, described(fields["name"], PERIOD, inputs, outputs)
