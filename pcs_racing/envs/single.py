"""Environments over a batch of one episode: Gymnasium for one agent, PettingZoo for several."""

import copy
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from pcs_racing.base.errors import InputError, check_flag, check_seed, check_whole
from pcs_racing.envs.batch import MAX_STEPS, generator_of
from pcs_racing.envs.infos import words
from pcs_racing.envs.over_batch import Batch, OverBatch

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


class EnvState(NamedTuple):
    """Full state of an environment; it can be stored, copied, pickled and restored."""

    batch: tuple[Any, ...]  #: State of the batch of one episode.
    steps: int | None  #: Number of steps since the start; None before the first reset.
    running: bool  #: Flag: the episode is not over.
    generator: Mapping[str, Any] | None  #: State of the random generator of the next episodes.


class SingleEnv(OverBatch):
    """Base class of environments with one episode: reset, steps, end, and snapshots."""

    ignored_options: ClassVar[tuple[str, ...]] = ()  #: Options of a reset without effect.
    _row: ClassVar[NDArray[np.int64]] = np.zeros(1, np.int64)
    _always: ClassVar[NDArray[np.bool_]] = np.ones(1, np.bool_)
    _steps: int | None = None
    _running = False
    # Names required by Gymnasium's checker and wrappers.
    _np_random: np.random.Generator | None = None
    _np_random_seed: int | None = None

    def _make_batch(self, options: Any) -> Batch:
        return self.batch_type(1, options, threads=1, players=self._count_players(options))

    def _restart(self, seed: Any, options: Any) -> None:
        """Begin a new episode, or continue from the option "state"."""
        number = None if seed is None else check_seed(seed)
        given = self._reset_options(options, "state", *self.ignored_options)
        for name in self.ignored_options:
            given.pop(name, None)
        state = given.pop("state", None)
        if state is None:
            generator = self._np_random
            if number is not None or generator is None:
                generator, self._np_random_seed = seeding.np_random(number)
            with self.unless_refused():
                if number is not None:
                    self.batch.randomization.circuits.forget(self._row)
                self.batch.restart(self._row, [generator], given)
            self._np_random, self._steps, self._running = generator, 0, True
        elif given or number is not None:
            raise InputError(
                "reset option 'state' was given with others or a seed; a state leaves nothing to"
                " choose"
            )
        else:
            self.set_state(state)
        if self.render_mode == "human":
            self.render()

    def _advance(self, actions: NDArray[Any], max_steps: int | None = None) -> Any:
        """Make a step with checked actions.

        Return observations, rewards, and the flags of termination and truncation.
        """
        self._check_started()
        if not self._running:
            raise InputError("the episode has ended; call reset() before step()")
        generators: Any = [self._np_random]
        observations, rewards, terminated, truncated = self._step_batch(
            actions, generators, self._always
        )
        self._steps = (self._steps or 0) + 1
        ended = bool(terminated[0])
        late = bool(truncated[0]) or (max_steps is not None and self._steps >= max_steps)
        self._running = not (ended or late)
        if self.render_mode == "human":
            self._show_step()
        return observations, rewards, ended, late and not ended

    def _observe(self) -> NDArray[np.float32]:
        """Return the observations of the players, shape (players, D)."""
        out = np.zeros((self.batch.players, *self.batch.observation_space.shape), np.float32)
        if self._steps is not None:
            self.batch.observe(self._row, out)
        return out

    def render(self) -> Any:
        """Return a frame (``"rgb_array"``), or show it (``"human"``)."""
        return self.batch.draw(self._open_renderer(), 0)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._close_renderer()

    def get_state(self) -> EnvState:
        """Return the full state, which determines the current and all later episodes."""
        generator = None if self._np_random is None else dict(self._np_random.bit_generator.state)
        return EnvState(self.batch.get_state(), self._steps, self._running, generator)

    def set_state(self, state: EnvState) -> Any:
        """Continue from a state of `get_state`, from an environment with equal arguments.

        Return the observations of the players, shape (players, D).
        """
        if not isinstance(state, EnvState):
            raise InputError(f"state is a {type(state).__name__}; it must be a state of get_state")
        check_flag("the state's running", state.running)
        begun = state.steps is not None
        if begun:
            check_whole("the state's steps", state.steps, 0, MAX_STEPS)
            if isinstance(state.batch, tuple) and state.batch and state.batch[0] is None:
                raise InputError("the state has steps but no race; use a state of get_state")
        # A new generator: two environments restored from one state must not share a stream.
        generator = (
            generator_of("the state's generator", state.generator)
            if begun or state.generator is not None
            else None
        )
        self.batch.set_state(state.batch)
        self._np_random, self._steps, self._running = generator, state.steps, state.running
        return self._observe()

    def _check_started(self) -> None:
        if self._steps is None:
            raise InputError("the episode has not begun; call reset() first")


class ScalarEnv(SingleEnv, gym.Env[NDArray[np.float32], Any]):
    """Base class of single-agent environments."""

    def __init__(self, **arguments: Any) -> None:
        self._configure(arguments)
        self.observation_space = self.batch.observation_space
        self.action_space = self.batch.action_space

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new episode; without a seed the random generator continues.

        The option "state" continues from a state of `get_state`. The class docstring lists the
        other options.
        """
        self._restart(seed, options)
        self._keep_step(begun=True)
        return self._observe()[0], self.batch.info(0)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Make a step; the class docstring describes the actions."""
        observations, rewards, ended, late = self._advance(self.batch.check_actions(action, ()))
        self._keep_step()
        return observations[0], float(rewards[0]), ended, late, self.batch.info(0)

    def outcome(self) -> dict[str, Any]:
        """Return the current info with labels in place of codes."""
        self._check_started()
        return words(self.batch.info(0), self.batch.codes)

    def set_state(self, state: EnvState) -> NDArray[np.float32]:
        """Continue from a state of `get_state`, and return its observation."""
        seen: NDArray[np.float32] = super().set_state(state)[0]
        if self._steps is not None:
            self._keep_step(begun=True)
        return seen

    def _keep_step(self, *, begun: bool = False) -> None:
        """Store the last step for a film, if steps are filmed; ``begun`` discards earlier steps."""


class ParallelBatchEnv(SingleEnv, ParallelEnv[str, NDArray[np.float32], Any]):
    """Base class of multi-agent environments.

    All agents act in every step, and all end with the episode; then `agents` is empty. An
    `opponent` other than None drives car 1, and ``car_0`` is the only agent.
    """

    metadata: dict[str, Any] = OverBatch.metadata | {"is_parallelizable": True}
    ignored_options = ("options",)  # key in PettingZoo's API tests

    def __init__(self, *, max_cycles: int | None = None, **arguments: Any) -> None:
        if max_cycles is not None:
            check_whole("max_cycles", max_cycles, 1)
        self.max_cycles = max_cycles
        self._configure(arguments, max_cycles=max_cycles)
        self.possible_agents: list[str] = [f"car_{car}" for car in range(self.batch.players)]
        box, action = self.batch.observation_space, self.batch.action_space
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            name: copy.deepcopy(box) for name in self.possible_agents
        }
        # Each space has its own seed: samples of one agent do not change the samples of another.
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            name: copy.deepcopy(action) for name in self.possible_agents
        }
        self.state_space = spaces.Box(
            np.tile(box.low, self.batch.cars), np.tile(box.high, self.batch.cars)
        )

    def _count_players(self, options: Any) -> int:
        return 2 if options.opponent is None else 1

    @property
    def agents(self) -> list[str]:
        """Agents of the next step: all, or none after the episode."""
        return list(self.possible_agents) if self._running else []

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent; always the same object."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the action space of an agent; always the same object."""
        return self.action_spaces[self._known(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin a new episode; a seed determines the episode."""
        self._restart(seed, options)
        return self._by_agent(self._observe()), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Apply the actions of all agents, and drive a step; after the end nothing is returned."""
        self._check_started()
        agents = self.possible_agents
        if isinstance(actions, Mapping) and not (actions or self._running):
            return {}, {}, {}, {}, {}
        if not isinstance(actions, Mapping) or any(agent not in actions for agent in agents):
            raise InputError(
                f"actions are {actions!r}; they must hold an action for each of {', '.join(agents)}"
            )
        checked = self.batch.check_actions([actions[agent] for agent in agents], (len(agents),))
        observations, rewards, ended, late = self._advance(checked, self.max_cycles)
        return (
            self._by_agent(observations),
            {agent: float(reward) for agent, reward in zip(agents, rewards, strict=True)},
            dict.fromkeys(agents, ended),
            dict.fromkeys(agents, late),
            self._infos(),
        )

    def state(self) -> NDArray[np.float32]:
        """Return the observations of all cars, concatenated, with or without an agent."""
        self._check_started()
        return self.batch.both_views()[0].reshape(-1).copy()

    def outcome(self) -> dict[str, dict[str, Any]]:
        """Return the current info of each agent with labels in place of codes."""
        return {agent: words(info, self.batch.codes) for agent, info in self._infos().items()}

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the current state as an array (height, width, 3) of uint8.

        Return None if a window shows it or there is no render mode.
        """
        frame: NDArray[np.uint8] | None = None if self.render_mode is None else super().render()
        return frame

    def _by_agent(self, observations: NDArray[np.float32]) -> Observations:
        return {agent: observations[car].copy() for car, agent in enumerate(self.possible_agents)}

    def _infos(self) -> Infos:
        return {agent: self.batch.info(car) for car, agent in enumerate(self.possible_agents)}

    def _known(self, agent: str) -> str:
        if agent not in self.possible_agents:
            raise InputError(
                f"agent {agent!r} is unknown; the agents are {', '.join(self.possible_agents)}"
            )
        return agent
