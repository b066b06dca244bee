"""Interface of gym 0.21: its wrappers, and its environments under current Stable-Baselines3."""

from collections.abc import Callable, Collection, Sequence
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from inspect import Parameter, signature
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
from gymnasium import wrappers
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from gymnasium.wrappers.utils import RunningMeanStd

_RESET = "of gym 0.21"  # option or info with the arguments or results of gym's reset
_RENAMED = {"f": "func", "num_stack": "stack_size", "deque_size": "buffer_length"}


class Wrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper as in gym: it exposes the attributes of its environment, and passes on any values.

    It may change the observation, the action and the reward.
    """

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.env, name)

    def observation(self, observation: Any) -> Any:
        """Return the changed observation, with or without other values behind it."""
        return observation

    def action(self, action: Any) -> Any:
        """Return the changed action."""
        return action

    def reward(self, reward: Any) -> Any:
        """Return the changed reward."""
        return reward

    def reset(self, *args: Any, **named: Any) -> Any:
        """Reset the wrapped environment, with any arguments."""
        answer = self.env.reset(*args, **named)
        if isinstance(answer, tuple):
            return self.observation(answer[0]), *answer[1:]
        return self.observation(answer)

    def step(self, action: Any) -> Any:
        """Step the wrapped environment."""
        obs, reward, *rest = self.env.step(self.action(action))
        return (self.observation(obs), self.reward(reward), *rest)

    def seed(self, seed: int | None = None) -> Any:
        """Seed the environment; the gym's own environments store a number under this name."""
        return self.env.seed(seed) if callable(getattr(self.env, "seed", None)) else [seed]  # type: ignore[attr-defined]

    def render(self, *args: Any, **named: Any) -> Any:
        """Render the wrapped environment, with any arguments."""
        return self.env.render(*args, **named)


class _Today(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Gymnasium's interface for an environment of gym 0.21; current environments are unchanged."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Reset the environment with the arguments that it takes."""
        takes = _arguments(self.env)
        if seed is not None and "seed" not in takes and callable(getattr(self.env, "seed", None)):
            self.env.seed(seed)  # type: ignore[attr-defined]
        named = {"seed": seed, "options": options}
        known = (), {name: value for name, value in named.items() if name in takes}
        given, named = (options or {}).get(_RESET, known)
        answer = self.env.reset(*given, **named)
        if not isinstance(answer, tuple):
            return answer, {}
        ours = len(answer) == 2 and isinstance(answer[1], dict)
        return answer if ours else (answer[0], {_RESET: answer[1:]})

    def step(self, action: Any) -> Any:
        """Step the environment, and separate termination from truncation."""
        obs, reward, done, *cut, info = self.env.step(action)
        late = bool(cut[0] if cut else info.get("TimeLimit.truncated", False))
        return obs, float(reward), bool(done) and (not late or bool(cut)), late, info


def _arguments(env: Any) -> Collection[str]:
    """Return the argument names of a reset; a wrapper that passes on any is looked through."""
    listed = signature(env.reset).parameters
    passes_on = any(one.kind is Parameter.VAR_KEYWORD for one in listed.values())
    return _arguments(env.env) if passes_on and isinstance(env, gymnasium.Wrapper) else listed


def _older(name: str, wrapper: Callable[..., Any]) -> type[Wrapper]:
    """Return a wrapper of Gymnasium with the interface of gym."""

    class _Older(Wrapper):
        def __init__(self, env: Any, *given: Any, **named: Any) -> None:
            super().__init__(env)
            named = {_RENAMED.get(key, key): value for key, value in named.items()}
            self._inner = wrapper(_Today(env), *given, **named)
            self.action_space = self._inner.action_space
            self.observation_space = self._inner.observation_space

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            return self._inner.get_wrapper_attr(name)

        def reset(self, *args: Any, **named: Any) -> Any:
            obs, info = self._inner.reset(options={_RESET: (args, named)})
            return (obs, *info[_RESET]) if _RESET in info else obs

        def step(self, action: Any) -> Any:
            obs, reward, ended, late, info = self._inner.step(action)
            more = {"TimeLimit.truncated": not ended} if late else {}
            return obs, reward, ended or late, info | more

    _Older.__name__ = name
    return _Older


class ClipAction(Wrapper):
    """Wrapper that clips actions to the bounds of their space, which keeps its bounds."""

    def action(self, action: Any) -> Any:
        """Return the clipped action."""
        return np.clip(action, self.action_space.low, self.action_space.high)  # type: ignore[attr-defined]


_SHIPPED: dict[str, Callable[..., Any]] = {
    "TimeLimit": wrappers.TimeLimit,
    "TransformObservation": partial(wrappers.TransformObservation, observation_space=None),
    "TransformReward": wrappers.TransformReward,
    "RescaleAction": wrappers.RescaleAction,
    "FlattenObservation": wrappers.FlattenObservation,
    "FilterObservation": wrappers.FilterObservation,
    "FrameStack": wrappers.FrameStackObservation,
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
}
_PLAIN = ("Wrapper", "ObservationWrapper", "RewardWrapper", "ActionWrapper", "OrderEnforcing")
WRAPPERS: dict[str, Any] = {
    **dict.fromkeys(_PLAIN, Wrapper),
    **{name: _older(name, wrapper) for name, wrapper in _SHIPPED.items()},
    "ClipAction": ClipAction,
    "RunningMeanStd": RunningMeanStd,
}
MODULES = (
    "time_limit transform_observation transform_reward clip_action rescale_action"
    " flatten_observation filter_observation frame_stack normalize record_episode_statistics"
    " order_enforcing"
)


class SyncVectorEnv(gymnasium.Env[Any, Any]):
    """Several environments stepped together.

    A finished environment is reset, and its last observation is in the infos.
    """

    is_vector_env = True

    def __init__(self, env_fns: Sequence[Callable[[], Any]], *args: Any, **named: Any) -> None:
        self.envs = [make() for make in env_fns]
        self.num_envs = len(self.envs)
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *args: Any, **named: Any) -> Any:
        """Begin an episode in all environments."""
        return self._together([_observed(env.reset(*args, **named)) for env in self.envs])

    def step(self, actions: Any) -> Any:
        """Step all environments with one action each."""
        answers = [list(env.step(action)) for env, action in zip(self.envs, actions, strict=True)]
        for env, answer in zip(self.envs, answers, strict=True):
            if answer[2]:
                answer[-1] = {**answer[-1], "terminal_observation": answer[0]}
                answer[0] = _observed(env.reset())
        observations, rewards, done, *_, infos = zip(*answers, strict=True)
        return self._together(observations), np.array(rewards), np.array(done), infos

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()

    def _together(self, observations: Sequence[Any]) -> Any:
        out: Any = create_empty_array(self.single_observation_space, self.num_envs)
        return concatenate(self.single_observation_space, observations, out)


def _observed(answer: Any) -> Any:
    """Return the observation in the result of a reset."""
    return answer[0] if isinstance(answer, tuple) else answer


# Functions and classes of Stable-Baselines3 that take an environment, by module.
_ENTRANCES = {
    "stable_baselines3.common.vec_env.patch_gym": "_patch_env",
    "stable_baselines3.common.env_checker": "check_env",
    "stable_baselines3.common.monitor": "Monitor",
}


def adapted_spec(fullname: str, path: Sequence[str] | None) -> ModuleSpec | None:
    """Return the spec of a module of Stable-Baselines3 that adapts all environments to Gymnasium.

    It is None for a module without an entrance.
    """
    name = _ENTRANCES.get(fullname)
    spec = PathFinder.find_spec(fullname, path) if name else None
    if name and spec and spec.loader:
        execute = spec.loader.exec_module

        def run(module: ModuleType) -> None:
            execute(module)
            entrance = getattr(module, name)
            if isinstance(entrance, type):
                setattr(entrance, "__init__", _adapted(entrance.__init__, 1))  # type: ignore[misc]  # noqa: B010
            else:
                setattr(module, name, _adapted(entrance, 0))

        spec.loader.exec_module = run  # type: ignore[method-assign]
    return spec


def _adapted(function: Any, place: int) -> Any:
    """Return a function that adapts its argument ``env``, at index ``place``, to Gymnasium."""

    def call(*given: Any, **named: Any) -> Any:
        env = given[place] if len(given) > place else named.pop("env")
        env = _Today(env) if isinstance(env, gymnasium.Env) and not isinstance(env, _Today) else env
        return function(*given[:place], env, *given[place + 1 :], **named)

    return call


def seed_generator(self: Any, seed: int | None = None) -> list[Any]:
    """Seed an environment's generator, as environments of gym did."""
    self._np_random, used = seeding.np_random(seed)
    return [used]
