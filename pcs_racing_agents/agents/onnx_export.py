"""ONNX files of policies, planners' networks and agents' networks, for programs without ours."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.envs.drive_options import drive_elements
from pcs_racing.envs.models import ModelDriver
from pcs_racing.planners.field.lidar_ppo import LIDAR_FORMAT
from pcs_racing.planners.learned import folder_format, is_planner_folder
from pcs_racing.planners.line_ppo import LINE_FORMAT
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing_agents.agents.onnx_planners import (
    COMMAND,
    lidar_graph,
    line_graph,
)
from pcs_racing_agents.agents.sb3_files import (
    Sb3Policy,
    frozen_model,
    read_zip,
)
from pcs_racing_agents.base.onnx_graph import OnnxGraph, Value
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network


def export_onnx(model: Any, path: str | PathLike[str]) -> Path:
    """Write the network of a policy, a planner or an agent as an ONNX file, and return its path.

    The command of a policy or planner is a steering angle (rad) and a speed (m/s); planners drive
    the F1TENTH car. The file of ``line-ppo`` chooses a candidate of its lattice, and an agent
    makes a move.

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
    return _exported(model).write(Path(path))


def _exported(model: Any) -> OnnxGraph:
    if isinstance(model, RegretNetwork):
        return _regrets(model)
    if isinstance(model, Policy):
        driver: Any = model.planner.drive
        return _control(driver) if isinstance(driver, ModelDriver) else _named(model.planner.name)
    if isinstance(model, str | PathLike):
        return _model_file(Path(model)) if Path(model).suffix == ".zip" else _named(str(model))
    plain = _plain(model, type(model).__name__)
    if plain.moves:
        elements: Any = ()
        with suppress(AttributeError):  # a model without environment, or of another one
            (elements,) = model.get_env().get_attr("elements", [0])
        return _moves(plain, elements)
    return _exported(policy_racer(model))


def _plain(model: Any, name: str) -> Sb3Policy:
    return model if isinstance(model, Sb3Policy) else frozen_model(model, name)


def _model_file(file: Path) -> OnnxGraph:
    plain, _ = read_zip(file)
    return _moves(plain, []) if plain.moves else _exported(policy_racer(file))


def _named(name: str) -> OnnxGraph:
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


def _actor(graph: OnnxGraph, x: Value, plain: Sb3Policy) -> Value:
    hidden = {"Tanh": "Tanh", "ReLU": "Relu"}[plain.activation]
    x = x if plain.scale is None else graph.standardize(x, *plain.scale)
    return graph.layers(x, plain.layers, hidden, "Tanh" if plain.squash else "Identity")


def _control(driver: ModelDriver) -> OnnxGraph:
    """Export a model of `Drive`; the observation is clipped and scaled as in the environment."""
    plain, options = _plain(driver.model, driver.name), driver.options
    elements = drive_elements(options, driver.cars)
    low, high = np.array([(one.low, one.high) for one in elements]).T
    graph = OnnxGraph(driver.name, options.time_step)
    about = [one._asdict() for one in elements]
    x = graph.input("observation", len(elements), about=about).clip(low, high)
    if options.normalize:
        x = x * (2.0 / (high - low)) - (high + low) / (high - low)
    x = _actor(graph, x, plain)
    turn, slow, fast = options.limits
    unit, middle = np.array([turn, 0.5 * (fast - slow)]), np.array([0.0, 0.5 * (fast + slow)])
    if not (options.normalized or plain.squash):
        x = (x - middle) / unit
    graph.output("command", x.clip(-1.0, 1.0) * unit + middle, 2, about=COMMAND)
    return graph


def _moves(plain: Sb3Policy, elements: Sequence[Any]) -> OnnxGraph:
    graph = OnnxGraph(plain.name, None)
    sizes, about = plain.layers.sizes, [one._asdict() for one in elements]
    raw = _actor(graph, graph.input("observation", sizes[0], about=about), plain)
    graph.output("values", raw, sizes[-1], about="logit of each move")
    graph.choose("move", raw)
    return graph


def _regrets(network: RegretNetwork) -> OnnxGraph:
    graph = OnnxGraph(network.name, None)
    elements, moves = ([{"name": one} for one in part] for part in network.identity[:2])
    x = graph.input("observation", len(elements), about=elements)
    x = graph.standardize(x, network.mean, network.scale, np.inf)
    raw = graph.layers(x, network.layers, "Relu")
    values = graph.add("Relu", raw) if network.clipped else raw
    graph.output("values", values, len(moves), about=moves)
    graph.choose("move", raw)
    return graph


FORMATS: dict[ArtifactFormat, Callable[[Path], OnnxGraph]] = {
    LIDAR_FORMAT: lidar_graph,
    LINE_FORMAT: line_graph,
    NETWORK_FORMAT: lambda folder: _regrets(load_network(folder)),
}
