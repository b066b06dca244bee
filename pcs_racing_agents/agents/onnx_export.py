"""ONNX files of policies, planners' networks and agents' networks, for programs without ours."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.envs.drive_options import drive_arguments, drive_elements
from pcs_racing.envs.models import ModelDriver, origin_of
from pcs_racing.planners.field.lidar_ppo import LIDAR_FORMAT
from pcs_racing.planners.learned import folder_format, is_planner_folder
from pcs_racing.planners.line_ppo import LINE_FORMAT
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing_agents.agents.onnx_planners import COMMAND, lidar_network, line_network
from pcs_racing_agents.agents.sb3_files import Sb3Policy, frozen_model, is_sb3, read_zip, scaler_of
from pcs_racing_agents.base.onnx_file import OnnxNetwork, Step, chain, layer_steps, write_onnx
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network

DRAWN = 64
"""Number of drawn observations with equal answers of a file and its policy."""


def export_onnx(model: Any, path: str | PathLike[str]) -> Path:
    """Write the network of a policy, a planner or an agent as an ONNX file, and return its path.

    The command of a policy or planner is a steering angle (rad) and a speed (m/s); planners drive
    the F1TENTH car. The file of ``line-ppo`` chooses a candidate of its lattice, and an agent
    makes a move. The file of a model or of an agent's network answers drawn observations as the
    model or network itself, or it is not written.

    Parameters
    ----------
    model : object
        Name of a learned planner (``"lidar-ppo"``) or of an agent's shipped network, the folder of
        one, or ``model.zip``; a Stable-Baselines3 model with an MlpPolicy, its policy
        (:func:`pcs_racing.racer`), or a :class:`RegretNetwork`.
    path : str or path
        File to write, ``NAME.onnx``.
    """
    if Path(path).suffix != ".onnx":
        raise InputError(f"can't write {path}: its name must end in .onnx")
    return write_onnx(_exported(model), Path(path))


def _exported(model: Any) -> OnnxNetwork:
    if isinstance(model, RegretNetwork):
        return _regrets(model)
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
        origin = _origin(model) if is_sb3(model) else None
        plain = _plain(model, type(model).__name__)
        with suppress(AttributeError):  # a model without environment, or of another one
            (elements,) = model.get_env().get_attr("elements", [0])
    game = (origin or {}).get("game")
    return _moves(plain, elements, game) if plain.moves else _exported(policy_racer(model))


def _origin(model: Any) -> Mapping[str, Any] | None:
    return origin_of(model, type(model).__name__, kept=scaler_of(model.get_env()))


def _plain(model: Any, name: str) -> Sb3Policy:
    return model if isinstance(model, Sb3Policy) else frozen_model(model, name)


def _named(name: str) -> OnnxNetwork:
    """Export the network of a folder, or a shipped network."""
    shipped = {one: place.shipped for place in FORMATS for one in place.shipped_names()}
    if name not in shipped and not is_planner_folder(name):
        raise UnknownNameError(f"there is no network {name!r}; {choices(name, sorted(shipped))}")
    folder = shipped[name] / name if name in shipped else Path(name)
    found = folder_format(folder)
    for place, export in FORMATS.items():
        if found == f"format: pcs-racing {place.noun}":
            return export(folder)
    raise InputError(f"{folder} has no network: its manifest begins with {found[:80]!r}")


# Models of Stable-Baselines3, and networks of agents


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


def _chooser(
    about: tuple[str, Any, Any, Any], steps: Sequence[Step], last: str, drawn: Any, answers: Any
) -> OnnxNetwork:
    """Export a network of values of moves; the move has the max value before the last operator.

    ``about`` holds the name, the descriptions of the observation and of the values, and the game of
    the training, if it is known.
    """
    nodes, constants = chain("observation", "raw", steps)
    moves = len(list(constants.values())[-1])  # biases of the last layer
    graph = f"""(float[N,{drawn.shape[1]}] observation) => (float[N,{moves}] values, int64[N] move)
        {{
        {nodes}
        values = {last} (raw)
        move = ArgMax <axis = 1, keepdims = 0> (raw)
        }}"""
    name, inputs, outputs, game = about
    described = {
        "name": name,
        "period": None,
        "inputs": {"observation": inputs},
        "outputs": {"values": outputs, "move": "index of the max value"},
        **({} if game is None else {"origin": {"environment": "duel", "game": game}}),
    }
    return OnnxNetwork(graph, constants, described, {"observation": drawn}, answers)


def _moves(plain: Sb3Policy, elements: Sequence[Any], game: Any) -> OnnxNetwork:
    drawn = np.random.default_rng(0).normal(size=(DRAWN, plain.layers.sizes[0])).astype(np.float32)
    about = plain.name, [one._asdict() for one in elements], "logit of each move", game
    return _chooser(about, _actor(plain), "Identity", drawn, {"move": plain.predict(drawn)[0]})


def _regrets(network: RegretNetwork) -> OnnxNetwork:
    size, last = len(network.elements), "Relu" if network.clipped else "Identity"
    drawn = np.random.default_rng(0).normal(network.mean, network.scale, (DRAWN, size))
    drawn = drawn.astype(np.float32)
    inputs, outputs = ([{"name": one} for one in part] for part in network.identity[:2])
    steps = _standardized(network.mean, network.scale) + layer_steps(network.layers, "Relu")
    answers = {"values": network(drawn), "move": network.choose(drawn)}
    about = network.name, inputs, outputs, network.identity._asdict()
    return _chooser(about, steps, last, drawn, answers)


FORMATS: dict[ArtifactFormat, Callable[[Path], OnnxNetwork]] = {
    LIDAR_FORMAT: lidar_network,
    LINE_FORMAT: line_network,
    NETWORK_FORMAT: lambda folder: _regrets(load_network(folder)),
}
