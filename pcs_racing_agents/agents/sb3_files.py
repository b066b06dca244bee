"""Stable-Baselines3 policies as plain layers, from a file or a model; no code of a file runs.

A control policy has the arguments of its environment in a file next to the zip (:func:`save_model`,
:func:`load_model`).

``PPO.load`` unpickles parts of a file and so runs code from it. Here torch reads the weights with
``weights_only=True``, and the activation function comes from the text of the settings.
"""

import hashlib
import io
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.compilation import kernel
from pcs_racing.base.dense import DenseLayers, dense_forward, weight_count
from pcs_racing.base.elementary import hyperbolic_tangent
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.files import MAX_YAML, parse_json, parse_yaml, read_limited, write_atomically
from pcs_racing.envs.models import KEPT, kept_arguments, model_policy
from pcs_racing.planners.planner import Policy

MAX_BYTES = 50_000_000
ACTIVATIONS = ("Tanh", "ReLU")
# Hidden layers, last layer, default activation, final tanh: PPO and A2C; SAC; TD3 and DDPG.
_ACTORS = (
    ("mlp_extractor.policy_net", "action_net", "Tanh", False),
    ("actor.latent_pi", "actor.mu", "ReLU", True),
    ("actor.mu", "", "ReLU", True),
)


@kernel
def _actor_rows(rows, flat, sizes, at, tanh, squash, scratch, out):
    """Pass each row through the layers; the last layer begins at ``flat[at]``.

    The result of a row depends on this row alone.
    """
    layers = len(sizes) - 1
    for r in range(len(rows)):
        for i in range(sizes[0]):
            scratch[0, i] = rows[r, i]
        x, y = scratch[0], scratch[1]
        if tanh and layers > 1:
            dense_forward(flat, sizes[:-1], x, y, True)
            if layers % 2 == 0:
                x, y = scratch[1], scratch[0]
            dense_forward(flat[at:], sizes[-2:], x, y, False)
        else:
            dense_forward(flat, sizes, x, y, False)
        for j in range(out.shape[1]):
            value = scratch[layers % 2, j]
            out[r, j] = hyperbolic_tangent(value) if squash else value


class ObservationScale(NamedTuple):
    """Scale of observations by ``VecNormalize`` at the end of a training."""

    mean: NDArray[np.float64]  #: shape (D,): Mean of the observations.
    spread: NDArray[np.float64]  #: shape (D,): Standard deviation, the unit of scaled observations.
    clip: float  #: Max absolute value of scaled observations, in these units.

    def __call__(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return scaled observations, the input of the model, shape (..., D)."""
        return np.clip((rows - self.mean) / self.spread, -self.clip, self.clip).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Sb3Policy:
    """The actor of a trained policy: fully connected layers from observations to actions.

    Actions are moves, or steering and speed.
    """

    name: str
    layers: DenseLayers
    activation: str  #: Activation function, one of :data:`ACTIVATIONS`.
    moves: bool  #: True if the outputs are the logits of moves.
    squash: bool = False  #: True if a tanh follows the last layer.
    scale: ObservationScale | None = None  #: Scale of the observations, if any.

    @property
    def content_hash(self) -> str:
        """SHA-256 of the layers and the scale."""
        about = f"{self.layers.sizes} {self.activation} {self.moves} {self.squash}".encode()
        scale = b"".join(np.asarray(values).tobytes() for values in self.scale or ())
        return hashlib.sha256(about + self._flat.tobytes() + scale).hexdigest()

    @cached_property
    def observation_space(self) -> spaces.Box:
        """Space of the observations; their bounds are not known."""
        return spaces.Box(-np.inf, np.inf, (self.layers.sizes[0],))

    @cached_property
    def _flat(self) -> NDArray[np.float32]:
        return self.layers.flat()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], None]:
        """Return the most probable action for each observation; ignore ``deterministic``."""
        rows, sizes = np.asarray(observation, np.float32), np.array(self.layers.sizes)
        if rows.shape[-1] != sizes[0]:
            raise InputError(
                f"policy {self.name!r} takes observations of {sizes[0]} numbers; here they have"
                f" {rows.shape[-1]}"
            )
        rows = rows if self.scale is None else self.scale(rows)
        flat_rows = np.ascontiguousarray(rows.reshape(-1, sizes[0]))
        out = np.empty((len(flat_rows), sizes[-1]), np.float32)
        scratch, last = np.empty((2, sizes.max()), np.float32), weight_count(self.layers.sizes[:-1])
        _actor_rows(
            flat_rows, self._flat, sizes, last, self.activation == "Tanh", self.squash, scratch, out
        )
        out = out.reshape(*rows.shape[:-1], -1)
        return (np.argmax(out, axis=-1) if self.moves else out), None


def load_sb3_policy(path: Path) -> Sb3Policy:
    """Read a policy from a file written by ``model.save(path)``.

    The model is PPO, A2C, MaskablePPO, SAC, TD3 or DDPG with an MlpPolicy.
    """
    # The file is read before the import of torch, which takes seconds.
    content = read_limited(path, MAX_BYTES, "a policy", InputError)
    require("torch", extra="learning")
    import torch

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            # Reading stops at the sizes stated in the zip: a small file can't unpack to a huge one.
            if sum(entry.file_size for entry in file.infolist()) > MAX_BYTES:
                raise InputError(
                    f"{path} holds more than {MAX_BYTES} bytes; that is no policy of fully"
                    " connected layers"
                )
            settings = parse_json(path, file.read("data"))
            state = torch.load(
                io.BytesIO(file.read("policy.pth")), map_location="cpu", weights_only=True
            )
        if not isinstance(settings, dict) or not isinstance(state, dict):
            raise InputError("its settings and its weights must be mappings")
    # A damaged zip, damaged compression and damaged torch data raise a dozen types of errors.
    except Exception as error:
        said = str(error).partition("\n")[0]
        raise InputError(f"{path} is no file of Stable-Baselines3: {said:.200}") from None
    # The settings hold the names of classes in texts; unpickling would run code from the file.
    words = str(settings.get("policy_kwargs", ""))
    found = re.search(r"torch\.nn\.modules\.activation\.(\w+)", words)
    if "features_extractor_class" in words:
        raise InputError(
            f"{path} has a feature extractor of its own, which is code; give the model itself"
            " instead"
        )
    return actor_of(str(path), state, found.group(1) if found else None)


def actor_of(name: str, state: Mapping[str, Any], activation: str | None) -> Sb3Policy:
    """Return the actor of a policy's tensors; activation None is the algorithm's default."""
    layers: list[str] = []
    for before, end, usual, squash in _ACTORS:  # noqa: B007
        found = [re.fullmatch(rf"{re.escape(before)}\.(\d+)\.weight", key) for key in state]
        numbers = sorted(int(match.group(1)) for match in found if match)
        layers = [*(f"{before}.{number}" for number in numbers), *([end] if end else [])]
        if numbers and f"{layers[-1]}.weight" in state:
            break
        layers = []
    if not layers or any(
        part in key for key in state for part in ("lstm", "cnn", "features_extractor.")
    ):
        raise InputError(
            f"{name} has no actor of fully connected layers; train PPO, A2C, MaskablePPO, SAC or"
            " TD3 with MlpPolicy, or give the model itself"
        )
    activation = activation or usual
    if activation not in ACTIVATIONS:
        raise InputError(
            f"{name}: the activation is {activation}; it must be one of {', '.join(ACTIVATIONS)}"
        )
    try:
        parts = [
            tuple(state[f"{layer}.{kind}"].cpu().numpy() for layer in layers)
            for kind in ("weight", "bias")
        ]
    except (AttributeError, KeyError) as error:
        raise InputError(f"{name}: a layer has no weights or biases: {error}") from None
    if not all(np.isfinite(values).all() for part in parts for values in part):
        raise InputError(f"{name}: a weight is not finite")
    return Sb3Policy(
        Path(name).stem,
        DenseLayers(*parts),
        activation,
        not squash and "log_std" not in state,
        squash,
    )


def plain_model(model: Any, name: str) -> Any:
    """Return a Stable-Baselines3 model as layers, which can be sent to other processes.

    Any other model is returned unchanged.
    """
    state = getattr(getattr(model, "policy", None), "state_dict", None)
    if callable(state) and "features_extractor_class" not in getattr(model, "policy_kwargs", ()):
        activation = getattr(getattr(model.policy, "activation_fn", None), "__name__", None)
        with suppress(InputError):
            return replace(actor_of(name, state(), activation), scale=_scale_of(model.get_env()))
    return model


def frozen_model(model: Any, name: str) -> tuple[Sb3Policy, dict[str, Any]]:
    """Return a copy of a model's policy as layers, and the arguments of its environment by name.

    The scale of observations is rounded to float32, as in a file.
    """
    if not callable(getattr(model, "get_env", None)):
        raise InputError(f"a {type(model).__name__} is no model of Stable-Baselines3")
    env, frozen = model.get_env(), plain_model(model, name)
    if not isinstance(frozen, Sb3Policy):
        raise InputError(
            f"{type(model).__name__} has no actor of fully connected layers; train PPO, A2C, SAC or"
            " TD3 with MlpPolicy"
        )
    scale = frozen.scale
    if scale is not None:
        mean, spread = (np.asarray(one, np.float32).astype(np.float64) for one in scale[:2])
        scale = ObservationScale(mean, spread, scale.clip)
    return replace(frozen, scale=scale), kept_arguments(env, _scaler(env))


def _scaler(env: Any) -> Any:
    """Return the ``VecNormalize`` around environments, if it changes their observations."""
    while env is not None and type(env).__name__ != "VecNormalize":
        env = vars(env).get("venv")
    return env if env is not None and env.norm_obs else None


def _scale_of(env: Any) -> ObservationScale | None:
    scaler = _scaler(env)
    if scaler is None:
        return None
    seen = scaler.obs_rms
    return ObservationScale(seen.mean, np.sqrt(seen.var + scaler.epsilon), float(scaler.clip_obs))


def _read_scale(file: Path, given: Any, size: int) -> ObservationScale:
    """Return the scale in a file, for observations of ``size`` numbers."""
    try:
        mean, spread, clip = (np.array(given[key], np.float64) for key in ObservationScale._fields)
    except (KeyError, IndexError, TypeError, ValueError):
        mean = spread = clip = np.empty(0)
    right = mean.shape == spread.shape == (size,) and clip.shape == () and clip > 0.0
    if not right or not (np.abs(mean) < 1e9).all() or not ((spread > 1e-9) & (spread < 1e9)).all():
        raise InputError(
            f"{file}: scale must hold mean and spread, {size} numbers each below 1e9, spreads above"
            " 1e-9, and a clip above 0"
        )
    return ObservationScale(mean, spread, float(clip))


def save_model(path: str | Path, model: Any, env: Any = None) -> Path:
    """Save a Stable-Baselines3 model as zip, and the arguments of its environment as ``.yaml``.

    The ``.yaml`` file is next to the zip. It includes the scale of a ``VecNormalize`` around the
    environment; other wrappers that change observations or actions are refused.

    Parameters
    ----------
    path : str or Path
        Path of the zip.
    model : BaseAlgorithm
    env : Env, VecEnv or VectorEnv, optional
        Environment of the training; by default the environment of the model.
    """
    target = Path(path).with_suffix(".zip")
    env = model.get_env() if env is None else env
    scaler, scale = _scaler(env), _scale_of(env)
    arguments = kept_arguments(env, scaler)
    if scale is not None:
        arguments["scale"] = {
            key: np.asarray(values).tolist() for key, values in scale._asdict().items()
        }
    text = yaml.safe_dump(arguments, sort_keys=False).encode()
    model.save(target)
    write_atomically(target.with_suffix(".yaml"), text)
    return target


def load_model(path: str | Path) -> Policy:
    """Return the policy in a zip written by :func:`save_model`."""
    file = Path(path).with_suffix(".yaml")
    if Path(path).is_file() and not file.is_file():
        raise InputError(
            f"there is no file {file} with the arguments of the model's environment;"
            " save_model(path, model) writes it"
        )
    model = load_sb3_policy(Path(path))
    arguments = parse_yaml(
        file, read_limited(file, MAX_YAML, "the arguments of a model", InputError)
    )
    if not isinstance(arguments, dict):
        raise InputError(
            f"{file} holds {arguments!r:.80}; it must hold the arguments of an environment by name"
        )
    for key in arguments:
        if key not in (*KEPT, "cars", "vehicle", "scale"):
            raise InputError(
                f"{file}: the argument {key!r} is unknown; there are cars, vehicle, scale,"
                f" {', '.join(KEPT)}"
            )
    if "scale" in arguments:
        model = replace(
            model, scale=_read_scale(file, arguments.pop("scale"), model.layers.sizes[0])
        )
    return model_policy(model, name=str(path), **arguments)
