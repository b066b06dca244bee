"""Vector environment of Stable-Baselines3 over compiled batches.

Seeds, last observations and time limits are exact. Only this module imports Stable-Baselines3:
``pip install "pcs-racing[learning]"``.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, UnknownNameError, check_whole
from pcs_racing.envs.batch import FREE, check_part, check_weights
from pcs_racing.envs.drive import DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv, SelfPlayVectorEnv
from pcs_racing.envs.infos import rows_of
from pcs_racing.envs.line import LineHeadToHeadVectorEnv, LineVectorEnv
from pcs_racing.envs.over_batch import refuse
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.track.track import Track

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        'pcs_racing.envs.sb3 needs Stable-Baselines3: pip install "pcs-racing[learning]"'
    ) from error

KINDS: dict[str, type[Any]] = {
    "duel": DuelVectorEnv,
    "drive": DriveVectorEnv,
    "self-play": SelfPlayVectorEnv,
    "drive-self-play": DriveHeadToHeadVectorEnv,
    "line": LineVectorEnv,
    "line-self-play": LineHeadToHeadVectorEnv,
    "pcs_racing/Duel-v1": DuelVectorEnv,
    "pcs_racing/Drive-v1": DriveVectorEnv,
    "pcs_racing/head_to_head-v1": SelfPlayVectorEnv,
    "pcs_racing/drive_head_to_head-v0": DriveHeadToHeadVectorEnv,
    "pcs_racing/Line-v0": LineVectorEnv,
    "pcs_racing/line_head_to_head-v0": LineHeadToHeadVectorEnv,
}
"""Vector environments by name."""

SHARED = ("elements", "game", "metadata", "opponents", "options", "render_mode", "spec")
"""Attributes shared by the environments of a batch."""


def make_sb3_vec_env(kind: str = "duel", num_envs: int = 16, **arguments: Any) -> "SB3VecEnv":
    """Make a vector environment for Stable-Baselines3.

    Parameters
    ----------
    kind : str
        "duel" or "pcs_racing/Duel-v1"; "drive" or "pcs_racing/Drive-v1". In "self-play" or
        "pcs_racing/head_to_head-v1" both cars of ``num_envs / 2`` games belong to the learner,
        whose policy plays against itself; "drive-self-play" or
        "pcs_racing/drive_head_to_head-v0": self-play at the control level. "line" and
        "line-self-play": the same with a choice among candidates.
    num_envs : int
        Number of environments; even for self-play.
    **arguments
        Arguments of the environment.

    Examples
    --------
    >>> env = make_sb3_vec_env("duel", 4, opponent="never-switch")
    >>> env.reset().shape
    (4, 31)
    """
    if kind not in KINDS:
        raise UnknownNameError(f"environment {kind!r} is unknown; there are {', '.join(KINDS)}")
    return SB3VecEnv(KINDS[kind](num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments))


class SB3VecEnv(VecEnv):
    """Vector environment of Stable-Baselines3 over one or several compiled batches.

    Each environment behaves like the single-agent environment in a ``DummyVecEnv`` behind a
    ``Monitor``. ``infos`` hold the info of the step and ``TimeLimit.truncated``, and at the end of
    an episode ``terminal_observation`` and ``episode`` (return ``r``, length ``l``, time ``t``), so
    no Monitor is needed.

    Parameters
    ----------
    envs : BatchVectorEnv, or sequence of BatchVectorEnv
        Batches such as :class:`DuelVectorEnv`, with ``autoreset_mode="SAME_STEP"``, all with the
        same spaces.
    seeds : sequence of int, optional
        Seed of each batch at every reset, in place of the seed given to `seed`.
    reward_scale : float
        Factor of the rewards.
    threads : int
        Number of batches stepped at the same time; the results do not depend on it. By default the
        batches are stepped one after the other, each on its own threads.
    """

    def __init__(
        self,
        envs: BatchVectorEnv | Sequence[BatchVectorEnv],
        *,
        seeds: Sequence[int] | None = None,
        reward_scale: float = 1.0,
        threads: int = 1,
    ) -> None:
        check_whole("threads", threads, 1)
        self.groups: list[Any] = list(envs) if isinstance(envs, list | tuple) else [envs]
        for group in self.groups:
            if (
                not isinstance(group, BatchVectorEnv)
                or group.autoreset_mode is not AutoresetMode.SAME_STEP
            ):
                raise InputError(
                    f"envs hold a {type(group).__name__}; they must be environments such as"
                    " DuelVectorEnv or DriveVectorEnv, with autoreset_mode='SAME_STEP'"
                )
        first = self.groups[0]
        self._group_seeds, self._scale = seeds, reward_scale
        self._pool = ThreadPoolExecutor(threads) if min(threads, len(self.groups)) > 1 else None
        self._edges = np.cumsum([0, *(group.num_envs for group in self.groups)])
        self._actions: Any = None
        self._returns = np.zeros(int(self._edges[-1]))
        self._lengths = np.zeros(len(self._returns), np.int64)
        self._began = time.time()
        self._each = [OneOfBatch(group, i) for group in self.groups for i in range(group.num_envs)]
        super().__init__(
            len(self._returns), first.single_observation_space, first.single_action_space
        )

    def reset(self) -> NDArray[np.float32]:
        """Begin new episodes in all environments, with the latest `seed` and `set_options`.

        Seeds and options hold for one reset. The players of an episode share its options.
        """
        observations: list[NDArray[np.float32]] = []
        infos: list[dict[str, Any]] = []
        with ExitStack() as stack:  # if one batch refuses, all stay unchanged
            for k, group in enumerate(self.groups):
                stack.enter_context(group.unless_refused())
                # Stable-Baselines3 has a seed for each environment, self-play a seed for each pair.
                own: Any = self._seeds[self._edges[k] : self._edges[k + 1] : group.players]
                if self._group_seeds is not None:
                    own = self._group_seeds[k]
                options = self._options[self._edges[k] : self._edges[k + 1]]
                shared = options[:: group.players]
                for i, one in enumerate(options):
                    if (
                        one
                        and one is not shared[i // group.players]
                        and repr(one) != repr(shared[i // group.players])
                    ):
                        raise InputError(
                            f"options of environment {self._edges[k] + i} differ from the options"
                            " of its race"
                        )
                seen, info = group.reset(seed=own, options=shared if any(shared) else None)
                observations.append(seen)
                infos += rows_of(info)
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = infos
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return np.concatenate(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Make a step with the stored actions."""
        pieces = np.split(self._actions, self._edges[1:-1])
        steps = self._step_groups(pieces)
        observations, rewards, terminated, truncated = (
            np.concatenate([step[i] for step in steps]) for i in range(4)
        )
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        late = truncated & ~terminated
        infos: list[dict[str, Any]] = []
        for first, step in zip(self._edges, steps, strict=False):
            infos += rows_of({**step[4], "TimeLimit.truncated": np.zeros(len(step[1]), np.bool_)})
            if "final_info" not in step[4]:
                continue
            rows = np.flatnonzero(step[4]["_final_info"]).tolist()
            begun, finals = rows_of(step[4], rows), rows_of(step[4]["final_info"], rows)
            for row, new, final in zip(rows, begun, finals, strict=True):
                i = first + row
                self.reset_infos[i] = new
                infos[i] = {
                    **final,
                    "TimeLimit.truncated": bool(late[i]),
                    "terminal_observation": step[4]["final_obs"][row],
                    "episode": {
                        "r": float(self._returns[i]),
                        "l": int(self._lengths[i]),
                        "t": round(time.time() - self._began, 6),
                    },
                }
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return observations, (rewards * self._scale).astype(np.float32), done, infos

    def set_opponent_weights(self, weights: ArrayLike) -> None:
        """Set the weights of the opponents, one for each, for the episodes that begin from now on.

        All batches must have the same number of opponents.
        """
        checked = [check_weights(weights, group.batch.weights) for group in self.groups]
        for group, own in zip(self.groups, checked, strict=True):
            group.batch.weights = own

    def set_opponent(self, index: int, policy: Any) -> None:
        """Replace an opponent in all batches; see :meth:`DriveVectorEnv.set_opponent`."""
        for group in self.groups:
            group.set_opponent(index, policy)

    def _step_groups(self, actions: Sequence[NDArray[Any]]) -> list[Any]:
        if self._pool is None:
            return [group.step(own) for group, own in zip(self.groups, actions, strict=True)]
        # The largest batch comes first: no thread starts it last.
        order = sorted(range(len(self.groups)), key=lambda k: -self.groups[k].num_envs)
        steps = {k: self._pool.submit(self.groups[k].step, actions[k]) for k in order}
        return [steps[k].result() for k in range(len(self.groups))]

    def get_state(self) -> tuple[Any, ...]:
        """Return the full state of all episodes, with their returns and lengths."""
        return (
            [group.get_state() for group in self.groups],
            self._returns.copy(),
            self._lengths.copy(),
        )

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Continue from a state of `get_state`."""
        check_part("the state", state, ([FREE] * len(self.groups), self._returns, self._lengths))
        for group, own in zip(self.groups, state[0], strict=True):
            group.check_state(own)
            group.batch.check_state(own.batch)
        for group, own in zip(self.groups, state[0], strict=True):
            group.set_state(own)
        self._returns[:], self._lengths[:] = state[1:]

    def close(self) -> None:
        """Free threads and windows."""
        if self._pool is not None:
            self._pool.shutdown()
        for group in self.groups:
            group.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of each requested environment."""
        return [getattr(self._each[i], attr_name) for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set a new attribute in each requested environment, for `get_attr`.

        The environment's own attributes can't be changed.
        """
        if attr_name in self.groups[0].options_type.defaults():
            refuse(attr_name)
        if attr_name in SHARED or attr_name.startswith("_") or hasattr(OneOfBatch, attr_name):
            raise InputError(
                f"{attr_name!r} can't be set for single environments of a batch; make another one"
            )
        for i in self._get_indices(indices):
            setattr(self._each[i], attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of each requested environment."""
        return [
            method(*method_args, **method_kwargs) for method in self.get_attr(method_name, indices)
        ]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return whether each environment acts as wrapped: True only for Monitor and its bases."""
        return [issubclass(Monitor, wrapper_class) for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a frame of each environment, if they render."""
        if self.groups[0].render_mode != "rgb_array":
            return [None for _ in range(self.num_envs)]
        return [frame for group in self.groups for frame in group.render()]


class OneOfBatch:
    """Environment of a batch, with the attributes and methods of a single-agent environment.

    ``reset``, ``step``, ``close``, ``get_state`` and ``set_state`` concern the whole batch and are
    methods of :class:`SB3VecEnv` only.
    """

    def __init__(self, group: Any, row: int) -> None:
        self._group, self._row, self._episode = group, row, row // group.players

    def __getattr__(self, name: str) -> Any:
        if name not in SHARED:
            raise AttributeError(
                f"one environment of a batch has no attribute {name!r}; its batch is in"
                " SB3VecEnv.groups"
            )
        return getattr(self._group, name)

    @property
    def unwrapped(self) -> "OneOfBatch":
        """Environment without wrappers: itself."""
        return self

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """Observation space of the environment."""
        return self._group.single_observation_space

    @property
    def action_space(self) -> spaces.Space[Any]:
        """Action space of the environment."""
        return self._group.single_action_space

    @property
    def track(self) -> Track:
        """Track of its episode, with the obstacles."""
        return self._group.batch.randomization.track(self._episode)

    @property
    def action_masks(self) -> Callable[[], NDArray[np.bool_]]:
        """Method for the mask of valid moves, shape (M,)."""
        if not hasattr(self._group, "action_masks"):
            raise AttributeError("the control level has no action masks")
        return lambda: self._group.action_masks()[self._row]

    def outcome(self) -> dict[str, Any]:
        """Return the current info with labels in place of codes."""
        return self._group.outcome()[self._row]

    def render(self) -> Any:
        """Return a frame; a window shows the first environment of a batch."""
        return None if self.render_mode == "human" and self._row else self._group.frame(self._row)
