"""ONNX files of the learned planners: from observations or ranges to commands or candidates."""

from pathlib import Path

import numpy as np

from pcs_racing.car.tyres import GRAVITY
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.field import lidar_ppo
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
from pcs_racing_agents.base.onnx_file import Constants, OnnxNetwork, chain, layer_steps

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

# From ranges to an arc as `lidar_ppo.plan_by` and `lay_command`, and the command of the pursuit at
# the start of the arc.
LIDAR = f"""
(float[N,{BEAMS}] ranges, float[N,3] own, float[N,{lidar_ppo.MEMORY}] memory)
=> (float[N,{lidar_ppo.MEMORY}] next_memory, float[N,2] arc, float[N,2] command)
{{
    of_sectors = Gather <axis = 1> (ranges, sector_beams)
    near = ReduceMin <axes = [2], keepdims = 0> (of_sectors)
    near_in_range = Clip (near, zero, max_range)
    root = Sqrt (near_in_range)
    root_scaled = Mul (root, root_scale)
    now = Sub (root_scaled, one)
    begun, last_command, scans = Split <axis = 1> (memory, memory_parts)
    has_begun = Greater (begun, zero)
    now_twice = Concat <axis = 1> (now, now)
    before = Where (has_begun, scans, now_twice)
    difference = Sub (now_twice, before)
    difference_scaled = Mul (difference, change)
    changed = Clip (difference_scaled, minus_one, one)
    own_scaled = Div (own, own_scale)
    seen = Concat <axis = 1> (now, changed, own_scaled, last_command)
    LAYERS
    turn, push = Split <axis = 1> (action)
    last_scan, earlier_scan = Split <axis = 1> (before)
    none = Mul (begun, zero)
    is_begun = Add (none, one)
    next_memory = Concat <axis = 1> (is_begun, action, now, last_scan)
    v, yaw_rate, delta = Split <axis = 1> (own)
    v_share = Div (v, halved)
    v_square = Mul (v_share, v_share)
    easing = Add (v_square, one)
    turn_scaled = Mul (turn, max_kappa)
    kappa = Div (turn_scaled, easing)
    push_scaled = Mul (push, max_push)
    v_pushed = Add (v, push_scaled)
    v_arc = Max (v_pushed, slowest)
    arc = Concat <axis = 1> (kappa, v_arc)
    v_braked = Sub (v, braking)
    speed = Max (v_arc, v_braked)
    v_missing = Sub (speed, v)
    v_missing_scaled = Mul (v_missing, gain)
    acceleration = Min (v_missing_scaled, max_acceleration)
    slip_of_push = Mul (acceleration, understeer_gain)
    slip = Add (slip_of_push, understeer)
    slip_v = Mul (slip, v)
    slip_v_v = Mul (slip_v, v)
    slip_angle = Mul (slip_v_v, kappa)
    bend = Mul (kappa, wheelbase)
    course = Atan (bend)
    steering_free = Add (course, slip_angle)
    steering = Clip (steering_free, steer_min, steer_max)
    command = Concat <axis = 1> (steering, speed)
}}
"""

# Choice among the candidates, by features of `pcs_racing.planners.line_ppo`.
LINE = f"""
(float[N,{CONTEXT}] situation, float[N,{MOVE},{GOALS}] moves, float[N,{SPEED},{SPEEDS}] speeds,
 float[N,{PAIR},{CANDIDATES}] candidates)
=> (float[N,{CANDIDATES}] scores, int64[N] candidate)
{{
    context = Gemm (situation, context_weight, context_bias)
    inner = Tanh (context)
    move_each = Gather <axis = 2> (moves, move_of)
    speed_each = Gather <axis = 2> (speeds, speed_of)
    features = Concat <axis = 1> (move_each, speed_each, candidates)
    hidden_shared = Gemm (inner, situation_weight, situation_bias)
    hidden_biased = Add (hidden_shared, candidate_bias)
    hidden_column = Unsqueeze (hidden_biased, axis_2)
    candidate_rows = Transpose (candidate_weight)
    hidden_own = MatMul (candidate_rows, features)
    hidden = Add (hidden_own, hidden_column)
    units = Relu (hidden)
    score_row = Transpose (score_weight)
    by_units = MatMul (score_row, units)
    linear = Gemm (inner, weights_weight, weights_bias)
    linear_row = Unsqueeze (linear, axis_1)
    by_features = MatMul (linear_row, features)
    correction = Add (by_units, by_features)
    others, cost = Split <axis = 1> (candidates, cost_last)
    price = Mul (cost, sharpness)
    score = Sub (correction, price)
    is_rejected = Less (cost, zero)
    score_each = Where (is_rejected, rejected, score)
    scores = Squeeze (score_each, axis_1)
    candidate = ArgMax <axis = 1, keepdims = 0> (scores)
}}
"""


def _constants(**values: float) -> Constants:
    return {name: np.array(value, np.float32) for name, value in values.items()}


def lidar_network(folder: Path) -> OnnxNetwork:
    """Return the network of a lidar planner."""
    name, layers = lidar_ppo.read_lidar_planner(folder)
    nodes, constants = chain("seen", "action", [*layer_steps(layers, "Relu"), ("Tanh",)])
    first, end = lidar_ppo.EDGES[:-1, None], lidar_ppo.EDGES[1:, None]
    constants |= _constants(
        zero=0.0,
        one=1.0,
        minus_one=-1.0,
        max_range=MAX_RANGE,
        root_scale=2.0 * MAX_RANGE**-0.5,
        change=lidar_ppo.CHANGE,
        halved=lidar_ppo.HALVED,
        max_kappa=lidar_ppo.MAX_KAPPA,
        max_push=lidar_ppo.PUSH,
        slowest=lidar_ppo.SLOWEST,
        braking=0.1 * BRAKING,
        gain=10.0,
        max_acceleration=9.5,
        steer_min=-F1TENTH.steer_max,
        **CAR,
    ) | {
        # A narrow sector names its last beam more than once.
        "sector_beams": np.minimum(first + np.arange((end - first).max()), end - 1),
        "memory_parts": np.array([1, 2, lidar_ppo.MEMORY - 3]),
        "own_scale": np.array([8.0, 4.0, F1TENTH.steer_max], np.float32),
    }
    angle = 0.5 * FIELD_OF_VIEW
    beams = {"beams": BEAMS, "angle_min": -angle, "angle_max": angle, "max_range": MAX_RANGE}
    own = {"speed": "m/s", "yaw rate": "rad/s", "steering angle": "rad"}
    about = {
        "name": name,
        "period": PERIOD,
        "inputs": {
            "ranges": {"unit": "m", **beams},
            "own": [{"name": k, "unit": v} for k, v in own.items()],
        },
        "outputs": {"arc": [{"name": "curvature", "unit": "1/m"}, COMMAND[1]], "command": COMMAND},
        "state": {"memory": "next_memory"},
        "vehicle": CAR,
    }
    return OnnxNetwork(LIDAR.replace("LAYERS", nodes), constants, about)


def line_network(folder: Path) -> OnnxNetwork:
    """Return the network of ``line-ppo``, from features to the chosen candidate."""
    fields, numbers = read_line_planner(folder)
    flat, number = numbers[LATTICE_SIZE:], np.arange(CANDIDATES)
    constants = _constants(zero=0.0, rejected=-1e30, sharpness=SHARPNESS) | {
        "move_of": number % GOALS,
        "speed_of": number // GOALS,
        "axis_1": np.array([1]),
        "axis_2": np.array([2]),
        "cost_last": np.array([PAIR - 1, 1]),
    }
    for layer, (above, below) in LAYERS.items():
        part = flat[: (below + 1) * above].astype(np.float32).reshape(below + 1, above)
        constants |= {f"{layer}_bias": part[0], f"{layer}_weight": part[1:]}
        flat = flat[part.size :]
    del constants["score_bias"]  # the same for all candidates
    sizes = {
        "situation": (CONTEXT,),
        "moves": (MOVE, GOALS),
        "speeds": (SPEED, SPEEDS),
        "candidates": (PAIR, CANDIDATES),
    }
    about = {
        "name": fields["name"],
        "period": PERIOD,
        "inputs": {name: f"features of shape {shape}" for name, shape in sizes.items()},
        "outputs": {
            "scores": "score of each candidate",
            "candidate": "index of the max value",
        },
    }
    return OnnxNetwork(LINE, constants, about)
