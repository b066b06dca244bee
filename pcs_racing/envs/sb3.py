"""Stable-Baselines3's vector environment over our compiled batches: seeds, last observations and time limits right.

This module is the only one that imports Stable-Baselines3: ``pip install "pcs-racing[learning]"``.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.envs.drive_vector import DriveVectorEnv
from pcs_racing.envs.duel_vector import DuelVectorEnv, SelfPlayVectorEnv

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError('pcs_racing.envs.sb3 needs Stable-Baselines3: pip install "pcs-racing[learning]"') from error

__all__ = ["KINDS", "SB3VecEnv", "make_sb3_vec_env"]

KINDS: dict[str, type[Any]] = {
    "duel": DuelVectorEnv,
    "drive": DriveVectorEnv,
    "self-play": SelfPlayVectorEnv,
    "pcs_racing/Duel-v1": DuelVectorEnv,
    "pcs_racing/Drive-v1": DriveVectorEnv,
}
"""What can be made, by name."""


def make_sb3_vec_env(kind: str = "duel", num_envs: int = 16, **arguments: Any) -> "SB3VecEnv":
    """Make a vector environment for Stable-Baselines3.

    Parameters
    ----------
    kind : str
        "duel" or "pcs_racing/Duel-v1"; "drive" or "pcs_racing/Drive-v1"; "self-play": both cars of ``num_envs / 2``
        games belong to the learner, whose policy plays against itself.
    num_envs : int
        Number of environments; even for self-play.
    **arguments
        Of the environment.

    Raises
    ------
    UnknownNameError
        If there is no such kind.
    InputError
        If an argument is impossible.

    Examples
    --------
    >>> env = make_sb3_vec_env("duel", 4, opponent="never-switch")
    >>> env.reset().shape
    (4, 31)
    """
    if kind not in KINDS:
        raise UnknownNameError(f"environment {kind!r} is unknown; there are {', '.join(KINDS)}")
    return SB3VecEnv(KINDS[kind](num_envs, **arguments))


class SB3VecEnv(VecEnv):
    """A compiled batch as Stable-Baselines3 wants it.

    ``infos`` hold ``terminal_observation`` and ``TimeLimit.truncated`` where an episode ended, and ``episode`` (return
    ``r``, length ``l``, time ``t``), so no Monitor is needed.

    Parameters
    ----------
    envs : VectorEnv
        One that begins anew in the same step.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(envs, DuelVectorEnv | DriveVectorEnv):
            raise InputError(f"envs is a {type(envs).__name__}; it must be a DuelVectorEnv or a DriveVectorEnv")
        self.envs = envs
        self._actions: Any = None
        self._returns = np.zeros(envs.num_envs)
        self._lengths = np.zeros(envs.num_envs, np.int64)
        self._began = time.time()
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begin new episodes everywhere, with the seeds that `seed` set if they are new."""
        players = getattr(self.envs, "players", 1)
        observations, info = self.envs.reset(seed=self._seeds[::players])
        self.reset_infos = self._infos(info)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Make the step."""
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            final = self._infos(info["final_info"], np.flatnonzero(done))
            for i in np.flatnonzero(done):
                infos[i] = final[i]
                infos[i]["terminal_observation"] = info["final_obs"][i]
                infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
                elapsed = round(time.time() - self._began, 6)
                infos[i]["episode"] = {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": elapsed}
            self._returns[done] = 0.0
            self._lengths[done] = 0
        return observations, rewards.astype(np.float32), done, infos

    def _infos(self, info: dict[str, Any], rows: Sequence[int] | NDArray[Any] | None = None) -> list[dict[str, Any]]:
        names = [name for name in info if not name.startswith("_") and not name.startswith("final_")]
        wanted = range(self.num_envs) if rows is None else rows
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in wanted:
            infos[i] = {name: info[name][i] for name in names}
        return infos

    def close(self) -> None:
        """Let threads and windows go."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once for each environment asked for."""
        if attr_name == "action_masks":  # for has_attr: what env_method serves
            value: Any = self._masks
        elif attr_name == "render_mode":
            value = self.envs.render_mode
        else:
            value = getattr(self.envs, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: environments of a batch share their attributes."""
        raise InputError(f"{attr_name!r} can't be set for single environments of a batch; make another one")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call ``action_masks``, or a method of the batch once for each environment asked for."""
        if method_name == "action_masks":
            masks = self._masks()
            return [masks[i] for i in self._get_indices(indices)]
        method = getattr(self.envs, method_name)
        return [method(*method_args, **method_kwargs) for _ in self._get_indices(indices)]

    def _masks(self) -> NDArray[np.bool_]:
        if not isinstance(self.envs, DuelVectorEnv):
            raise AttributeError("the control level has no action masks")
        return self.envs.action_masks()

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether each environment reports what this wrapper would: episodes are monitored, nothing else is wrapped."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a frame of the first environment, if it renders."""
        frames: Any = self.envs.render() if self.envs.render_mode == "rgb_array" else None
        return list(frames) if frames is not None else [None]
