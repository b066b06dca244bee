"""ONNX files of policies, planners' networks and agents' networks, for programs without ours."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.envs.drive_options import drive_elements
from pcs_racing.envs.models import ModelDriver, model_policy
from pcs_racing.planners.field.lidar_networks import LIDAR_FORMAT
from pcs_racing.planners.learned import folder_format, is_planner_folder
from pcs_racing.planners.line_ppo import LINE_FORMAT
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.trained import PLANNER_FORMAT
from pcs_racing_agents.agents.onnx_planners import (
    COMMAND,
    lidar_graph,
    line_graph,
    trained_graph,
)
from pcs_racing_agents.agents.sb3_files import (
    Sb3Policy,
    frozen_model,
    load_model,
    load_sb3_policy,
    plain_model,
)
from pcs_racing_agents.base.onnx_graph import Exported, OnnxGraph, described
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network


def export_onnx(model: Any, path: str | PathLike[str]) -> Path:
    """Write the network of a policy, a planner or an agent as an ONNX file, and return its path.

    The command of a policy or planner is a steering angle (rad) and a speed (m/s), those of the
    F1TENTH car. The file of ``line-ppo`` chooses a candidate of its lattice, ``residual`` corrects
    its potential field, and an agent makes a move.

    Parameters
    ----------
    model : object
        Name of a learned planner (``"lidar-ppo"``) or of an agent's shipped network, the folder of
        one, or ``model.zip`` of :func:`save_model`; a Stable-Baselines3 model with an MlpPolicy, a
        policy of :func:`load_model`, or a :class:`RegretNetwork`.
    path : str or path
        File to write, ``NAME.onnx``.
    """
    if Path(path).suffix != ".onnx":
        raise InputError(f"can't write {path}: its name must end in .onnx")
    graph, about = _exported(model)
    return graph.write(Path(path), about)


def _exported(model: Any) -> Exported:
    if isinstance(model, RegretNetwork):
        return _regrets(model)
    if isinstance(model, Policy):
        driver: Any = model.planner.drive
        return _control(driver) if isinstance(driver, ModelDriver) else _named(model.planner.name)
    if isinstance(model, str | PathLike):
        return _model_file(Path(model)) if Path(model).suffix == ".zip" else _named(str(model))
    name = type(model).__name__
    plain = _plain(model, name)
    if plain.moves:
        elements: Any = ()
        with suppress(AttributeError):  # a model without environment, or of another one
            (elements,) = model.get_env().get_attr("elements", [0])
        return _moves(plain, [one._asdict() for one in elements])
    frozen, arguments = frozen_model(model, name)
    return _exported(model_policy(frozen, **arguments))


def _plain(model: Any, name: str) -> Sb3Policy:
    plain = model if isinstance(model, Sb3Policy) else plain_model(model, name)
    if not isinstance(plain, Sb3Policy):
        raise InputError(
            f"a {type(model).__name__} has no actor of fully connected layers; train PPO, A2C, SAC"
            " or TD3 with MlpPolicy"
        )
    return plain


def _model_file(file: Path) -> Exported:
    plain = load_sb3_policy(file)
    return _moves(plain, []) if plain.moves else _exported(load_model(file))


def _named(name: str) -> Exported:
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


# Models of Stable-Baselines3


def _actor(graph: OnnxGraph, x: str, plain: Sb3Policy) -> str:
    hidden = {"Tanh": "Tanh", "ReLU": "Relu"}[plain.activation]
    last = "Tanh" if plain.squash else None
    x = x if plain.scale is None else graph.standardize(x, *plain.scale)
    return graph.layers(x, plain.layers, hidden, last)


def _control(driver: ModelDriver) -> Exported:
    """Export a model of `Drive`; the observation is clipped and scaled as in the environment."""
    plain, options = _plain(driver.model, driver.name), driver.options
    elements = drive_elements(options, driver.cars)
    low, high = np.array([(one.low, one.high) for one in elements]).T
    graph = OnnxGraph()
    x = graph.add("Max", graph.end("inputs", "observation", len(elements)), low)
    x = graph.add("Min", x, high)
    if options.normalize:
        gain = 2.0 / (high - low)
        x = graph.add("Add", graph.add("Mul", x, gain), -1.0 - low * gain)
    x = _actor(graph, x, plain)
    turn, slow, fast = options.limits
    unit, middle = np.array([turn, 0.5 * (fast - slow)]), np.array([0.0, 0.5 * (fast + slow)])
    if not (options.normalized or plain.squash):
        x = graph.add("Div", graph.add("Sub", x, middle), unit)
    x = graph.add("Mul", graph.add("Clip", x, -1.0, 1.0), unit)
    graph.add("Add", x, middle, name=graph.end("outputs", "command", 2))
    inputs = {"observation": [one._asdict() for one in elements]}
    return graph, described(driver.name, options.time_step, inputs, {"command": COMMAND})


def _moves(plain: Sb3Policy, elements: Sequence[Mapping[str, Any]]) -> Exported:
    graph = OnnxGraph()
    sizes = plain.layers.sizes
    raw = _actor(graph, graph.end("inputs", "observation", sizes[0]), plain)
    return _values(graph, raw, "Identity", plain.name, elements, range(sizes[-1]))


def _values(
    graph: OnnxGraph, raw: str, last: str, name: str, elements: Any, moves: Sequence[Any]
) -> Exported:
    """End a graph with the values of moves, and the move with the max value."""
    graph.add(last, raw, name=graph.end("outputs", "values", len(moves)))
    graph.choose(raw, "move")
    outputs = {"values": [{"name": str(one)} for one in moves], "move": "index of the max value"}
    return graph, described(name, None, {"observation": elements}, outputs)


def _regrets(network: RegretNetwork) -> Exported:
    graph = OnnxGraph()
    x = graph.end("inputs", "observation", network.layers.sizes[0])
    x = graph.standardize(x, network.mean, network.scale, np.inf)
    raw, elements = graph.layers(x, network.layers, "Relu"), network.identity.elements
    last = "Relu" if network.clipped else "Identity"
    named = [{"name": one} for one in elements]
    return _values(graph, raw, last, network.name, named, network.moves)


FORMATS: dict[ArtifactFormat, Callable[[Path], Exported]] = {
    PLANNER_FORMAT: trained_graph,
    LIDAR_FORMAT: lidar_graph,
    LINE_FORMAT: line_graph,
    NETWORK_FORMAT: lambda folder: _regrets(load_network(folder)),
}
