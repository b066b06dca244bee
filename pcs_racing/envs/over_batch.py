"""Common base of all environments: views of a batch."""

import copy
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self, Union

import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import (
    ConfigError,
    InputError,
    UnknownNameError,
    check_choice,
    choices,
    unknown_argument,
)
from pcs_racing.envs.batch import BatchStep, Generators, Step, check_reward, check_weights
from pcs_racing.envs.randomization import EpisodeOptions
from pcs_racing.race.state import MODES, views
from pcs_racing.track.track import Track

if TYPE_CHECKING:  # so that an environment imports its own batch alone
    from pcs_racing.envs.drive_batch import DriveBatch
    from pcs_racing.envs.game_batch import GameBatch
    from pcs_racing.race.rendering import Renderer

Batch = Union["DriveBatch", "GameBatch"]
"""Batch below an environment."""

METADATA = {"render_modes": list(MODES), "render_fps": 1}


class OverBatch:
    """Base class of environments over a batch: configuration, rewards, copies, and frames."""

    batch_type: ClassVar[Callable[..., Any]]  #: Class of the batch, or function that chooses it.
    options_type: ClassVar[type[EpisodeOptions]]
    players: int = 1  #: Number of environments of an episode: 2 for both cars of a race.
    batch: Any
    options: Any  #: Configuration of the environment: an instance of ``options_type``.
    metadata: dict[str, Any] = METADATA
    render_mode: str | None
    _own: dict[str, Any]  # arguments of the constructor that are no part of the configuration
    _spec: EnvSpec | None = None
    _renderer: "Renderer | None" = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Show the arguments in the signature, and as attributes that can be read, and not set."""
        super().__init_subclass__(**kwargs)
        named = cls.options_type.defaults() if hasattr(cls, "options_type") else {}
        for name in named:
            if name != "render_mode" and not hasattr(cls, name):
                setattr(cls, name, property(attrgetter(f"options.{name}"), partial(refuse, name)))
        own = inspect.signature(cls.__init__).parameters
        first = [one for name, one in own.items() if name not in ("self", "arguments")]
        kind = inspect.Parameter.KEYWORD_ONLY
        options = [inspect.Parameter(name, kind, default=value) for name, value in named.items()]
        if "arguments" in own:
            cls.__signature__ = inspect.Signature([*first, *options])  # type: ignore[attr-defined]

    def _configure(self, arguments: Mapping[str, Any], **own: Any) -> None:
        """Make the batch from the arguments of the configuration; ``own`` are all others."""
        known = self.options_type.defaults()
        for name in arguments:
            if name not in known:
                raise unknown_argument(type(self).__name__, name, [*own, *known])
        options = self.options_type.read(arguments)
        if options.render_mode is not None:
            check_choice("render_mode", options.render_mode, self.metadata["render_modes"])
        self._own, self.options, self.render_mode = own, options, options.render_mode
        self._replaced: dict[int, Any] = {}  # later opponents by index
        if not callable(self.reward):
            raise ConfigError(f"reward is {self.reward!r}; it must be a method reward(step)")
        if options.reward is not None and type(self).reward is not OverBatch.reward:
            raise ConfigError(
                f"{type(self).__name__} has a method reward and the argument reward; give one"
            )
        self.batch = self._make_batch(options)
        check_choice("view", options.view, views(self.batch.cars))
        own_metadata = {"render_fps": self._frames_per_second(), "codes": self.batch.codes}
        self.metadata = type(self).metadata | own_metadata

    def _make_batch(self, options: Any) -> Batch:
        raise NotImplementedError

    def _count_players(self, options: Any) -> int:
        """Return the number of agents in an episode."""
        return self.players

    @property
    def spec(self) -> EnvSpec | None:
        """Specification of the environment, with the max number of steps as ``max_episode_steps``.

        The registry does not hold this number: it would truncate episodes with a longer duration.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value is not None and value.max_episode_steps is None:
            value = copy.copy(value)
            value.max_episode_steps = self.batch.horizon
        self._spec = value

    @property
    def elements(self) -> list[Any]:
        """Name, unit, bounds and meaning of every element of an environment's observation."""
        return list(self.batch.elements)

    @property
    def track(self) -> Track:
        """Track of the environment."""
        return self.batch.track

    # Steps

    def reward(self, step: Step) -> NDArray[Any]:
        """Return the reward of each player in a step, shape (episodes, players).

        A subclass may override this method, or the argument ``reward`` replace it. The reward of
        the environment itself is ``step.reward``.
        """
        own = self.options.reward
        return step.reward if own is None else own(step)

    def set_opponent_weights(self, weights: ArrayLike) -> None:
        """Set the weights of the opponents, one for each, for the episodes that begin from now on.

        Running episodes keep their opponents.
        """
        self.batch.weights = check_weights(weights, self.batch.weights)

    def set_opponent(self, index: int, policy: Any) -> None:
        """Replace an opponent of a list in `Drive` or `Line`, for the episodes that begin from now
        on.

        The policy has the same planner, as a frozen copy of a network
        (:func:`pcs_racing.planners.line_ppo.network_policy`) and a later one have. Copies of the
        environment hold it, states do not.
        """
        if not hasattr(self.batch, "set_opponent"):
            raise InputError("an opponent can be replaced in Drive and Line alone")
        self.batch.set_opponent(index, policy)
        self._replaced[index] = policy

    def _step_batch(
        self, actions: NDArray[Any], generators: Generators, running: NDArray[np.bool_]
    ) -> BatchStep:
        """Step the batch, and replace the rewards if there is an own reward.

        ``running`` marks the episodes that are not over; only their rewards must be finite.
        """
        if "reward" in vars(self):
            refuse("reward")
        if self.options.reward is None and type(self).reward is OverBatch.reward:
            return self.batch.step(actions, generators)
        before = self.batch.value().copy()
        result = self.batch.step(actions, generators)
        usual = result.rewards.reshape(self.batch.episodes, -1)
        # The race clips steering and speed, too.
        driven = np.clip(actions, -1.0, 1.0) if actions.dtype.kind == "f" else actions
        step = Step(before, driven, self.batch.value().copy(), usual)
        return result._replace(rewards=check_reward(self.reward(step), usual.shape, running))

    # Resets

    def _reset_options(self, options: Any, *more: str) -> dict[str, Any]:
        """Return the options of a reset except None; ``more`` are further known names."""
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise InputError(f"options are {options!r}; they must be None or a mapping")
        known = (*more, *self.batch.reset_options)
        for name in options:
            if name not in known:
                raise UnknownNameError(
                    f"reset option {name!r} is unknown; {choices(str(name), known)}"
                )
        return {name: value for name, value in options.items() if value is not None}

    def _check_started(self) -> None:
        """Raise an :class:`InputError` before the first reset."""
        raise NotImplementedError

    @contextmanager
    def unless_refused(self) -> Iterator[None]:
        """Restore the environment if a reset within the context is refused after random draws."""
        state = self.get_state()
        try:
            yield
        except Exception:
            self.set_state(state)
            raise

    # Copies are made from the arguments: they share the track, but no compiled code and no window.

    def get_state(self) -> Any:
        """Return the full state, which determines the current and all later episodes."""
        raise NotImplementedError

    def set_state(self, state: Any) -> Any:
        """Continue from a state of `get_state`, from an environment with equal arguments."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (
            type(self),
            {**vars(self.options), **self._own},
            self.get_state(),
            self.spec,
            self._replaced,
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        function, arguments = self.__reduce__()
        copied: Self = function(*arguments)
        return copied

    # Frames

    def _open_renderer(self) -> "Renderer":
        """Return the renderer of the frames; it is made for the first frame."""
        if self.render_mode is None:
            raise InputError(
                "render_mode is None; make the environment with another one, such as 'rgb_array'"
            )
        self._check_started()
        if self._renderer is None:
            from pcs_racing.race.rendering import Renderer

            (width, height), fps = self.options.render_size, float(self.metadata["render_fps"])
            mode = "human" if self.render_mode == "human" else "rgb_array"
            self._renderer = Renderer(
                self.track, width, height, mode, view=self.options.view, fps=fps
            )
        return self._renderer

    def _show_step(self) -> None:
        """Show the end of the first environment's last step in the window."""
        self.batch.draw(self._open_renderer(), 0)

    def _frames_per_second(self) -> int:
        """Return the frame rate of `render` or the window."""
        return self.batch.frame_rate

    def _close_renderer(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def refuse(name: str, *_: object) -> NoReturn:
    """Refuse an argument that is set after an environment was made."""
    among = "; of the opponents in a list, set_opponent_weights([...]) chooses later ones"
    raise InputError(
        f"{name} is an argument of the environment and can't be set later: make another one with"
        f" {name}=...{among if name in ('opponent', 'opponents') else ''}"
    )


def _rebuild(
    kind: type[Any],
    arguments: dict[str, Any],
    state: Any,
    spec: EnvSpec | None,
    replaced: dict[int, Any],
) -> Any:
    made = kind(**arguments)
    for index, policy in replaced.items():
        made.set_opponent(index, policy)
    made.set_state(state)
    made.spec = spec
    return made
