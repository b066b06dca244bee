"""One environment of Gymnasium over a batch of one episode."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.batch import Batch, check_options, check_rendering, check_reset_seed
from pcs_racing.envs.infos import words
from pcs_racing.envs.over_batch import REBUILDING, OverBatch
from pcs_racing.race.rendering import MODES


class EnvState(NamedTuple):
    """A moment of an environment: a value that can be kept, copied, pickled and restored."""

    batch: tuple[Any, ...]  #: State of the batch.
    started: bool  #: Whether there was a reset.
    running: bool  #: Whether an episode goes on.
    generator: dict[str, Any]  #: State of the random generator that the next episodes are drawn from.


class ScalarEnv(OverBatch, gym.Env[NDArray[np.float32], Any]):
    """Base class of the environments for one agent; subclasses name the batch and document themselves."""

    metadata: dict[str, Any] = {"render_modes": list(MODES), "render_fps": 1}  # noqa: RUF012

    def _begin(
        self,
        *,
        arguments: dict[str, Any],
        render_mode: str | None = None,
        view: str = "both",
        render_size: tuple[int, int] = (960, 640),
    ) -> None:
        check_rendering(render_mode, view, self.metadata["render_modes"])
        self.render_mode, self.view, self.render_size = render_mode, view, render_size
        self._arguments = arguments
        self._use(self._make_batch(arguments))
        self.observation_space = self.batch.observation_space
        self.action_space = self.batch.action_space
        self._row = np.zeros(1, np.int64)
        self._started = self._running = False

    def _make_batch(self, arguments: dict[str, Any]) -> Batch:
        batch: Batch = self.batch_type(1, threads=1, **arguments)
        return batch

    def _use(self, batch: Batch) -> None:
        self.batch = batch
        self.metadata = {**type(self).metadata, "render_fps": self._frames_per_second(), "codes": batch.codes}

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new episode.

        Parameters
        ----------
        seed : int, optional
            Seed of the random generator; without it the generator goes on.
        options : dict, optional
            "track" and "opponent" replace the environment's arguments from now on; "state" continues from what
            `get_state` returned; the class lists the others.

        Returns
        -------
        observation : ndarray of float32
        info : dict
        """
        number = check_reset_seed(seed)
        given = check_options(options, (*REBUILDING, "state", *self.batch.reset_options))
        changes = {name: given.pop(name) for name in REBUILDING if name in given}
        batch = self._make_batch({**self._arguments, **changes}) if changes else self.batch
        state = given.pop("state", None)
        if state is not None and (given or number is not None):
            raise InputError("reset option 'state' was given with others or a seed; a state leaves nothing to choose")
        super().reset(seed=number)
        if state is None:
            if number is not None:
                batch.forget(self._row)
            batch.restart(self._row, [self.np_random], given)
        if batch is not self.batch:
            self.close()
            self._arguments = {**self._arguments, **changes}
            self._use(batch)
        if state is None:
            self._started = self._running = True
        else:
            self.set_state(state)
        if self.render_mode == "human":
            self.render()
        return self._observation(), self.batch.info(0)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Make a step.

        Parameters
        ----------
        action
            See the action space.
        """
        actions = self.batch.check_actions(action, ())
        if not self._running:
            raise InputError(
                f"the episode {'has ended' if self._started else 'has not begun'}; call reset() before step()"
            )
        observations, rewards, terminated, truncated = self.batch.step(actions, [self.np_random])
        ended, late = bool(terminated[0]), bool(truncated[0])
        self._running = not (ended or late)
        if self.render_mode == "human":
            self._show_step()
        return observations[0], float(rewards[0]), ended, late, self.batch.info(0)

    def outcome(self) -> dict[str, Any]:
        """Return the info of this moment in words, for people."""
        self._check_started()
        return words(self.batch.info(0), self.batch.codes)

    def render(self) -> Any:
        """Return a frame (``"rgb_array"``), or show it (``"human"``)."""
        return self.batch.draw(self._open_renderer(), 0)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._close_renderer()

    def get_state(self) -> EnvState:
        """Return all that the rest of this episode, and all later ones, depend on."""
        generator = dict(self.np_random.bit_generator.state)
        return EnvState(self.batch.get_state(), self._started, self._running, generator)

    def set_state(self, state: EnvState) -> NDArray[np.float32]:
        """Continue from what `get_state` returned, here or in an environment with equal arguments.

        Returns
        -------
        ndarray of float32
            The observation at that moment.
        """
        if not isinstance(state, EnvState):
            raise InputError(f"state is a {type(state).__name__}; it must be what get_state returned")
        self.batch.set_state(state.batch)
        self.np_random.bit_generator.state = state.generator
        self._started, self._running = state.started, state.running
        return self._observation()

    def _observation(self) -> NDArray[np.float32]:
        out = np.zeros((1, *self.observation_space.shape), np.float32)  # type: ignore[misc]
        if self._started:
            self.batch.observe(self._row, out)
        return out[0]

    def _check_started(self) -> None:
        if not self._started:
            raise InputError("the episode has not begun; call reset() first")

    # Copies are made anew from the arguments: they share the track, and neither compiled code nor a window.

    def __reduce__(self) -> tuple[Any, ...]:
        looks = {"render_mode": self.render_mode, "view": self.view, "render_size": self.render_size}
        return _rebuild, (type(self), {**self._arguments, **looks}, self.get_state(), self._spec)

    def __deepcopy__(self, memo: dict[int, Any]) -> "ScalarEnv":
        function, arguments = self.__reduce__()
        return function(*arguments)


def _rebuild(kind: type[Any], arguments: dict[str, Any], state: EnvState, spec: EnvSpec | None) -> Any:
    env = kind(**arguments)
    env.set_state(state)
    env.spec = spec
    return env
