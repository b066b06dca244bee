"""A parallel environment of PettingZoo over a batch of one episode: each car that is no opponent's is an agent."""

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.envs.batch import Batch, check_options, check_rendering, check_reset_seed
from pcs_racing.envs.infos import words
from pcs_racing.envs.over_batch import REBUILDING, OverBatch

AGENTS = ("car_0", "car_1")

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


class ParallelState(NamedTuple):
    """A moment of a :class:`ParallelBatchEnv`: a value that can be kept, copied, pickled and restored."""

    batch: tuple[Any, ...]  #: State of the batch of one episode.
    cycles: int  #: Steps since the reset.
    over: bool  #: Whether no episode goes on.
    #: State of the generator that draws the next episode; None before the first reset.
    generator: Mapping[str, Any] | None


class ParallelBatchEnv(OverBatch, ParallelEnv[str, NDArray[np.float32], Any]):
    """Base class of the environments for two agents; subclasses name the batch and document themselves.

    Both agents act in every step, and both end with the episode: from then on `agents` is empty.
    Where the argument `opponent` is not None it drives car 1, and ``car_0`` is the only agent.
    """

    def _begin(
        self,
        *,
        arguments: dict[str, Any],
        render_mode: str | None = None,
        view: str = "both",
        render_size: tuple[int, int] = (960, 640),
        max_cycles: int | None = None,
    ) -> None:
        check_rendering(render_mode, view)
        if max_cycles is not None:
            check_whole("max_cycles", max_cycles, 1)
        self.render_mode, self.view, self.render_size = render_mode, view, render_size
        self.max_cycles = max_cycles
        self._arguments = arguments
        self._use(self._make_batch(arguments))
        self.possible_agents = list(AGENTS[: self.batch.players])
        self.agents: list[str] = []
        box, action = self.batch.observation_space, self.batch.action_space
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(box.low, box.high) for name in self.possible_agents
        }
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            name: copy.deepcopy(action) for name in self.possible_agents
        }
        self.state_space = spaces.Box(np.tile(box.low, 2), np.tile(box.high, 2))
        self._generator: np.random.Generator | None = None
        self._cycles = 0

    def _make_batch(self, arguments: dict[str, Any]) -> Batch:
        players = 2 if arguments["opponent"] is None else 1
        batch: Batch = self.batch_type(1, threads=1, players=players, **arguments)
        return batch

    def _use(self, batch: Batch) -> None:
        self.batch = batch
        self.metadata = {**type(self).metadata, "codes": batch.codes}

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy everything but the window."""
        return {**self.__dict__, "_renderer": None}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Observation space of an agent; always the same object."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Action space of an agent; always the same object."""
        return self.action_spaces[self._known(agent)]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin a new episode; with a seed, the one that belongs to it."""
        number = check_reset_seed(seed)
        given = check_options(options, (*REBUILDING, "state", "options", *self.batch.reset_options))
        given.pop("options", None)  # what the API tests of PettingZoo hand over to every environment
        state = given.pop("state", None)
        if state is not None:
            if given or number is not None:
                raise InputError("reset option 'state' was given with others or a seed; it leaves nothing to choose")
            self.set_state(state)
            return self._observations(), self._infos()
        changes = {name: given.pop(name) for name in REBUILDING if name in given}
        batch = self._make_batch({**self._arguments, **changes}) if changes else self.batch
        if batch.players != len(self.possible_agents):
            raise InputError("reset option 'opponent' needs an environment that was made with an opponent")
        generator = self._generator
        if number is not None or generator is None:
            generator = np.random.default_rng(number)
        row = np.zeros(1, np.int64)
        if number is not None:
            batch.forget(row)
        batch.restart(row, [generator], given)
        if changes:
            self.close()
            self._arguments = {**self._arguments, **changes}
            self._use(batch)
        self._generator, self._cycles = generator, 0
        self.agents = list(self.possible_agents)
        if self.render_mode == "human":
            self.render()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let all agents act, and drive a step."""
        self._check_started()
        if not self.agents:
            raise InputError("the episode is over; call reset() to begin a new one")
        agents = self.possible_agents
        if not isinstance(actions, Mapping) or any(agent not in actions for agent in agents):
            raise InputError(f"actions are {actions!r}; they must hold an action for each of {', '.join(agents)}")
        checked = self.batch.check_actions([actions[agent] for agent in agents], (len(agents),))
        done = self.batch.step(checked, [self._generator or np.random.default_rng()])
        self._cycles += 1
        over = bool(done.terminated[0])
        late = self.max_cycles is not None and self._cycles >= self.max_cycles
        cut = not over and (late or bool(done.truncated[0]))
        if over or cut:
            self.agents = []
        if self.render_mode == "human":
            self._show_step()
        return (
            {agent: done.observations[car].copy() for car, agent in enumerate(agents)},
            {agent: float(reward) for agent, reward in zip(agents, done.rewards, strict=True)},
            dict.fromkeys(agents, over),
            dict.fromkeys(agents, cut),
            self._infos(),
        )

    def state(self) -> NDArray[np.float32]:
        """Observations of both cars, one after the other, whoever drives them."""
        raise NotImplementedError

    def outcome(self) -> dict[str, dict[str, Any]]:
        """Return the info of each agent at this moment in words, for people."""
        return {agent: words(info, self.batch.codes) for agent, info in self._infos().items()}

    # The environment as a value

    def get_state(self) -> ParallelState:
        """Return everything that the future of this environment depends on, as an independent value."""
        generator = None if self._generator is None else self._generator.bit_generator.state
        return ParallelState(self.batch.get_state(), self._cycles, not self.agents, generator)

    def set_state(self, state: ParallelState) -> None:
        """Continue from a moment that :meth:`get_state` of an environment with the same arguments returned."""
        if not isinstance(state, ParallelState):
            raise InputError(f"state is of type {type(state).__name__}; it must be what get_state() returned")
        generator = None
        if state.generator is not None:
            generator = np.random.default_rng()
            try:
                generator.bit_generator.state = state.generator
            except (TypeError, ValueError, KeyError) as error:
                raise InputError(f"the state's random generator can't be restored: {error}") from None
        self.batch.set_state(state.batch)
        self._generator, self._cycles = generator, state.cycles
        self.agents = [] if state.over else list(self.possible_agents)

    # Pictures

    def render(self) -> NDArray[np.uint8] | None:
        """Draw this moment: an array (height, width, 3) of uint8; None where a window shows it or nothing is drawn."""
        if self.render_mode is None:
            return None
        return self.batch.draw(self._open_renderer(), 0)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._close_renderer()

    # What the agents observe

    def _observations(self) -> Observations:
        seen = np.zeros((self.batch.players, *self.batch.observation_space.shape), np.float32)
        if self._generator is not None:
            self.batch.observe(np.zeros(1, np.int64), seen)
        return {agent: seen[car].copy() for car, agent in enumerate(self.possible_agents)}

    def _infos(self) -> Infos:
        return {agent: self.batch.info(car) for car, agent in enumerate(self.possible_agents)}

    def _check_started(self) -> None:
        if self._generator is None:
            raise InputError("the episode has not begun; call reset() first")

    def _known(self, agent: str) -> str:
        if agent not in self.possible_agents:
            raise InputError(f"agent {agent!r} is unknown; the agents are {', '.join(self.possible_agents)}")
        return agent
