"""Models that were trained in `Drive` or `drive_head_to_head` as drivers, which race wherever a policy does.

A model decides from what it observed in training: the arguments of its environment are kept beside it. Every model that
is due in a batch of races is asked in one call.
"""

import hashlib
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar_kernel import WORK_SHAPE
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive_kernel import SEEN_SHAPE, Sight, observe_car
from pcs_racing.envs.drive_options import DriveOptions, drive_elements, make_sight, samples_ahead, shares
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.state import MOST_CARS, RaceState
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

KEPT = (
    "time_step", "min_speed", "top_speed", "beams", "fov", "max_range", "lidar_noise", "look_ahead", "own_state",
    "own_pose", "see_opponent", "time_left", "normalize", "normalized",
)  # fmt: skip
"""Arguments of an environment that say what a model observes and what its actions mean."""

LIBRARIES = ("gymnasium", "stable_baselines3", "pettingzoo")
HARMLESS = (
    "Wrapper", "RewardWrapper", "VectorWrapper", "VectorRewardWrapper", "VecEnvWrapper", "BaseParallelWrapper",
    "TimeLimit", "Autoreset", "OrderEnforcing", "PassiveEnvChecker", "Monitor", "RecordEpisodeStatistics",
    "NormalizeReward", "RecordVideo", "RecordVideoParallel", "RenderCollection", "HumanRendering", "DictInfoToList",
    "ClipAction", "VecMonitor", "VecCheckNan", "VecVideoRecorder", "DummyVecEnv", "SubprocVecEnv", "SyncVectorEnv",
    "AsyncVectorEnv",
)  # fmt: skip
"""Classes of these libraries behind which a model sees and does what it would without them; a driver clips as well."""

CHANGING = (
    "observation", "observations", "action", "actions", "step", "step_async", "step_wait", "reset", "reset_async",
    "reset_wait",
)  # fmt: skip
"""Methods with which a wrapper of another class can change observations or actions."""


@dataclass(frozen=True, eq=False)
class ModelDriver:
    """What a race asks for the commands of a model: see :func:`model_policy`."""

    name: str
    model: Any
    options: DriveOptions
    cars: int  #: In the races of the training.

    @property
    def hold(self) -> int:
        """Simulation steps for which a command holds."""
        return self.options.ticks

    @property
    def content_hash(self) -> str:
        """SHA-256 of the weights and of the arguments."""
        own = getattr(self.model, "content_hash", None)
        state = getattr(getattr(self.model, "policy", self.model), "state_dict", None)
        if own is None and not callable(state):
            raise InputError(f"results of {self.name!r} can't be kept in a folder: give the model a content_hash")
        digest = hashlib.sha256(f"{own} {self.cars} {_plain(self.options)}".encode())
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
        """Return steering angles (rad) and speeds (m/s) for one car of the races ``rows``, shape (n, 2)."""
        noise = np.full(state.races, float(self.options.lidar_noise))
        ahead = samples_ahead(self.options, track)
        sight = self._sight._replace(ahead=ahead, noise=noise, end_tick=settings.end_tick)
        seen = np.empty((len(rows), len(sight.low)), np.float32)
        buffers = np.empty(len(sight.low)), np.empty(SEEN_SHAPE), np.empty(WORK_SHAPE)
        observe_car(track.arrays, state, vehicles, sight, rows, car, *buffers, seen)
        turn, low, top = self.options.limits
        kept = np.clip(self._answers(seen), -1.0, 1.0)
        return np.stack([turn * kept[:, 0], low + 0.5 * (top - low) * (1.0 + kept[:, 1])], axis=1)

    def _answers(self, seen: NDArray[np.float32]) -> NDArray[np.float64]:
        """Actions in [-1, 1], before they are clipped."""
        torch, answer = sys.modules.get("torch"), None
        if hasattr(self.model, "predict"):
            answer, after = self.model.predict(seen, None, None, True)
            if after is not None:
                raise InputError(f"model {self.name!r} keeps a state from step to step; such models can't race here")
        elif torch is not None and isinstance(self.model, torch.nn.Module):
            with torch.no_grad():
                answer = self.model(torch.from_numpy(seen))
                answer = (answer[0] if isinstance(answer, tuple) else answer).numpy()
        else:
            answer = self.model(seen)
        actions = np.asarray(answer, np.float64)
        if actions.shape != (len(seen), 2) or not np.isfinite(actions).all():
            raise InputError(
                f"model {self.name!r} answered {answer!r:.80} to observations of shape {seen.shape}; it must give "
                f"finite numbers of shape ({len(seen)}, 2): steering and speed"
            )
        # A last layer with a tanh gives shares of the space of actions, whatever its unit.
        plain = self.options.normalized or getattr(self.model, "squash", False)
        return actions if plain else shares(actions, self.options.limits)


class ModelPlanner(Planner):
    """The planner of a model: it has no parameters, and is made anew in another process."""

    def __reduce__(self) -> Any:
        return ModelPlanner, (self.name, (), *[getattr(self, one) for one in ("plan", "control")], 0, 0, self.drive)


def model_policy(
    model: Any, *, name: str | None = None, cars: int | None = None, like: Any = None, **arguments: Any
) -> Policy:
    """Return a model as a driver of races.

    Parameters
    ----------
    model : object
        A model of Stable-Baselines3 or anything with its ``predict``, a torch module, or a function of observations,
        shape (n, D), that returns actions, (n, 2). Models that keep a state (LSTM) are refused.
    name : str, optional
        What tables call it.
    cars : int, optional
        Cars in a race of its training, 2 by default.
    like : Env, VecEnv or VectorEnv, optional
        The environment that it was trained in; by default that which a model of Stable-Baselines3 is connected to.
    **arguments
        Of that environment, :data:`KEPT`, instead; `Drive`'s by default.

    Examples
    --------
    >>> straight = model_policy(lambda seen: 0.0 * seen[:, :2], name="straight", time_step=0.2)
    >>> straight.name
    'straight'
    """
    given = dict(arguments)
    if not given and (like is not None or (callable(getattr(model, "get_env", None)) and model.get_env() is not None)):
        given = kept_arguments(model.get_env() if like is None else like)
    number = check_whole("cars", given.pop("cars", 2) if cars is None else cars, 1, MOST_CARS)
    for key in given:
        if key not in (*KEPT, "vehicle"):
            raise InputError(f"a model's argument {key!r} is unknown; there are cars, {', '.join(KEPT)}")
    options = DriveOptions(**given)
    name = name or getattr(model, "name", None) or getattr(model, "__name__", None) or type(model).__name__
    return policy_of(model, str(name), options, number)


def policy_of(model: Any, name: str, options: DriveOptions, cars: int) -> Policy:
    """Return the driver of a model for arguments of an environment, whose observations and actions must fit."""
    count = len(drive_elements(options, cars))
    for space, wanted in (("observation_space", (count,)), ("action_space", (2,))):
        shape = getattr(getattr(model, space, None), "shape", None)
        if shape is not None and tuple(shape) != wanted:
            raise InputError(
                f"model {name!r} has the {space} {tuple(shape)}; with these arguments of Drive it is {wanted}: "
                "give those that it was trained with, model_policy(model, beams=..., ...)"
            )
    driver: Any = ModelDriver(name, model, options, cars)
    return Policy(ModelPlanner(name, (), drive=driver), np.empty(0), name)


def _plain(options: DriveOptions) -> dict[str, Any]:
    """The arguments that are kept, in the form of a YAML file."""
    values = {name: getattr(options, name) for name in KEPT} | {"look_ahead": list(options.look_ahead)}
    cars = options.vehicle if isinstance(options.vehicle, tuple) else (options.vehicle,)
    if any(car != F1TENTH for car in cars):
        values["vehicle"] = [asdict(car) for car in cars]
    return values


def _changes(layer: Any) -> bool:
    """Return whether a wrapper or environment may change observations or actions, by the methods of its class."""
    for kind in type(layer).__mro__:
        library = kind.__module__.partition(".")[0]
        # Known classes, and their subclasses that override nothing of it.
        if library in ("pcs_racing", "pcs_racing_agents") or (library in LIBRARIES and kind.__name__ in HARMLESS):
            return False
        if any(name in vars(kind) for name in CHANGING):
            return True
    return False


def layers(env: Any, kept: Any = None) -> Iterator[Any]:
    """Yield the wrappers and environments that an environment consists of.

    A wrapper that a model trained behind it would lose is refused, except ``kept``, which the caller keeps.
    """
    inside = [env]
    while inside:
        layer = inside.pop(0)
        name, own = type(layer).__name__, getattr(layer, "__dict__", {})
        scaling = name == "VecNormalize"
        if layer is not kept and (own.get("norm_obs") is not False if scaling else _changes(layer)):
            more = "only save_model keeps VecNormalize" if scaling else "train without it"
            raise InputError(
                f"the model was trained behind {name}; {more}. A wrapper of rewards alone is a "
                "gymnasium.RewardWrapper; if it changes no observation and no action, give the environment without it "
                "as env= or like="
            )
        yield layer
        inside += [*own.get("groups", ()), *own.get("envs", ()), *(own[key] for key in ("venv", "env") if key in own)]


def kept_arguments(env: Any, kept: Any = None) -> dict[str, Any]:
    """Return the arguments of an environment at the control level, whatever wraps it; ``kept`` is as in `layers`."""
    batches = [getattr(layer, "__dict__", {}).get("batch") for layer in layers(env, kept)]
    drives: list[Any] = [batch for batch in batches if isinstance(getattr(batch, "options", None), DriveOptions)]
    if not drives:
        raise InputError(
            f"{type(env).__name__} is no environment of steering and speed that can be looked into; give env="
        )
    found = [{"cars": int(batch.cars), **_plain(batch.options)} for batch in drives]
    for key in ("cars", *KEPT):
        if any(one[key] != found[0][key] for one in found):
            raise InputError(
                f"the environments of {type(env).__name__} differ in {key}; give one of them as env= or like="
            )
    return found[0]
