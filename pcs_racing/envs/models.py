"""Models trained in `Drive` or `drive_head_to_head` as policies for any race.

A model needs the observation of its training, so the arguments of its environment are saved with
it. One call of a model serves all its due cars in a batch of races.
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
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive_kernel import Inputs, Races, Sight, make_buffers, observe_car
from pcs_racing.envs.drive_options import (
    DriveOptions,
    drive_elements,
    make_sight,
    samples_ahead,
    shares,
)
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.state import MAX_CARS, RaceState
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

KEPT = (
    "time_step",
    "min_speed",
    "top_speed",
    "beams",
    "fov",
    "max_range",
    "look_ahead",
    "own_state",
    "own_pose",
    "see_opponent",
    "time_left",
    "normalize",
    "normalized",
)
"""Arguments of an environment that define a model's observations and actions."""

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
                f"results of {self.name!r} can't be kept in a folder: give the model a content_hash"
            )
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
        observe_car(inputs, races, rows, car, buffers, seen)
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
    """Return a model as a policy for races.

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
    like : Env, VecEnv or VectorEnv, optional
        Training environment; by default the environment of a model of Stable-Baselines3.
    **arguments
        Arguments of the training environment (:data:`KEPT`), in place of ``like``, with the agents'
        cars as ``vehicle``; by default the defaults of `Drive`.

    Examples
    --------
    >>> straight = model_policy(lambda seen: 0.0 * seen[:, :2], name="straight", time_step=0.2)
    >>> straight.name
    'straight'
    """
    given = dict(arguments)
    if not given and (
        like is not None
        or (callable(getattr(model, "get_env", None)) and model.get_env() is not None)
    ):
        given = kept_arguments(model.get_env() if like is None else like)
    number = check_whole("cars", given.pop("cars", 2) if cars is None else cars, 1, MAX_CARS)
    for key in given:
        if key not in (*KEPT, "vehicle"):
            raise InputError(
                f"a model's argument {key!r} is unknown; there are cars, {', '.join(KEPT)}"
            )
    options = DriveOptions(**given)
    name = (
        name
        or getattr(model, "name", None)
        or getattr(model, "__name__", None)
        or type(model).__name__
    )
    return policy_of(model, str(name), options, number)


def policy_of(model: Any, name: str, options: DriveOptions, cars: int) -> Policy:
    """Return the policy of a model, given the arguments of its environment.

    Observations and actions of the model must fit these arguments.
    """
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


def _plain(options: DriveOptions) -> dict[str, Any]:
    """Return the saved arguments, in the form of a YAML file."""
    values = {name: getattr(options, name) for name in KEPT} | {
        "look_ahead": list(options.look_ahead)
    }
    cars = options.vehicle if isinstance(options.vehicle, tuple) else (options.vehicle,)
    if any(car != F1TENTH for car in cars):
        values["vehicle"] = [asdict(car) for car in cars]
    return values


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


def kept_arguments(env: Any, kept: Any = None) -> dict[str, Any]:
    """Return the arguments of a control-level environment below any wrappers.

    ``kept`` is as in `layers`.
    """
    batches = [getattr(layer, "__dict__", {}).get("batch") for layer in layers(env, kept)]
    drives: list[Any] = [
        batch for batch in batches if isinstance(getattr(batch, "options", None), DriveOptions)
    ]
    if not drives:
        raise InputError(
            f"{type(env).__name__} is no environment of steering and speed that can be looked into;"
            " give env="
        )
    found = [{"cars": int(batch.cars), **_plain(batch.rules.options)} for batch in drives]
    limits = [batch.rules.limits for batch in drives]
    for key in ("cars", *KEPT, "steer_max"):
        values = limits if key == "steer_max" else [one[key] for one in found]
        if any(value != values[0] for value in values):
            raise InputError(
                f"the environments of {type(env).__name__} differ in {key}; give one of them as"
                " env= or like="
            )
    return found[0]
