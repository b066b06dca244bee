"""The control-level environment for many races at once: one compiled call for all of them."""

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive import check_rendering, draw_race
from pcs_racing.envs.drive_batch import DriveBatch, DriveOptions, Element
from pcs_racing.race.rendering import MODES, Renderer
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track

__all__ = ["DriveVectorEnv", "DriveVectorState", "renewed_generators", "split_seeds"]

Step = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class DriveVectorState(NamedTuple):
    """A moment of a :class:`DriveVectorEnv`: a value that can be kept, copied, pickled and restored."""

    races: RaceState
    opponents: NDArray[np.int64]
    generators: list[dict[str, Any]]


def split_seeds(seed: int | list[int | None] | None, num_envs: int) -> list[int | None]:
    """One seed for each environment, as Gymnasium's own vector environments split them: i more for environment i.

    Raises
    ------
    InputError
        If there are too few or too many, or one is no whole number from 0; its index is named.
    """
    if seed is None:
        return [None] * num_envs
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        seeds: list[int | None] = [int(seed) + i for i in range(num_envs)]
    else:
        try:
            seeds = list(seed)  # type: ignore[arg-type]
        except TypeError:
            raise InputError(f"seed is {seed!r}; it must be a whole number, a list of them, or None") from None
    if len(seeds) != num_envs:
        raise InputError(f"there are {len(seeds)} seeds for {num_envs} environments; give one for each")
    for i, one in enumerate(seeds):
        if one is not None and (isinstance(one, bool) or not isinstance(one, int | np.integer) or one < 0):
            raise InputError(f"the seed of environment {i} is {one!r}; it must be a whole number from 0, or None")
    return [None if one is None else int(one) for one in seeds]


def renewed_generators(
    generators: list[np.random.Generator], seed: int | list[int | None] | None, num_envs: int
) -> list[np.random.Generator]:
    """One generator for each environment: a fresh one where a seed is given or there was none, else the old one."""
    seeds = split_seeds(seed, num_envs)
    return [
        seeding.np_random(one)[0] if not generators or one is not None else generators[i] for i, one in enumerate(seeds)
    ]


def with_masks(facts: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Add to each array of an info the mask under ``_name`` that says which environments it speaks of."""
    info: dict[str, Any] = {}
    for name, values in facts.items():
        info[name] = values
        info[f"_{name}"] = mask.copy()
    return info


class DriveVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], Any]):
    """Many :class:`pcs_racing.envs.drive.DriveEnv` in one, with the same numbers for the same seeds.

    Episodes that end start anew in the same step (``AutoresetMode.SAME_STEP``): the observation returned is the first
    of the new episode, and ``info["final_obs"]`` and ``info["final_info"]`` hold what the old one ended with.
    Environment ``i`` draws its episodes from its own generator, seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Number of races.
    threads : int, optional
        Threads that share a step; the result does not depend on it. By default as many as there are cores, one for few
        environments, and one where the opponent is plain Python.
    render_mode : {"rgb_array", "human"}, optional
        `render` shows the first race.
    view : {"track", "both", "car_0", "car_1"}
        What a frame shows.
    **options
        As for :class:`pcs_racing.envs.drive.DriveEnv`.

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible; of actions and seeds the index is named.

    Examples
    --------
    >>> envs = DriveVectorEnv(16, opponent=None)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (16, 41)
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(MODES),
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int | None = None,
        render_mode: str | None = None,
        view: str = "both",
        **options: Any,
    ) -> None:
        names = [field.name for field in fields(DriveOptions)]
        for name in options:
            if name not in names:
                raise InputError(f"argument {name!r} is unknown; there are {', '.join(names)}")
        check_rendering(render_mode, view)
        self.render_mode, self.view = render_mode, view
        self._options, self._threads = DriveOptions(**options), threads
        self._batch = DriveBatch(num_envs, self._options, threads=threads)
        self.num_envs = self._batch.races
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self._options.time_step))}
        self.single_observation_space = spaces.Box(self._batch.low, self._batch.high, dtype=np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._rngs: list[np.random.Generator] = []
        self._all = np.ones(self.num_envs, np.bool_)
        self._renderer: Renderer | None = None

    @property
    def elements(self) -> list[Element]:
        """Name, unit, bounds and meaning of every element of a single observation."""
        return list(self._batch.elements)

    @property
    def track(self) -> Track:
        """The circuit."""
        return self._batch.track

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start a new episode in every race.

        Parameters
        ----------
        seed : int or list of int, optional
            Environment ``i`` begins anew with ``seed + i``, or with its entry of the list; where it is None the
            generator goes on.
        options : dict, optional
            Ignored.
        """
        self._rngs = renewed_generators(self._rngs, seed, self.num_envs)
        rows = np.arange(self.num_envs)
        self._batch.restart(rows, self._rngs)
        out = np.empty((self.num_envs, len(self._batch.low)), np.float32)
        self._batch.observe(rows, out)
        if self.render_mode == "human":
            self.render()
        return out, with_masks(self._batch.facts(slice(None)), self._all)

    def step(self, actions: NDArray[np.float32]) -> Step:
        """Drive every race one step on.

        Parameters
        ----------
        actions : array_like, shape (num_envs, 2)
            Steering and speed in [-1, 1].

        Returns
        -------
        observations : ndarray of float32, shape (num_envs, n)
        rewards : ndarray of float64, shape (num_envs,)
        terminations, truncations : ndarray of bool, shape (num_envs,)
        info : dict
        """
        values = self._batch.check_actions(actions, (self.num_envs, 2))
        if not self._rngs:
            raise InputError("the episodes have not begun; call reset() before step()")
        observations, rewards, terminated, truncated = self._batch.step(values)
        over = terminated | truncated
        final: dict[str, Any] = {}
        if over.any():
            rows = np.flatnonzero(over)
            last = np.full(self.num_envs, None, dtype=object)
            for i in rows:
                last[i] = observations[i].copy()
            final_info = with_masks(self._batch.facts(slice(None)), over)
            final = {"final_obs": last, "_final_obs": over, "final_info": final_info, "_final_info": over.copy()}
            self._batch.restart(rows, [self._rngs[i] for i in rows])
            self._batch.observe(rows, observations)
        if self.render_mode == "human":
            self.render()
        info = with_masks(self._batch.facts(slice(None)), self._all)
        return observations, rewards, terminated, truncated, info | final

    def render(self) -> Any:
        """Return a tuple with a frame of the first race (``"rgb_array"``), or show it (``"human"``)."""
        if self.render_mode is None:
            raise InputError("render_mode is None; make the environment with render_mode='rgb_array' or 'human'")
        if not self._rngs:
            raise InputError("there is nothing to render before reset()")
        if self._renderer is None:
            self._renderer = Renderer(
                self.track, mode=self.render_mode, view=self.view, fps=float(self.metadata["render_fps"])
            )
        frame = draw_race(self._renderer, self._batch, 0)
        return None if frame is None else (frame,)

    def close_extras(self, **kwargs: Any) -> None:
        """Let threads and the window go."""
        self._batch.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def get_state(self) -> DriveVectorState:
        """Return all that the rest of the episodes, and all later ones, depend on."""
        races, opponents = self._batch.get_state()
        return DriveVectorState(races, opponents, [dict(rng.bit_generator.state) for rng in self._rngs])

    def set_state(self, state: DriveVectorState) -> NDArray[np.float32]:
        """Go on from what `get_state` returned, here or in an environment with equal arguments.

        Returns the observations at that moment.
        """
        if not isinstance(state, DriveVectorState):
            raise InputError(f"state is a {type(state).__name__}; it must be what get_state returned")
        self._batch.set_state(state.races, state.opponents)
        self._rngs = [seeding.np_random(0)[0] for _ in state.generators]
        for rng, given in zip(self._rngs, state.generators, strict=True):
            rng.bit_generator.state = given
        out = np.empty((self.num_envs, len(self._batch.low)), np.float32)
        self._batch.observe(np.arange(self.num_envs), out)
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        options = {field.name: getattr(self._options, field.name) for field in fields(DriveOptions)}
        options |= {"threads": self._threads, "render_mode": self.render_mode, "view": self.view}
        return _rebuild, (type(self), self.num_envs, options, self.get_state())

    def __deepcopy__(self, memo: dict[int, Any]) -> "DriveVectorEnv":
        function, arguments = self.__reduce__()
        return function(*arguments)


def _rebuild(
    kind: type[DriveVectorEnv], num_envs: int, options: dict[str, Any], state: DriveVectorState
) -> DriveVectorEnv:
    env = kind(num_envs, **options)
    env.set_state(state)
    return env
