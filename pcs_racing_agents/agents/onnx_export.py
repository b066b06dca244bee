"""ONNX files of policies and of planners with a lidar, for programs without ours.

Policies and planners lead from observations or ranges to commands.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.car.tyres import GRAVITY
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive_options import drive_arguments, drive_elements
from pcs_racing.envs.models import ModelDriver
from pcs_racing.planners.field import lidar_ppo
from pcs_racing.planners.field.lidar_ppo import LIDAR_FORMAT
from pcs_racing.planners.learned import folder_kind, wrong_kind
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE
from pcs_racing.race.config import DT, PLAN_EVERY
from pcs_racing_agents.agents.sb3_files import (
    Sb3Policy,
    frozen_model,
    is_sb3,
    read_zip,
    training_origin,
)
from pcs_racing_agents.base.onnx_file import (
    OnnxNetwork,
    Step,
    chain,
    layer_steps,
    write_onnx,
)

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


def lidar_network(name: str, steps: Sequence[Step]) -> OnnxNetwork:
    """Return the network of a driver by lidar, given the steps from sectors to an arc."""
    nodes, constants = chain("seen", "action", steps)
    first, end = lidar_ppo.EDGES[:-1, None], lidar_ppo.EDGES[1:, None]
    numbers = {
        "zero": 0.0,
        "one": 1.0,
        "minus_one": -1.0,
        "max_range": MAX_RANGE,
        "root_scale": 2.0 * MAX_RANGE**-0.5,
        "change": lidar_ppo.CHANGE,
        "halved": lidar_ppo.HALVED,
        "max_kappa": lidar_ppo.MAX_KAPPA,
        "max_push": lidar_ppo.PUSH,
        "slowest": lidar_ppo.SLOWEST,
        "braking": 0.1 * BRAKING,
        "gain": 10.0,
        "max_acceleration": 9.5,
        "steer_min": -F1TENTH.steer_max,
        **CAR,
    }
    constants |= {name: np.array(value, np.float32) for name, value in numbers.items()}
    constants |= {
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


DRAWN = 64
"""Number of drawn observations with equal answers of a file and its policy."""


def export_onnx(model: Any, path: str | PathLike[str]) -> Path:
    """Write the network of a policy or a planner as an ONNX file, and return its path.

    The command of a policy or planner is a steering angle (rad) and a speed (m/s); ``lidar-ppo``
    drives the F1TENTH car. A model of `Duel` makes a move. The file of a model answers drawn
    observations as the model itself, or it is not written.

    Parameters
    ----------
    model : object
        Name of a planner with a lidar (``"lidar-ppo"``) or its folder, or ``model.zip``; a
        Stable-Baselines3 model with an MlpPolicy, or its policy (:func:`pcs_racing.racer`).
    path : str or path
        File to write, ``NAME.onnx``.
    """
    if Path(path).suffix != ".onnx":
        raise InputError(f"can't write {path}: its name must end in .onnx")
    return write_onnx(_exported(model), Path(path))


def _exported(model: Any) -> OnnxNetwork:
    if isinstance(model, Policy):
        driver: Any = model.planner.drive
        return _control(driver) if isinstance(driver, ModelDriver) else _named(model.planner.name)
    if isinstance(model, str | PathLike) and Path(model).suffix != ".zip":
        return _named(str(model))
    elements: Any = ()
    origin: Mapping[str, Any] | None
    if isinstance(model, str | PathLike):
        plain, origin = read_zip(Path(model))
    else:
        origin = training_origin(model, type(model).__name__) if is_sb3(model) else None
        plain = _plain(model, type(model).__name__)
        with suppress(AttributeError):  # a model without environment, or of another one
            (elements,) = model.get_env().get_attr("elements", [0])
    if isinstance(plain, Policy):
        raise InputError(
            f"{plain.name} scores the lattice's candidates, which no ONNX file would lay"
        )
    if (origin or {}).get("action") == "arc":
        within = [("Max", np.float32(-1.0)), ("Min", np.float32(1.0))]
        return lidar_network(plain.name, [*_actor(plain), *within])
    game = (origin or {}).get("game")
    return _moves(plain, elements, game) if plain.moves else _exported(policy_racer(model))


def _plain(model: Any, name: str) -> Sb3Policy:
    return model if isinstance(model, Sb3Policy) else frozen_model(model, name)


def _named(name: str) -> OnnxNetwork:
    """Export the network of a planner with a lidar, by its folder or shipped name."""
    shipped = {one: LIDAR_FORMAT.shipped / one for one in LIDAR_FORMAT.shipped_names()}
    known = [one for one, place in shipped.items() if folder_kind(place) == LIDAR_FORMAT.noun]
    folder = shipped[name] if name in known else Path(name)
    found = folder_kind(folder)
    if not found:
        raise UnknownNameError(f"there is no network {name!r}; {choices(name, known)}")
    if found != LIDAR_FORMAT.noun:
        raise wrong_kind(folder, found, [LIDAR_FORMAT.noun])
    name, layers = lidar_ppo.read_lidar_planner(folder)
    return lidar_network(name, [*layer_steps(layers, "Relu"), ("Tanh",)])


# Models of Stable-Baselines3


def _standardized(mean: Any, spread: Any, limit: float = np.inf) -> list[Step]:
    """Return the steps of ``(x - mean) / spread`` within a limit, computed in float64."""
    middle, unit, low, high = (np.asarray(one, np.float64) for one in (mean, spread, -limit, limit))
    bounded = (("Sub", middle), ("Div", unit), ("Max", low), ("Min", high))
    return [("Cast <to = 11>",), *bounded, ("Cast <to = 1>",)]


def _actor(plain: Sb3Policy) -> list[Step]:
    hidden = {"Tanh": "Tanh", "ReLU": "Relu"}[plain.activation]
    scaled = [] if plain.scale is None else _standardized(*plain.scale)
    return scaled + layer_steps(plain.layers, hidden) + [("Tanh",)] * plain.squash


def _control(driver: ModelDriver) -> OnnxNetwork:
    """Export a model of `Drive`; the observation is clipped and scaled as in the environment."""
    plain, options = _plain(driver.model, driver.name), driver.options
    elements = drive_elements(options, driver.cars)
    low, high = np.array([(one.low, one.high) for one in elements], np.float32).T
    turn, slow, fast = options.limits
    unit = np.array([turn, 0.5 * (fast - slow)], np.float32)
    middle = np.array([0.0, 0.5 * (fast + slow)], np.float32)
    scale, offset = 2.0 / (high - low), (high + low) / (high - low)
    normalized = [("Mul", scale), ("Sub", offset)] if options.normalize else []
    shares = [] if options.normalized or plain.squash else [("Sub", middle), ("Div", unit)]
    one = np.float32(1.0)
    within = [("Max", -one), ("Min", one), ("Mul", unit), ("Add", middle)]
    steps = [("Max", low), ("Min", high), *normalized, *_actor(plain), *shares, *within]
    drawn = np.random.default_rng(0).uniform(low, high, (DRAWN, len(low))).astype(np.float32)
    seen = drawn * scale - offset if options.normalize else drawn
    nodes, constants = chain("observation", "command", steps)
    graph = f"(float[N,{len(low)}] observation) => (float[N,2] command) {{\n{nodes}\n}}"
    about = {
        "name": driver.name,
        "period": options.time_step,
        "inputs": {"observation": [one._asdict() for one in elements]},
        "outputs": {"command": COMMAND},
        "origin": {"environment": "drive", **drive_arguments(options, driver.cars)},
    }
    answers = {"command": driver.commands_of(seen)}
    return OnnxNetwork(graph, constants, about, {"observation": drawn}, answers)


def _moves(plain: Sb3Policy, elements: Sequence[Any], game: Any) -> OnnxNetwork:
    """Export a model of `Duel`, with the game of its training, if it is known."""
    size, moves = plain.layers.sizes[0], plain.layers.sizes[-1]
    nodes, constants = chain("observation", "values", _actor(plain))
    graph = f"""(float[N,{size}] observation) => (float[N,{moves}] values, int64[N] move)
        {{
        {nodes}
        move = ArgMax <axis = 1, keepdims = 0> (values)
        }}"""
    about = {
        "name": plain.name,
        "period": None,
        "inputs": {"observation": [one._asdict() for one in elements]},
        "outputs": {"values": "logit of each move", "move": "index of the max value"},
        **({} if game is None else {"origin": {"environment": "duel", "game": game}}),
    }
    drawn = np.random.default_rng(0).normal(size=(DRAWN, size)).astype(np.float32)
    answers = {"move": plain.predict(drawn)[0]}
    return OnnxNetwork(graph, constants, about, {"observation": drawn}, answers)
