"""Agents that are brought to the benchmark: a zoo name, a function, a file of Stable-Baselines3, a driver's folder.

``PPO.load`` unpickles parts of a file, so that it runs code from it. Here the weights are read by torch with
``weights_only=True``, and the activation function from the text of the settings.
"""

import importlib
import io
import json
import re
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.planners.trained import load_driver
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.jobs.fingerprint import fingerprint


def load_entrant(
    text: str, setting: Setting, *, drive: bool = False, weights: Path | None = None, name: str | None = None
) -> Competitor:
    """Return the competitor that a text names.

    Parameters
    ----------
    text : str
        One of these: a name of the zoo, with options if it has any; ``module:function``, a function of the setting (and
        of the path of the weights, if there is one) that returns a competitor; the path of a ``.zip`` file of
        Stable-Baselines3, of which only numbers are read; with ``drive``, the folder of a driver at control level. A
        module is looked for in the working directory as well.
    drive : bool
        Whether the text is the name or the folder of a driver (:func:`pcs_racing.planners.trained.load_driver`).
    weights : path, optional
        File that is handed to the function.
    name : str, optional
        Name on the card, in place of its own.
    """
    module, separator, function = text.partition(":")
    if drive:
        planner = load_driver(Path(text) if Path(text).is_dir() else text)
        return as_competitor(planner.policy({}), name or planner.name)
    if text.endswith(".zip"):
        return as_competitor(load_sb3_policy(Path(text)), name or Path(text).stem)
    here = str(Path.cwd())
    if here not in sys.path:
        # As with "python -m", but at the end, so that a file here hides no installed package.
        sys.path.append(here)
    # "name:option=value" is an agent of the zoo; a module is only what can be found.
    if weights is not None or (separator and "=" not in function and _is_module(module)):
        return as_competitor(_call(module, function, setting, weights), name or function)
    return as_competitor(parse_agent(text, setting), name)


def _is_module(name: str) -> bool:
    try:
        return name.replace(".", "").isidentifier() and importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False


def _call(module: str, function: str, setting: Setting, weights: Path | None) -> Any:
    """Return what the function of a module makes."""
    if weights is not None and not weights.is_file():
        raise InputError(f"there is no file of weights {weights}")
    try:
        build = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"can't find {module}:{function} ({error}); give module:function, where the module can be imported"
        ) from None
    return build(setting) if weights is None else build(setting, weights)


Floats = NDArray[np.float64]

MAX_BYTES = 50_000_000
ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {"Tanh": np.tanh, "ReLU": lambda values: np.maximum(values, 0.0)}
LAYER = re.compile(r"mlp_extractor\.policy_net\.(\d+)\.weight")


@dataclass(frozen=True, eq=False)
class Sb3Policy:
    """The actor of a trained policy: fully connected layers from an observation to the logits of the moves."""

    name: str
    weights: tuple[Floats, ...]  #: shape (outputs, inputs)
    biases: tuple[Floats, ...]  #: shape (outputs,)
    activation: str  #: ``"Tanh"`` or ``"ReLU"``.

    @property
    def content_hash(self) -> str:
        """SHA-256 of the layers."""
        return fingerprint(list(self.weights), list(self.biases), self.activation)

    def predict(
        self, observation: NDArray[np.float32], state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.int64], None]:
        """Return the most probable move for each observation, whatever ``deterministic`` says."""
        if observation.shape[-1] != self.weights[0].shape[1]:
            raise InputError(
                f"policy {self.name!r} takes observations of {self.weights[0].shape[1]} numbers; here they have "
                f"{observation.shape[-1]}"
            )
        values: Floats = np.asarray(observation, np.float64)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = ACTIVATIONS[self.activation](values @ weight.T + bias)
        return np.argmax(values @ self.weights[-1].T + self.biases[-1], axis=-1), None


def load_sb3_policy(path: Path) -> Sb3Policy:
    """Read a policy that ``model.save(path)`` wrote, of PPO, A2C or MaskablePPO with an ``MlpPolicy``."""
    require("torch", extra="learning")
    import torch

    try:
        with zipfile.ZipFile(path) as file:
            # Sizes as the archive states them: reading stops there, so a small file can't unpack to a huge one.
            if sum(entry.file_size for entry in file.infolist()) > MAX_BYTES:
                raise InputError(
                    f"{path} holds more than {MAX_BYTES} bytes; that is no policy of fully connected layers"
                )
            settings = json.loads(file.read("data"))
            state = torch.load(io.BytesIO(file.read("policy.pth")), map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except (OSError, KeyError, ValueError, zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"{path} is no file of Stable-Baselines3: {str(error)[:200]}") from None
    return _policy(path, state, str(settings.get("policy_kwargs", "")))


def _policy(path: Path, state: dict[str, Any], settings: str) -> Sb3Policy:
    numbers = sorted(int(match.group(1)) for match in map(LAYER.fullmatch, state) if match)
    layers = [*(f"mlp_extractor.policy_net.{number}" for number in numbers), "action_net"]
    if not numbers or f"{layers[-1]}.weight" not in state or any("lstm" in name or "cnn" in name for name in state):
        raise InputError(
            f"{path} has no actor of fully connected layers; train PPO, A2C or MaskablePPO with MlpPolicy, or write a "
            "function that makes your agent (module:function)"
        )
    # The settings hold the class by its name in a text; unpickling it would run code from the file.
    found = re.search(r"torch\.nn\.modules\.activation\.(\w+)", settings)
    activation = found.group(1) if found else "Tanh"  # the default of MlpPolicy
    if activation not in ACTIVATIONS:
        raise InputError(f"{path}: the activation is {activation}; it must be one of {', '.join(ACTIVATIONS)}")
    weights, biases = (
        tuple(state[f"{layer}.{kind}"].numpy().astype(np.float64) for layer in layers) for kind in ("weight", "bias")
    )
    if not all(np.isfinite(values).all() for values in (*weights, *biases)):
        raise InputError(f"{path}: a weight is not finite")
    return Sb3Policy(path.stem, weights, biases, activation)
