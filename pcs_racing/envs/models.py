"""Models trained in `Drive` or `drive_head_to_head` as policies for any race.

A model needs the observation of its training, so the arguments of its environment are saved with
it. One call of a model serves all its due cars in a batch of races.
"""

import hashlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, check_whole
from pcs_racing.base.files import parse_yaml
from pcs_racing.envs.drive_kernel import (
    Inputs,
    Races,
    Sight,
    eyes_for,
    make_buffers,
    observe_races,
)
from pcs_racing.envs.drive_options import (
    KEPT,
    DriveOptions,
    drive_arguments,
    drive_elements,
    make_sight,
    samples_ahead,
    shares,
)
from pcs_racing.envs.origins import check_origin, origin_text, read_origin
from pcs_racing.game.players import model_agent
from pcs_racing.planners.field.lidar_ppo import arc_policy
from pcs_racing.planners.line_ppo import network_policy
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.racers import Racer, Reader, Request, own_name
from pcs_racing.planners.shipped import split_options
from pcs_racing.race.config import load_rules
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.state import MAX_CARS, RaceState
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

LIBRARIES = ("gymnasium", "stable_baselines3", "pettingzoo")
HARMLESS = (
    "Wrapper",
    "RewardWrapper",
    "VectorWrapper",
    "VectorRewardWrapper",
    "VecEnvWrapper",
    "BaseParallelWrapper",
    "TimeLimit",
    "Autoreset",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "Monitor",
    "RecordEpisodeStatistics",
    "NormalizeReward",
    "RecordVideo",
    "RecordVideoParallel",
    "RenderCollection",
    "HumanRendering",
    "DictInfoToList",
    "ClipAction",
    "VecMonitor",
    "VecCheckNan",
    "VecVideoRecorder",
    "DummyVecEnv",
    "SubprocVecEnv",
    "SyncVectorEnv",
    "AsyncVectorEnv",
)
"""Library classes that change no observation and no action; `ModelDriver` also clips actions."""

CHANGING = (
    "observation",
    "observations",
    "action",
    "actions",
    "step",
    "step_async",
    "step_wait",
    "reset",
    "reset_async",
    "reset_wait",
)
"""Methods of other wrapper classes that can change observations or actions."""


@dataclass(frozen=True, eq=False)
class ModelDriver:
    """Source of a model's commands in a race; see :func:`model_policy`."""

    name: str
    model: Any
    options: DriveOptions
    cars: int  #: Number of cars in the training races.

    @property
    def hold(self) -> int:
        """Duration of a command in simulation steps."""
        return self.options.ticks

    @property
    def content_hash(self) -> str:
        """SHA-256 of the weights and the arguments."""
        own = getattr(self.model, "content_hash", None)
        state = getattr(getattr(self.model, "policy", self.model), "state_dict", None)
        if own is None and not callable(state):
            raise InputError(
                f"results of {self.name!r} can't be saved in a folder: give the model a"
                " content_hash"
            )
        about = drive_arguments(self.options, self.cars)
        digest = hashlib.sha256(f"{own} {about}".encode())
        for key, tensor in sorted(state().items()) if own is None else ():  # type: ignore[misc]
            digest.update(key.encode() + tensor.detach().cpu().numpy().tobytes())
        return digest.hexdigest()

    @cached_property
    def _sight(self) -> Sight:
        return make_sight(self.options, self.cars, 1, load_track(list_tracks()[0]))

    def commands(
        self,
        track: Track,
        state: RaceState,
        rows: NDArray[np.int64],
        car: int,
        vehicles: NDArray[np.float64],
        settings: KernelSettings,
    ) -> NDArray[np.float64]:
        """Return steering angles (rad) and speeds (m/s) for one car of the races ``rows``, shape
        (n, 2).
        """
        ahead = samples_ahead(self.options, track)
        sight = self._sight._replace(ahead=ahead, end_tick=settings.end_tick)
        count = len(sight.low)
        seen = np.empty((len(rows), count), np.float32)
        buffers = make_buffers(0, 0, count, state.number)
        inputs = Inputs(track.arrays, settings, sight)
        races = Races(state, np.empty((0, 0, 0)), vehicles)
        eyes = eyes_for(inputs, races, buffers, len(track.arrays.moving) > 0)
        observe_races(inputs, races, eyes, rows, car, car + 1, buffers, seen)
        return self.commands_of(seen)

    def commands_of(self, seen: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return steering angles (rad) and speeds (m/s) for observations, shape (n, 2)."""
        turn, low, top = self.options.limits
        kept = np.clip(self._answers(seen), -1.0, 1.0)
        return np.stack([turn * kept[:, 0], low + 0.5 * (top - low) * (1.0 + kept[:, 1])], axis=1)

    def _answers(self, seen: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the actions for the range [-1, 1], before clipping."""
        torch, answer = sys.modules.get("torch"), None
        if hasattr(self.model, "predict"):
            answer, after = self.model.predict(seen, None, None, True)
            if after is not None:
                raise InputError(
                    f"model {self.name!r} keeps a state from step to step; such models can't race"
                    " here"
                )
        elif torch is not None and isinstance(self.model, torch.nn.Module):
            with torch.no_grad():
                answer = self.model(torch.from_numpy(seen))
                answer = (answer[0] if isinstance(answer, tuple) else answer).numpy()
        else:
            answer = self.model(seen)
        actions = np.asarray(answer, np.float64)
        if actions.shape != (len(seen), 2) or not np.isfinite(actions).all():
            raise InputError(
                f"model {self.name!r} answered {answer!r:.80} to observations of shape"
                f" {seen.shape}; it must give finite numbers of shape ({len(seen)}, 2): steering"
                " and speed"
            )
        # A last layer with a tanh returns shares of the action space in any unit.
        plain = self.options.normalized or getattr(self.model, "squash", False)
        return actions if plain else shares(actions, self.options.limits)


class ModelPlanner(Planner):
    """Planner of a model, without parameters; another process constructs it again."""

    def __reduce__(self) -> Any:
        return ModelPlanner, (
            self.name,
            (),
            *[getattr(self, one) for one in ("plan", "control")],
            0,
            0,
            self.drive,
        )


def model_policy(
    model: Any,
    *,
    name: str | None = None,
    cars: int | None = None,
    like: Any = None,
    **arguments: Any,
) -> Policy:
    """Return a model of steering and speed as a policy for races.

    Parameters
    ----------
    model : object
        A model of Stable-Baselines3 or an object with its ``predict``, a torch module, or a
        function from observations, shape (n, D), to actions, shape (n, 2). Models with a state
        (LSTM) are refused.
    name : str, optional
        Name in tables.
    cars : int, optional
        Number of cars in a training race, 2 by default.
    like : str, mapping, Env, VecEnv or VectorEnv, optional
        Training environment, also as ``"drive:beams=27"``; by default the environment that the
        model's spaces name.
    **arguments
        Arguments of the training environment (:data:`KEPT`), in place of ``like``, with the agents'
        cars as ``vehicle``; by default the defaults of `Drive`.

    Examples
    --------
    >>> straight = model_policy(lambda seen: 0.0 * seen[:, :2], name="straight", time_step=0.2)
    >>> straight.name
    'straight'
    """
    name = str(name or own_name(model))
    given = dict(arguments) or dict(origin_of(model, name, like) or {})
    if (environment := given.pop("environment", "drive")) != "drive":
        raise InputError(
            f"model {name!r} was trained in {environment!r}; commands come from 'drive' alone: a"
            " model of 'duel' is an agent, and racer() races a CandidatePolicy of 'line'"
        )
    number = check_whole("cars", given.pop("cars", 2) if cars is None else cars, 1, MAX_CARS)
    if "front_pace" in given:
        given["rules"] = load_rules("contest", front_pace=given.pop("front_pace"))
    for key in given:
        if key not in (*KEPT, "rules", "vehicle"):
            raise InputError(
                f"a model's argument {key!r} is unknown; there are cars, {', '.join(KEPT)}"
            )
    return policy_of(model, name, DriveOptions(**given), number)


def origin_of(
    model: Any, name: str, like: Any = None, kept: Any = None
) -> Mapping[str, Any] | None:
    """Return the environment and the arguments of a model's training; None if they are not known.

    ``like`` is as in :func:`model_policy`; it is used for a model without an origin alone. ``kept``
    is as in `layers`.
    """
    env = model.get_env() if callable(getattr(model, "get_env", None)) else None
    texts = {origin_text(layer) for layer in layers(env, kept)} if env is not None else set()
    texts, own = texts - {None}, origin_text(model)
    if len(texts) > 1:
        raise InputError(f"the environments of model {name!r} differ; give one of them as like=")
    texts = texts | {own} if own is not None else texts or {None}
    if len(texts) > 1:
        raise InputError(
            f"the environment of model {name!r} differs from its spaces, which its zip will hold:"
            " set model.observation_space to the environment's"
        )
    (text,) = texts
    if text is not None:
        return read_origin(text, f"model {name!r}")
    if like is None or isinstance(like, Mapping):
        return like
    if isinstance(like, str):
        return _parse_like(like)
    found = {origin_text(layer) for layer in layers(like)} - {None}
    if len(found) != 1:
        raise InputError(
            f"like is a {type(like).__name__}; it must be one environment of this package, or text"
            " such as 'duel' or 'drive:beams=27'"
        )
    return read_origin(str(found.pop()), "like")


def _parse_like(text: str) -> dict[str, Any]:
    """Return the environment of a text such as ``drive:beams=27,look_ahead=[0, 2]``."""
    environment, _, rest = text.partition(":")
    options = split_options(f"like={text}", rest) if rest else {}
    values = {name: parse_yaml("like", value.encode()) for name, value in options.items()}
    return check_origin({"environment": environment, **values}, f"like {text!r}")


def needs_like(name: str) -> InputError:
    """Return the error for a model whose environment is not known."""
    return InputError(
        f"{name} does not name the environment of its training; give it with --like (like=): duel,"
        " drive, or drive with its arguments, as in drive:beams=27,time_step=0.05"
    )


def read_model(request: Request) -> Racer | None:
    """Return the racer of a model in memory: a policy, or an agent if its actions are moves."""
    given = request.given
    name = own_name(given)
    if hasattr(given, "predict"):
        origin = origin_of(given, name, None)
        shape = getattr(getattr(given, "action_space", None), "shape", None)
        if origin is not None and origin["environment"] == "line":
            scores = getattr(getattr(given, "policy", None), "action_net", None)
            return line_policy(name, getattr(scores, "tensors", dict)(), origin)
        drives = shape == (2,) if origin is None else origin["environment"] == "drive"
        if not drives:
            return model_agent(given, name, origin and origin.get("game"), request.asked_game)
    elif module_outputs(given) is None and not inspect.isroutine(given):
        return None
    return model_policy(given, name=name, like=request.like)


MODELS = Reader(read_model)


def module_outputs(given: Any) -> int | None:
    """Return the outputs of a torch module's last layer; None for other objects."""
    torch = sys.modules.get("torch")
    if torch is None or not isinstance(given, torch.nn.Module) or hasattr(given, "predict"):
        return None
    widths = [layer.out_features for layer in given.modules() if hasattr(layer, "out_features")]
    return int(widths[-1]) if widths else 2


def policy_of(model: Any, name: str, options: DriveOptions, cars: int) -> Policy:
    """Return the policy of a model, given the arguments of its environment.

    Observations and actions of the model must fit these arguments.
    """
    if options.action == "arc":
        if getattr(model, "scale", None) is not None or not hasattr(model, "layers"):
            raise InputError(
                f"model {name!r} has actions of arcs; by them only an MlpPolicy of"
                " Stable-Baselines3 without VecNormalize races"
            )
        tanh = model.activation == "Tanh"
        return arc_policy(model.layers, tanh=tanh, squash=model.squash, name=name)
    count = len(drive_elements(options, cars))
    for space, wanted in (("observation_space", (count,)), ("action_space", (2,))):
        shape = getattr(getattr(model, space, None), "shape", None)
        if shape is not None and tuple(shape) != wanted:
            raise InputError(
                f"model {name!r} has the {space} {tuple(shape)}; with these arguments of Drive it"
                f" is {wanted}: give those that it was trained with, model_policy(model, beams=...,"
                " ...)"
            )
    driver: Any = ModelDriver(name, model, options, cars)
    return Policy(ModelPlanner(name, (), drive=driver), np.empty(0), name)


def line_policy(name: str, tensors: Mapping[str, Any], origin: Mapping[str, Any]) -> Policy:
    """Return the policy of a model of `Line`, which must score the candidates alike."""
    if not tensors:
        raise InputError(
            f"{name} was trained in line with another policy than CandidatePolicy or"
            " MaskableCandidatePolicy; only these race outside of it"
        )
    return network_policy(tensors, name=name, style=origin.get("style"))


def _changes(layer: Any) -> bool:
    """Return whether a wrapper or environment may change observations or actions, by the methods of
    its class.
    """
    for kind in type(layer).__mro__:
        library = kind.__module__.partition(".")[0]
        # Known classes, and their subclasses without overrides of these methods.
        if library in ("pcs_racing", "pcs_racing_agents") or (
            library in LIBRARIES and kind.__name__ in HARMLESS
        ):
            return False
        if any(name in vars(kind) for name in CHANGING):
            return True
    return False


def layers(env: Any, kept: Any = None) -> Iterator[Any]:
    """Yield all wrappers and environments inside an environment.

    Wrappers that a trained model would lose are refused, except ``kept``, saved by the caller.
    """
    inside = [env]
    while inside:
        layer = inside.pop(0)
        name, own = type(layer).__name__, getattr(layer, "__dict__", {})
        scaling = name == "VecNormalize"
        if layer is not kept and (own.get("norm_obs") is not False if scaling else _changes(layer)):
            more = "only save_model keeps VecNormalize" if scaling else "train without it"
            raise InputError(
                f"the model was trained behind {name}; {more}. A wrapper of rewards alone is a"
                " gymnasium.RewardWrapper; if it changes no observation and no action, give the"
                " environment without it as env= or like="
            )
        yield layer
        inside += [
            *own.get("groups", ()),
            *own.get("envs", ()),
            *(own[key] for key in ("venv", "env") if key in own),
        ]
