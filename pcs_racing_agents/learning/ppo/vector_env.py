"""Groups of races as one vector environment of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from pcs_racing.base.errors import InputError
from pcs_racing_agents.learning.ppo.tasks import EnvGroup, group_seeds

__all__ = ["GroupedVecEnv"]


class GroupedVecEnv(VecEnv):
    """Several groups of environments, one after the other, as one vector environment.

    Parameters
    ----------
    groups : sequence of EnvGroup
        All with the same spaces.
    seed : int
        Root of everything that is drawn in them.
    reward_scale : float
        What rewards are multiplied by.
    """

    def __init__(self, groups: Sequence[EnvGroup], seed: int, reward_scale: float = 1.0) -> None:
        self.groups = list(groups)
        self._root, self._scale = seed, reward_scale
        self._edges = np.cumsum([0, *(len(group) for group in self.groups)])
        self._actions: Any = None
        super().__init__(int(self._edges[-1]), self.groups[0].observation_space, self.groups[0].action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begin everywhere anew, with the same seeds every time."""
        seeds = group_seeds(self._root, len(self.groups), 0)
        return np.concatenate([group.reset(seed) for group, seed in zip(self.groups, seeds, strict=True)])

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Make the step."""
        pieces = np.split(self._actions, self._edges[1:-1])
        steps = [group.step(piece) for group, piece in zip(self.groups, pieces, strict=True)]
        observations, rewards, terminated, truncated, last = map(np.concatenate, zip(*steps, strict=True))
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos[i] = {"terminal_observation": last[i], "TimeLimit.truncated": bool(truncated[i])}
        return observations, (rewards * self._scale).astype(np.float32), done, infos

    def get_state(self) -> list[Any]:
        """Return the state of every group."""
        return [group.get_state() for group in self.groups]

    def set_state(self, state: Sequence[Any]) -> None:
        """Go on from what `get_state` returned."""
        for group, value in zip(self.groups, state, strict=True):
            group.set_state(value)

    def close(self) -> None:
        """Do nothing: there is nothing to let go."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return ``render_mode``: none. There is nothing else to ask for."""
        if attr_name != "render_mode":
            raise AttributeError(f"these environments have no attribute {attr_name!r}")
        return [None for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: environments of a group share their attributes."""
        raise InputError(f"{attr_name!r} can't be set for single environments")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refuse: there are no methods of single environments."""
        raise AttributeError(f"these environments have no method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return no pictures."""
        return [None]
