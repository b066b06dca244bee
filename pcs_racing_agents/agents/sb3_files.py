"""Stable-Baselines3 policies as plain layers, from a file or a model; no code of a file runs.

``PPO.load`` unpickles parts of a file and so runs code from it. Here torch reads the weights with
``weights_only=True``; the classes, the activation function and the environment of the training come
from readable texts that Stable-Baselines3 writes next to its pickles.
"""

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.files import parse_json, read_limited, write_atomically
from pcs_racing.envs.models import line_policy, model_policy, needs_like, origin_of
from pcs_racing.envs.origins import ATTRIBUTE, read_origin
from pcs_racing.game.players import model_agent
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import Racer, Reader, Request, own_name

MAX_BYTES = 50_000_000
ACTIVATIONS = ("Tanh", "ReLU")
CANDIDATES = "pcs_racing_agents.learning.candidates"
"""Module of the policy classes that score the candidates of `Line`."""
_TORCH = "torch.nn.modules.activation"
_FLATTEN = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"
SCALE_FILE = "pcs_racing_scale.json"
"""Name in a zip of the scale of observations (:func:`save_model`)."""


class Actor(NamedTuple):
    """Place of the actor in a class of policies."""

    hidden: str  #: Name of the hidden layers in the state.
    last: str  #: Name of the last layer; empty if it is one of the hidden layers.
    activation: str  #: Default activation function.
    squash: bool  #: True if a tanh follows the last layer.


_PPO = Actor("mlp_extractor.policy_net", "action_net", "Tanh", False)
ACTORS = {
    "stable_baselines3.common.policies": _PPO,
    "sb3_contrib.common.maskable.policies": _PPO,
    "stable_baselines3.dqn.policies": Actor("q_net.q_net", "", "ReLU", False),
    "stable_baselines3.sac.policies": Actor("actor.latent_pi", "actor.mu", "ReLU", True),
    "stable_baselines3.td3.policies": Actor("actor.mu", "", "ReLU", True),
}
"""Actors of fully connected layers by the module of the policy's class."""


class PolicyTraits(NamedTuple):
    """Traits of a policy that decide which function its tensors are."""

    module: str  #: Module of the policy's class.
    activation: str | None  #: Name of the activation class; None for the default.
    extractor: bool  #: True if it has a feature extractor of its own.
    noise_by_state: bool  #: True for ``use_sde``.
    squash: bool  #: True for ``squash_output``.


class _ObservationScale(NamedTuple):
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
    scale: _ObservationScale | None = None  #: Scale of the observations, if any.

    @property
    def content_hash(self) -> str:
        """SHA-256 of the layers and the scale."""
        about = f"{self.layers.sizes} {self.activation} {self.moves} {self.squash}".encode()
        scale = b"".join(np.asarray(values).tobytes() for values in self.scale or ())
        return hashlib.sha256(about + self.layers.flat().tobytes() + scale).hexdigest()

    @cached_property
    def observation_space(self) -> spaces.Box:
        """Space of the observations; their bounds are not known."""
        return spaces.Box(-np.inf, np.inf, (self.layers.sizes[0],))

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], None]:
        """Return the most probable action for each observation; ignore ``deterministic``."""
        rows, size = np.asarray(observation, np.float32), self.layers.sizes[0]
        if rows.shape[-1] != size:
            raise InputError(
                f"policy {self.name!r} takes observations of {size} numbers; here they have"
                f" {rows.shape[-1]}"
            )
        rows = rows if self.scale is None else self.scale(rows)
        out = self.layers.forward(rows, tanh=self.activation == "Tanh", squash=self.squash)
        return (np.argmax(out, axis=-1) if self.moves else out), None


def read_zip(path: Path) -> tuple[Sb3Policy | Policy, dict[str, Any] | None]:
    """Return the policy in a file written by ``model.save(path)``, and its training's environment.

    The model is PPO, A2C, DQN, MaskablePPO, SAC, TD3 or DDPG with an MlpPolicy. The environment is
    None if its spaces do not name it. A model with a CandidatePolicy is a policy of a planner.
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
            scaled = SCALE_FILE in file.namelist()
            scale = parse_json(path, file.read(SCALE_FILE)) if scaled else None
            state = torch.load(
                io.BytesIO(file.read("policy.pth")), map_location="cpu", weights_only=True
            )
        if not isinstance(settings, dict) or not isinstance(state, dict):
            raise InputError("its settings and its weights must be mappings")
    # A damaged zip, damaged compression and damaged torch data raise a dozen types of errors.
    except Exception as error:
        said = str(error).partition("\n")[0]
        raise InputError(f"{path} is no file of Stable-Baselines3: {said:.200}") from None
    space = settings.get("observation_space")
    text = space.get(ATTRIBUTE) if isinstance(space, dict) else None
    origin = read_origin(text, str(path)) if isinstance(text, str) else None
    traits = _written_traits(settings)
    if traits.module == CANDIDATES:
        names = {key: key.removeprefix(f"{_PPO.last}.") for key in state}
        tensors = {names[key]: state[key].cpu().numpy() for key in state if names[key] != key}
        tensors.pop("temper", None)
        return line_policy(str(path), tensors, origin or {}), origin
    policy = actor_of(str(path), state, traits)
    if scaled:
        policy = replace(policy, scale=_read_scale(path, scale, policy.layers.sizes[0]))
    elif _normalizers(path):
        raise InputError(
            f"{path} lies near {_normalizers(path)[0].name}, a VecNormalize, which the zip does not"
            " hold: train with normalize=True, or write the zip with save_model"
        )
    return policy, origin


def _normalizers(path: Path) -> list[Path]:
    """Return the files of a VecNormalize in the folder of a zip."""
    return [file for file in path.parent.glob("*.pkl") if "normalize" in file.name.lower()]


def _written_traits(settings: Mapping[str, Any]) -> PolicyTraits:
    """Return the traits of a policy from the readable texts of a file."""
    written = settings.get("policy_class")
    module = str(written.get("__module__", "")) if isinstance(written, dict) else ""
    return _traits(module, settings.get("policy_kwargs"), settings.get("use_sde"))


def _traits(module: str, kwargs: Any, noise_by_state: Any) -> PolicyTraits:
    """Return the traits of a policy, from its arguments or their texts in a file."""
    kwargs = kwargs if isinstance(kwargs, dict) else {}
    written, extractor = (
        str(kwargs.get(key, "")) for key in ("activation_fn", "features_extractor_class")
    )
    found = re.search(r"'([\w.]+)'", written)
    activation = (found.group(1) if found else written).removeprefix(f"{_TORCH}.")
    return PolicyTraits(
        module,
        activation or None,
        extractor not in ("", _FLATTEN),
        noise_by_state is True,
        kwargs.get("squash_output") is True,
    )


def actor_of(name: str, state: Mapping[str, Any], traits: PolicyTraits) -> Sb3Policy:
    """Return the actor of a policy's tensors; a policy of another shape is refused by its cause."""
    if "recurrent" in traits.module or any("lstm" in key for key in state):
        raise InputError(f"{name} has an LSTM, which keeps a state; give the model itself")
    if traits.module == CANDIDATES:
        raise InputError(
            f"{name} scores the lattice's candidates: it races as it is, the zip of model.save has"
            " all of it, and no ONNX file would lay the candidates"
        )
    actor = ACTORS.get(traits.module)
    if actor is None:
        known = "PPO, A2C, DQN, MaskablePPO, SAC, TD3 or DDPG with MlpPolicy"
        raise InputError(
            f"{name} has a policy class of {traits.module or 'an unknown module'}; it must be"
            f" {known}, or give the model itself"
        )
    if traits.extractor or any("features_extractor." in key for key in state):
        raise InputError(f"{name} has a feature extractor of its own; give the model itself")
    if actor.squash and traits.noise_by_state:
        raise InputError(f"{name} was trained with use_sde, which clips its mean; train without it")
    activation = traits.activation or actor.activation
    if activation not in ACTIVATIONS:
        raise InputError(
            f"{name}: the activation is {activation}; it must be one of {', '.join(ACTIVATIONS)}"
        )
    found = [re.fullmatch(rf"{re.escape(actor.hidden)}\.(\d+)\.weight", key) for key in state]
    numbers = sorted(int(match.group(1)) for match in found if match)
    names = [*(f"{actor.hidden}.{number}" for number in numbers), *filter(None, [actor.last])]
    try:
        parts = [
            tuple(state[f"{layer}.{kind}"].cpu().numpy() for layer in names)
            for kind in ("weight", "bias")
        ]
    except (AttributeError, KeyError) as error:
        raise InputError(f"{name}: a layer has no weights or biases: {error}") from None
    if not names:
        raise InputError(f"{name} has no layers {actor.hidden}")
    dense = DenseLayers(*parts)  # refuses NaN and shapes that do not fit
    moves = not actor.squash and "log_std" not in state
    squash = actor.squash or traits.squash
    return Sb3Policy(Path(name).stem, dense, activation, moves, squash)


def is_sb3(model: Any) -> bool:
    """Return whether an object is a model of Stable-Baselines3 or sb3-contrib."""
    state = getattr(getattr(model, "policy", None), "state_dict", None)
    return callable(state) and callable(getattr(model, "get_env", None))


def frozen_model(model: Any, name: str) -> Sb3Policy:
    """Return a copy of a model's policy as layers, equal to the model's ``predict``."""
    if not is_sb3(model):
        raise InputError(f"a {type(model).__name__} is no model of Stable-Baselines3")
    env = model.get_env()
    traits = _traits(
        type(model.policy).__module__,
        getattr(model, "policy_kwargs", None),
        getattr(model, "use_sde", False),
    )
    frozen = replace(actor_of(name, model.policy.state_dict(), traits), scale=_scale_of(env))
    _compare(model, frozen, name)
    return frozen


def training_origin(model: Any, name: str, like: Any = None) -> Mapping[str, Any] | None:
    """Return the origin of a model, behind no wrapper that its zip would lose."""
    return origin_of(model, name, like, kept=scaler_of(model.get_env()))


def _compare(model: Any, frozen: Sb3Policy, name: str) -> None:
    """Refuse layers that answer drawn observations in another way than the model's ``predict``."""
    space = model.observation_space
    low, high = np.clip(space.low, -10.0, 10.0), np.clip(space.high, -10.0, 10.0)
    seen = np.random.default_rng(0).uniform(low, high, (64, len(low))).astype(np.float32)
    wanted, _ = model.predict(seen, deterministic=True)
    unscaled = frozen if frozen.scale is None else replace(frozen, scale=None)
    own, _ = unscaled.predict(seen)
    if not frozen.moves:
        bounds = model.action_space
        own = np.clip(own, -1.0, 1.0) if frozen.squash else np.clip(own, bounds.low, bounds.high)
        if frozen.squash:
            own = bounds.low + 0.5 * (bounds.high - bounds.low) * (own + 1.0)
    same = np.mean(own == wanted) > 0.9 if frozen.moves else np.allclose(own, wanted, atol=1e-4)
    if not same:
        raise InputError(
            f"{name} answers in another way than its layers, so its policy has more parts than"
            " fully connected layers; give the model itself"
        )


def read_sb3(request: Request) -> Racer | None:
    """Return the racer of a zip of Stable-Baselines3, or of its model in memory."""
    given, text = request.given, request.text
    if text.endswith(".zip"):
        policy, written = read_zip(Path(text))
        origin = written or origin_of(policy, text, request.like)
        if origin is None:
            raise needs_like(text)
        return _racer(policy, text, origin, request)
    if text or not is_sb3(given):
        return None
    name = own_name(given)
    origin = training_origin(given, name, request.like)
    try:
        policy = frozen_model(given, name)
    except InputError:
        return None  # the model itself drives
    usual = {"environment": "duel" if policy.moves else "drive"}
    return _racer(policy, name, origin or usual, request)


def _racer(
    policy: Sb3Policy | Policy, name: str, origin: Mapping[str, Any], request: Request
) -> Racer:
    if isinstance(policy, Policy):
        return policy
    if origin["environment"] == "line":
        return line_policy(name, {}, origin)
    environment, wanted = origin["environment"], "duel" if policy.moves else "drive"
    if environment != wanted:
        actions = "moves" if policy.moves else "steering and speed"
        raise InputError(f"{name} has actions of {actions}; it was not trained in {environment}")
    if policy.moves:
        return model_agent(policy, name, origin.get("game"), request.asked_game)
    return model_policy(policy, name=name, **origin)


SB3 = Reader(read_sb3)


def scaler_of(env: Any) -> Any:
    """Return the ``VecNormalize`` around environments, if it changes their observations."""
    while env is not None and type(env).__name__ != "VecNormalize":
        env = vars(env).get("venv")
    return env if env is not None and env.norm_obs else None


def _scale_of(env: Any) -> _ObservationScale | None:
    scaler = scaler_of(env)
    if scaler is None:
        return None
    seen = scaler.obs_rms
    mean, spread = seen.mean, np.sqrt(seen.var + scaler.epsilon)
    # Rounded to float32, as in a file of weights.
    mean, spread = (np.asarray(one, np.float32).astype(np.float64) for one in (mean, spread))
    return _ObservationScale(mean, spread, float(scaler.clip_obs))


def _read_scale(file: Path, given: Any, size: int) -> _ObservationScale:
    """Return the scale in a file, for observations of ``size`` numbers."""
    try:
        mean, spread, clip = (np.array(given[key], np.float64) for key in _ObservationScale._fields)
    except (KeyError, IndexError, TypeError, ValueError):
        mean = spread = clip = np.empty(0)
    right = mean.shape == spread.shape == (size,) and clip.shape == () and clip > 0.0
    if not right or not (np.abs(mean) < 1e9).all() or not ((spread > 1e-9) & (spread < 1e9)).all():
        raise InputError(
            f"{file}: scale must hold mean and spread, {size} numbers each below 1e9, spreads above"
            " 1e-9, and a clip above 0"
        )
    return _ObservationScale(mean, spread, float(clip))


def save_model(path: str | Path, model: Any) -> Path:
    """Save a Stable-Baselines3 model as a zip that races, also behind a ``VecNormalize``.

    The zip of ``model.save`` races without this function, but holds no scale of observations. This
    zip holds the scale, too; its actor answers as ``model.predict``. Other wrappers that change
    observations or actions are refused.

    Parameters
    ----------
    path : str or Path
        Path of the zip.
    model : BaseAlgorithm
    """
    target = Path(path).with_suffix(".zip")
    # Both refuse wrappers that the model would lose.
    if type(getattr(model, "policy", None)).__module__ == CANDIDATES:
        origin_of(model, target.stem)
        kept = None
    else:
        kept = frozen_model(model, target.stem).scale
        training_origin(model, target.stem)
    content = io.BytesIO()
    model.save(content)
    if kept is not None:
        scale = {key: np.asarray(one).tolist() for key, one in kept._asdict().items()}
        with zipfile.ZipFile(content, "a") as file:
            file.writestr(SCALE_FILE, json.dumps(scale))
    write_atomically(target, content.getvalue())
    return target
