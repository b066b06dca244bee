"""Stable-Baselines3's vector environment over our compiled batches: seeds, last observations and time limits right.

This module is the only one that imports Stable-Baselines3: ``pip install "pcs-racing[learning]"``.
"""

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.envs.drive import DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv, SelfPlayVectorEnv
from pcs_racing.envs.match import MatchVectorEnv, SelfPlayMatchVectorEnv
from pcs_racing.envs.vector import BatchVectorEnv

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError('pcs_racing.envs.sb3 needs Stable-Baselines3: pip install "pcs-racing[learning]"') from error

KINDS: dict[str, type[Any]] = {
    "duel": DuelVectorEnv,
    "drive": DriveVectorEnv,
    "self-play": SelfPlayVectorEnv,
    "match": MatchVectorEnv,
    "drive-self-play": DriveHeadToHeadVectorEnv,
    "match-self-play": SelfPlayMatchVectorEnv,
    "pcs_racing/Duel-v1": DuelVectorEnv,
    "pcs_racing/Drive-v1": DriveVectorEnv,
    "pcs_racing/Match-v0": MatchVectorEnv,
    "pcs_racing/head_to_head-v1": SelfPlayVectorEnv,
    "pcs_racing/drive_head_to_head-v0": DriveHeadToHeadVectorEnv,
    "pcs_racing/head_to_head_match-v0": SelfPlayMatchVectorEnv,
}
"""What can be made, by name."""


def make_sb3_vec_env(kind: str = "duel", num_envs: int = 16, **arguments: Any) -> "SB3VecEnv":
    """Make a vector environment for Stable-Baselines3.

    Parameters
    ----------
    kind : str
        "duel" or "pcs_racing/Duel-v1"; "match" or "pcs_racing/Match-v0"; "drive" or "pcs_racing/Drive-v1"; "self-play"
        or "pcs_racing/head_to_head-v1": both cars of ``num_envs / 2`` games belong to the learner, whose policy plays
        against itself; "drive-self-play" or "pcs_racing/drive_head_to_head-v0": the same at the level of steering and
        speed; "match-self-play" or "pcs_racing/head_to_head_match-v0": the same in matches.
    num_envs : int
        Number of environments; even for self-play.
    **arguments
        Of the environment.

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
    """One or several compiled batches as a vector environment of Stable-Baselines3.

    ``infos`` hold, where an episode ended, its last info, ``terminal_observation``, ``TimeLimit.truncated`` and
    ``episode`` (return ``r``, length ``l``, time ``t``), so no Monitor is needed.

    Parameters
    ----------
    envs : BatchVectorEnv, or sequence of them
        Such as :class:`DuelVectorEnv`, with ``autoreset_mode="SAME_STEP"``, and all with the same spaces.
    seeds : sequence of int, optional
        Seed of each batch at every reset, in place of what `seed` was called with.
    reward_scale : float
        What rewards are multiplied by.
    threads : int
        Batches that are stepped at the same time; the results do not depend on it. By default one after the other,
        each on its own threads.
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
            if not isinstance(group, BatchVectorEnv) or group.autoreset_mode is not AutoresetMode.SAME_STEP:
                raise InputError(
                    f"envs hold a {type(group).__name__}; they must be environments such as DuelVectorEnv or "
                    "DriveVectorEnv, with autoreset_mode='SAME_STEP'"
                )
        first = self.groups[0]
        self._group_seeds, self._scale = seeds, reward_scale
        self._pool = ThreadPoolExecutor(threads) if min(threads, len(self.groups)) > 1 else None
        self._edges = np.cumsum([0, *(group.num_envs for group in self.groups)])
        self._actions: Any = None
        self._returns = np.zeros(int(self._edges[-1]))
        self._lengths = np.zeros(len(self._returns), np.int64)
        self._began = time.time()
        super().__init__(len(self._returns), first.single_observation_space, first.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begin new episodes everywhere, with the seeds that `seed` set if they are new."""
        observations = []
        self.reset_infos = []
        for k, group in enumerate(self.groups):
            # Stable-Baselines3 has a seed for each environment, self-play one for each pair.
            own: Any = self._seeds[self._edges[k] : self._edges[k + 1] : group.players]
            if self._group_seeds is not None:
                own = self._group_seeds[k]
            seen, info = group.reset(seed=own)
            observations.append(seen)
            self.reset_infos += _infos(info, range(group.num_envs))
        # As its own vector environments: seeds and options hold for one reset.
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return np.concatenate(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Make the step."""
        pieces = np.split(self._actions, self._edges[1:-1])
        steps = self._step_groups(pieces)
        observations, rewards, terminated, truncated = (np.concatenate([step[i] for step in steps]) for i in range(4))
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for first, step in zip(self._edges, steps, strict=False):
            rows = np.flatnonzero(step[2] | step[3])
            if len(rows) == 0:
                continue
            for row, final in zip(rows, _infos(step[4]["final_info"], rows), strict=True):
                i = first + row
                elapsed = round(time.time() - self._began, 6)
                infos[i] = {
                    **final,
                    "terminal_observation": step[4]["final_obs"][row],
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": elapsed},
                }
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return observations, (rewards * self._scale).astype(np.float32), done, infos

    def _step_groups(self, actions: Sequence[NDArray[Any]]) -> list[Any]:
        if self._pool is None:
            return [group.step(own) for group, own in zip(self.groups, actions, strict=True)]
        # The largest first: no thread begins with it when the others are done.
        order = sorted(range(len(self.groups)), key=lambda k: -self.groups[k].num_envs)
        steps = {k: self._pool.submit(self.groups[k].step, actions[k]) for k in order}
        return [steps[k].result() for k in range(len(self.groups))]

    def get_state(self) -> list[Any]:
        """Return all that the rest of the episodes, and all later ones, depend on: the state of each batch."""
        return [group.get_state() for group in self.groups]

    def set_state(self, state: Sequence[Any]) -> None:
        """Continue from what `get_state` returned."""
        for group, own in zip(self.groups, state, strict=True):
            group.set_state(own)

    def close(self) -> None:
        """Free threads and windows."""
        if self._pool is not None:
            self._pool.shutdown()
        for group in self.groups:
            group.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch of each environment asked for."""
        if attr_name == "action_masks":  # for has_attr: what env_method serves
            if not all(isinstance(group, DuelVectorEnv) for group in self.groups):
                raise AttributeError("the control level has no action masks")
            masks = np.concatenate([group.action_masks() for group in self.groups])
            return [masks[i] for i in self._get_indices(indices)]
        return [getattr(self._group(i), attr_name) for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: environments of a batch share their attributes."""
        raise InputError(f"{attr_name!r} can't be set for single environments of a batch; make another one")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call ``action_masks``, or a method of the batch of each environment asked for."""
        if method_name == "action_masks":
            return self.get_attr(method_name, indices)
        methods = [getattr(self._group(i), method_name) for i in self._get_indices(indices)]
        return [method(*method_args, **method_kwargs) for method in methods]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether each environment reports what this wrapper would: episodes are monitored, nothing else is wrapped."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a frame of each environment, if they render."""
        if self.groups[0].render_mode != "rgb_array":
            return [None for _ in range(self.num_envs)]
        return [frame for group in self.groups for frame in group.render()]

    def _group(self, environment: int) -> BatchVectorEnv:
        group: BatchVectorEnv = self.groups[int(np.searchsorted(self._edges, environment, "right")) - 1]
        return group


def _infos(info: dict[str, Any], rows: Iterable[int]) -> list[dict[str, Any]]:
    """Infos of some environments, each as a dictionary of its own."""
    names = [name for name in info if not name.startswith("_") and not name.startswith("final_")]
    return [{name: info[name][i] for name in names} for i in rows]
