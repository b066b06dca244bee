"""Vector environment of Gymnasium over a batch of episodes, with all three autoreset modes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, as_array, check_seed, check_whole, is_whole
from pcs_racing.envs.batch import FREE, MAX_STEPS, check_part, check_within, generator_of
from pcs_racing.envs.infos import rows_of, words
from pcs_racing.envs.over_batch import Batch, OverBatch

VectorStep = tuple[
    NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
]


class VectorState(NamedTuple):
    """Full state of a :class:`BatchVectorEnv`; it can be stored, copied, pickled and restored."""

    batch: tuple[Any, ...]  #: State of the batch.
    generators: list[dict[str, Any]]  #: State of each episode's random generator.
    over: NDArray[np.bool_]  #: shape (episodes,): Finished episodes, to be reset.
    steps: NDArray[np.int64]  #: shape (episodes,): Steps since the start of each episode.


class BatchVectorEnv(OverBatch, VectorEnv[NDArray[np.float32], NDArray[Any], Any]):
    """Base class of vector environments.

    Episode ``i`` draws from its own generator, seeded with ``seed + i``, with the same numbers as
    the single-agent environment with this seed. ``autoreset_mode`` defines the behaviour after the
    end of an episode:

    - ``NEXT_STEP`` (Gymnasium's default): the next step begins a new episode; its action is ignored
      and its reward is 0;
    - ``SAME_STEP``: a new episode begins at once; the step returns its first observation, and
      ``info["final_obs"]`` and ``info["final_info"]`` hold the end of the old episode;
    - ``DISABLED``: no step is possible until ``reset(options={"reset_mask": mask})`` begins new
      episodes where the mask is true.

    Parameters
    ----------
    num_envs : int
        Number of environments; self-play has two for each episode.
    autoreset_mode : AutoresetMode or str
    max_episode_steps : int, optional
        Number of steps until truncation, in addition to the episode's own end.
    threads : int, optional
        Max number of threads of a step, all cores by default; the result does not depend on it.
    **arguments
        Arguments of the scalar environment; `render` returns a frame for each environment.
    """

    metadata: dict[str, Any] = OverBatch.metadata | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        **arguments: Any,
    ) -> None:
        if max_episode_steps is not None:
            check_whole("max_episode_steps", max_episode_steps, 1)
        self.autoreset_mode = check_autoreset_mode(autoreset_mode)
        self.max_episode_steps = max_episode_steps
        self._configure(
            arguments,
            num_envs=num_envs,
            autoreset_mode=self.autoreset_mode,
            max_episode_steps=max_episode_steps,
            threads=threads,
        )
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.num_envs = self.batch.episodes * self.players
        self.single_observation_space = self.batch.observation_space
        self.single_action_space = self.batch.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._generators: list[np.random.Generator] = []
        self._over = np.zeros(self.batch.episodes, np.bool_)
        self._steps = np.zeros(self.batch.episodes, np.int64)

    def _make_batch(self, options: Any) -> Batch:
        players = self.players = self._count_players(options)
        count: Any = self._own["num_envs"]
        count = players if count is None else count
        if is_whole(count) and count % players:
            wanted = "even" if players == 2 else f"a multiple of {players}"
            raise InputError(
                f"num_envs is {count}; it must be {wanted}: {players} environments belong to each"
                " game"
            )
        # Other types are passed on, so the batch's own check reports them.
        episodes = count // players if is_whole(count) else count
        return self.batch_type(episodes, options, threads=self._own["threads"], players=players)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: Mapping[str, Any] | list[Mapping[str, Any]] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin new episodes.

        Parameters
        ----------
        seed : int or list of int, optional
            Seed of the generators: ``seed + i`` or an entry of the list for episode ``i``; with
            None the generator continues.
        options : dict, or list of dict, optional
            "reset_mask" (bool, shape (num_envs,)) begins new episodes only where it is true.
            The class docstring lists the other options. A list holds the options of each episode,
            without a mask.
        """
        if isinstance(options, list):
            if len(options) != self.batch.episodes:
                raise InputError(
                    f"options list {len(options)} dicts; give one for each of {self.batch.episodes}"
                    " episodes"
                )
            same = {id(one): one for one in options}  # one call for each dict
            parts = [
                (np.flatnonzero([each is one for each in options]), self._reset_options(one))
                for one in same.values()
            ]
        else:
            given = self._reset_options(options, "reset_mask")
            parts = [(self._masked(given.pop("reset_mask", None)), given)]
        rows = np.concatenate([some for some, _ in parts])
        # Stored only after all episodes have begun: a refused reset keeps the former seeds.
        seeds = _split_seeds(seed, self.batch.episodes)
        generators = [
            (
                seeding.np_random(one)[0]
                if not self._generators or one is not None
                else self._generators[i]
            )
            for i, one in enumerate(seeds)
        ]
        with self.unless_refused():
            seeded = np.flatnonzero([one is not None for one in seeds])
            self.batch.randomization.circuits.forget(seeded)
            for some, given in parts:
                self.batch.restart(some, [generators[i] for i in some], given)
        self._generators = generators
        self._over[rows], self._steps[rows] = False, 0
        if self.render_mode == "human":
            self.render()
        return self._observations(), self._infos()

    def step(self, actions: NDArray[Any]) -> VectorStep:
        """Make a step in every environment; the single-agent class describes the actions."""
        checked: NDArray[Any] = self.batch.check_actions(actions, (self.num_envs,))
        self._check_started()
        again = np.flatnonzero(self._over)
        if len(again) and self.autoreset_mode is AutoresetMode.DISABLED:
            raise InputError(
                f"the episode of environment {again[0] * self.players} has ended; call "
                "reset(options={'reset_mask': mask}) before step()"
            )
        generators = self._generators
        if len(again):  # a finished episode must not draw from the generator of the next episode
            generators = [
                np.random.default_rng(0) if over else generators[i]
                for i, over in enumerate(self._over)
            ]
        observations, rewards, terminated, truncated = self._step_batch(
            checked, generators, ~self._over
        )
        self._steps += 1
        if self.max_episode_steps is not None:
            truncated |= (
                np.repeat(self._steps >= self.max_episode_steps, self.players) & ~terminated
            )
        # NEXT_STEP: the step after the end of an episode only begins the next episode.
        if len(again):
            self._restart(again, observations)
            begun = np.repeat(self._over, self.players)
            rewards[begun], terminated[begun], truncated[begun] = 0.0, False, False
        over = terminated | truncated
        # All players of an episode end with it.
        self._over = over[:: self.players].copy()
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            # Before the restart, which overwrites the last observations with the first.
            final = self._final(observations, over)
            self._restart(np.flatnonzero(self._over), observations)
            self._over[:] = False
        if self.render_mode == "human":
            self._show_step()
        return observations, rewards, terminated, truncated, self._infos() | final

    @property
    def np_random(self) -> Any:
        """Random generators of the episodes, as in Gymnasium's own vector environments."""
        return tuple(self._generators)

    @np_random.setter
    def np_random(self, value: Any) -> None:
        raise InputError("each episode has a generator of its own; reset(seed=...) sets them")

    def outcome(self) -> list[dict[str, Any]]:
        """Return the current info of each environment with labels in place of codes."""
        self._check_started()
        return [words(info, self.batch.codes) for info in rows_of(self.batch.infos())]

    def render(self) -> Any:
        """Return frames of all environments (``"rgb_array"``), or show the first (``"human"``)."""
        if self.render_mode == "human":
            return self.frame(0)
        return tuple(self.frame(i) for i in range(self.num_envs))

    def frame(self, environment: int) -> NDArray[np.uint8] | None:
        """Return a frame of one environment, or show it in the window."""
        return self.batch.draw(self._open_renderer(), environment)

    def close_extras(self, **kwargs: Any) -> None:
        """Free threads and close the window."""
        if not hasattr(self, "batch"):  # old Gymnasium closes failed environments as well
            return
        self.batch.close()
        self._close_renderer()

    def get_state(self) -> VectorState:
        """Return the full state, which determines the current and all later episodes."""
        generators = [dict(generator.bit_generator.state) for generator in self._generators]
        return VectorState(
            self.batch.get_state(), generators, self._over.copy(), self._steps.copy()
        )

    def check_state(self, state: VectorState) -> list[np.random.Generator]:
        """Refuse a state that `get_state` can't have returned; the batch is not checked.

        Return the generators of the episodes.
        """
        if not isinstance(state, VectorState):
            raise InputError(f"state is a {type(state).__name__}; it must be a state of get_state")
        unused = isinstance(state.generators, list) and not state.generators
        count = 0 if unused else self.batch.episodes
        check_part("the state", state, VectorState(FREE, [FREE] * count, self._over, self._steps))
        check_within("the state's steps", state.steps, 0, MAX_STEPS)
        return [
            generator_of(f"the state's generator {i}", given)
            for i, given in enumerate(state.generators)
        ]

    def set_state(self, state: VectorState) -> NDArray[np.float32]:
        """Continue from a state of `get_state`; return its observations, shape (num_envs, D)."""
        generators = self.check_state(state)
        self.batch.set_state(state.batch)
        self._generators = generators
        self._over, self._steps = state.over.copy(), state.steps.copy()
        return self._observations()

    def _check_started(self) -> None:
        if self.closed:
            raise InputError("the environments were closed; make new ones")
        if not self._generators:
            raise InputError("the episodes have not begun; call reset() first")

    def _masked(self, mask: Any) -> NDArray[np.int64]:
        """Return the episodes selected by a mask of environments."""
        if mask is None:
            return np.arange(self.batch.episodes)
        given = as_array(mask)
        if given.shape != (self.num_envs,) or given.dtype != np.bool_:
            raise InputError(
                f"reset option 'reset_mask' has shape {given.shape} and type {given.dtype}; it must"
                f" be bool of shape ({self.num_envs},)"
            )
        self._check_started()
        return np.flatnonzero(given.reshape(-1, self.players).any(axis=1))

    def _restart(self, rows: NDArray[np.int64], observations: NDArray[np.float32]) -> None:
        self.batch.restart(rows, [self._generators[i] for i in rows])
        self.batch.observe(rows, observations)
        self._steps[rows] = 0

    def _observations(self) -> NDArray[np.float32]:
        out = np.zeros((self.num_envs, *self.batch.observation_space.shape), np.float32)
        if self._generators:
            self.batch.observe(np.arange(self.batch.episodes), out)
        return out

    def _infos(self) -> dict[str, Any]:
        return _with_masks(self.batch.infos(), np.ones(self.num_envs, np.bool_))

    def _final(self, observations: NDArray[np.float32], over: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the last observations and infos of finished episodes, in Gymnasium's layout."""
        last = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(over):
            last[i] = observations[i].copy()
        final_info = _with_masks(self.batch.infos(), over)
        return {
            "final_obs": last,
            "_final_obs": over.copy(),
            "final_info": final_info,
            "_final_info": over.copy(),
        }


def _with_masks(infos: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Add to each array of an info the mask of its environments, under ``_name``."""
    masked: dict[str, Any] = {}
    for name, values in infos.items():
        masked[name] = values
        masked[f"_{name}"] = mask.copy()
    return masked


def check_autoreset_mode(mode: Any) -> AutoresetMode:
    """Return one of Gymnasium's autoreset modes."""
    for known in AutoresetMode:
        if mode is known or (isinstance(mode, str) and mode in (known.name, known.value)):
            return known
    names = ", ".join(known.name for known in AutoresetMode)
    raise InputError(f"autoreset_mode is {mode!r}; it must be one of {names}")


def _split_seeds(seed: Any, episodes: int) -> list[int | None]:
    """Return a seed for each episode, as in Gymnasium's vector environments: ``seed + i``."""
    if seed is None:
        return [None] * episodes
    if is_whole(seed):
        first = check_seed(seed)
        return [first + i for i in range(episodes)]
    try:
        seeds = list(seed)
    except TypeError:
        raise InputError(
            f"seed is {seed!r}; it must be a whole number, a list of them, or None"
        ) from None
    if len(seeds) != episodes:
        raise InputError(
            f"there are {len(seeds)} seeds for {episodes} environments; give one for each"
        )
    return [
        None if one is None else check_seed(one, f"the seed of environment {i}")
        for i, one in enumerate(seeds)
    ]
