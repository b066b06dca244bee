"""Interface of gym 0.21: its wrappers, and its environments under current Stable-Baselines3."""

import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from inspect import Parameter, isclass, signature
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from gymnasium.wrappers.utils import RunningMeanStd

# Functions and classes of Stable-Baselines3 that take an environment, by module.
_ENTRANCES = {"vec_env.patch_gym": "_patch_env", "env_checker": "check_env", "monitor": "Monitor"}


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
        return (
            (self.observation(answer[0]), *answer[1:])
            if isinstance(answer, tuple)
            else self.observation(answer)
        )

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


class TimeLimit(Wrapper):
    """Wrapper that ends an episode after a number of steps, and reports it in the infos."""

    def __init__(self, env: Any, max_episode_steps: int | None = None) -> None:
        super().__init__(env)
        self._most = (
            max_episode_steps or getattr(env.spec, "max_episode_steps", None) or sys.maxsize
        )
        self._left = self._most

    def reset(self, *args: Any, **named: Any) -> Any:
        """Begin an episode."""
        self._left = self._most
        return super().reset(*args, **named)

    def step(self, action: Any) -> Any:
        """Step the wrapped environment, and count."""
        self._left -= 1
        obs, reward, done, info = super().step(action)
        more = {"TimeLimit.truncated": not done} if self._left <= 0 else {}
        return obs, reward, done or self._left <= 0, info | more


class TransformObservation(Wrapper):
    """Wrapper that changes observations by a function."""

    def __init__(self, env: Any, f: Callable[[Any], Any], observation_space: Any = None) -> None:
        super().__init__(env)
        self.f, self.observation = f, f  # type: ignore[assignment]
        self.observation_space = observation_space or env.observation_space


class TransformReward(Wrapper):
    """Wrapper that changes rewards by a function."""

    def __init__(self, env: Any, f: Callable[[Any], Any]) -> None:
        super().__init__(env)
        self.f, self.reward = f, f  # type: ignore[assignment]


class ClipAction(Wrapper):
    """Wrapper that clips actions to the bounds of their space."""

    def action(self, action: Any) -> Any:
        """Return the clipped action."""
        return np.clip(action, self.action_space.low, self.action_space.high)  # type: ignore[attr-defined]


class RescaleAction(Wrapper):
    """Wrapper that rescales actions from two bounds to the bounds of the wrapped space."""

    def __init__(self, env: Any, min_action: Any, max_action: Any) -> None:
        super().__init__(env)
        space = env.action_space
        self.min_action, self.max_action = (
            np.zeros_like(space.low) + bound for bound in (min_action, max_action)
        )
        self.action_space = gymnasium.spaces.Box(
            self.min_action, self.max_action, dtype=space.dtype
        )

    def action(self, action: Any) -> Any:
        """Return the action in the wrapped environment's bounds."""
        low, high = self.env.action_space.low, self.env.action_space.high  # type: ignore[attr-defined]
        return np.clip(
            low + (high - low) * (action - self.min_action) / (self.max_action - self.min_action),
            low,
            high,
        )


class FlattenObservation(TransformObservation):
    """Wrapper that flattens an observation to one vector."""

    def __init__(self, env: Any) -> None:
        space = env.observation_space
        super().__init__(
            env, partial(gymnasium.spaces.flatten, space), gymnasium.spaces.flatten_space(space)
        )


class FilterObservation(TransformObservation):
    """Wrapper that selects some entries of a dictionary observation."""

    def __init__(self, env: Any, filter_keys: Sequence[str] | None = None) -> None:
        kept = env.observation_space.spaces
        kept = {
            key: value for key, value in kept.items() if filter_keys is None or key in filter_keys
        }
        super().__init__(
            env, lambda obs: {key: obs[key] for key in kept}, gymnasium.spaces.Dict(kept)
        )


class FrameStack(Wrapper):
    """Wrapper that stacks the last observations; at the start it repeats the first observation."""

    def __init__(self, env: Any, num_stack: int, lz4_compress: bool = False) -> None:
        super().__init__(env)
        self.num_stack, self.frames, one = (
            num_stack,
            deque[Any](maxlen=num_stack),
            env.observation_space,
        )
        low, high = (np.repeat(bound[None], num_stack, axis=0) for bound in (one.low, one.high))
        self.observation_space = gymnasium.spaces.Box(low, high, dtype=one.dtype)

    def observation(self, observation: Any) -> Any:
        """Return the last observations, shape (num_stack, ...)."""
        self.frames.extend([observation] * max(1, self.num_stack - len(self.frames)))
        return np.stack(list(self.frames))

    def reset(self, *args: Any, **named: Any) -> Any:
        """Begin an episode."""
        self.frames.clear()
        return super().reset(*args, **named)


class NormalizeObservation(Wrapper):
    """Wrapper that scales observations by the running mean and variance."""

    def __init__(self, env: Any, epsilon: float = 1e-8) -> None:
        super().__init__(env)
        self.many = bool(getattr(env, "is_vector_env", False))
        space = env.single_observation_space if self.many else env.observation_space
        self.obs_rms, self.epsilon = RunningMeanStd(shape=space.shape), epsilon

    def observation(self, observation: Any) -> Any:
        """Return the scaled observation."""
        self.obs_rms.update(np.asarray(observation if self.many else [observation]))
        return (observation - self.obs_rms.mean) / np.sqrt(self.obs_rms.var + self.epsilon)


class NormalizeReward(Wrapper):
    """Wrapper that scales rewards by the variance of the discounted return."""

    def __init__(self, env: Any, gamma: float = 0.99, epsilon: float = 1e-8) -> None:
        super().__init__(env)
        self.return_rms, self.gamma, self.epsilon = RunningMeanStd(shape=()), gamma, epsilon
        self.returns = np.zeros(getattr(env, "num_envs", 1))

    def step(self, action: Any) -> Any:
        """Step the environment, and add its reward to the return."""
        obs, rewards, done, *rest = super().step(action)
        self.returns = self.returns * self.gamma + rewards
        self.return_rms.update(self.returns)
        self.returns[np.asarray(done) | np.zeros(len(self.returns), np.bool_)] = 0.0
        return obs, rewards / np.sqrt(self.return_rms.var + self.epsilon), done, *rest


class RecordEpisodeStatistics(Wrapper):
    """Wrapper that adds return ``r``, length ``l``, seconds ``t`` to an episode's last infos."""

    def __init__(self, env: Any, deque_size: int = 100) -> None:
        super().__init__(env)
        self.num_envs, self.many = (
            getattr(env, "num_envs", 1),
            bool(getattr(env, "is_vector_env", False)),
        )
        self.return_queue, self.length_queue = (
            deque[Any](maxlen=deque_size),
            deque[Any](maxlen=deque_size),
        )
        self.t0, self.episode_count = time.perf_counter(), 0
        self.episode_returns, self.episode_lengths = (
            np.zeros(self.num_envs, np.float32),
            np.zeros(self.num_envs, int),
        )

    def reset(self, *args: Any, **named: Any) -> Any:
        """Begin an episode."""
        self.episode_returns, self.episode_lengths = (
            0.0 * self.episode_returns,
            0 * self.episode_lengths,
        )
        return super().reset(*args, **named)

    def step(self, action: Any) -> Any:
        """Step the environment, and add up the episode."""
        obs, rewards, done, *rest, infos = super().step(action)
        self.episode_returns, self.episode_lengths = (
            self.episode_returns + rewards,
            self.episode_lengths + 1,
        )
        listed = [dict(info) for info in (infos if self.many else [infos])]
        ended = np.asarray(done) | np.any(rest, axis=0) if rest else np.asarray(done)
        for i in np.flatnonzero(ended | np.zeros(self.num_envs, np.bool_)):
            total, length = self.episode_returns[i], int(self.episode_lengths[i])
            listed[i]["episode"] = {
                "r": total,
                "l": length,
                "t": round(time.perf_counter() - self.t0, 6),
            }
            self.return_queue.append(total)
            self.length_queue.append(length)
            self.episode_count += 1
            self.episode_returns[i] = self.episode_lengths[i] = 0
        return obs, rewards, done, *rest, tuple(listed) if self.many else listed[0]


class SyncVectorEnv(gymnasium.Env[Any, Any]):
    """Several environments stepped together.

    A finished environment is reset, and its last observation is in the infos.
    """

    is_vector_env = True

    def __init__(self, env_fns: Sequence[Callable[[], Any]], *args: Any, **named: Any) -> None:
        self.envs = [make() for make in env_fns]
        self.num_envs, first = len(self.envs), self.envs[0]
        self.single_observation_space, self.single_action_space = (
            first.observation_space,
            first.action_space,
        )
        self.observation_space, self.action_space = (
            batch_space(space, self.num_envs)
            for space in (first.observation_space, first.action_space)
        )

    def seed(self, seeds: Any = None) -> None:
        """Seed the environments with a list of seeds, or with one seed and its successors."""
        each = (
            seeds
            if isinstance(seeds, list)
            else [None if seeds is None else seeds + i for i in range(self.num_envs)]
        )
        for env, seed in zip(self.envs, each, strict=True):
            env.seed(seed)

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
        rewards, done = (np.array([answer[i] for answer in answers]) for i in (1, 2))
        return (
            self._together([answer[0] for answer in answers]),
            rewards,
            done,
            tuple(one[-1] for one in answers),
        )

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()

    def _together(self, observations: list[Any]) -> Any:
        out: Any = create_empty_array(self.single_observation_space, self.num_envs)
        return concatenate(self.single_observation_space, observations, out)


def make_vector(
    id: str,  # noqa: A002
    num_envs: int = 1,
    asynchronous: bool = True,
    **named: Any,
) -> SyncVectorEnv:
    """Make several environments of one name, stepped together."""
    return SyncVectorEnv([partial(gymnasium.make, id, **named)] * num_envs)


def _observed(answer: Any) -> Any:
    """Return the observation in the result of a reset."""
    return answer[0] if isinstance(answer, tuple) else answer


WRAPPERS: dict[str, Any] = {
    cls.__name__: cls
    for cls in (
        Wrapper,
        TimeLimit,
        TransformObservation,
        TransformReward,
        ClipAction,
        RescaleAction,
        FlattenObservation,
        FilterObservation,
        FrameStack,
        NormalizeObservation,
        NormalizeReward,
        RecordEpisodeStatistics,
    )
}
WRAPPERS |= dict.fromkeys(
    ("ObservationWrapper", "RewardWrapper", "ActionWrapper", "OrderEnforcing"), Wrapper
)
WRAPPERS["RunningMeanStd"] = RunningMeanStd
MODULES = (
    "time_limit transform_observation transform_reward clip_action rescale_action"
    " flatten_observation "
)
MODULES += "filter_observation frame_stack normalize record_episode_statistics order_enforcing"


class Today(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Gymnasium's interface for an environment of gym 0.21; current environments are unchanged."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Reset the environment with the arguments that it takes."""
        takes = _arguments(self.env)
        given = {"seed": seed, "options": options}
        if seed is not None and "seed" not in takes and callable(getattr(self.env, "seed", None)):
            self.env.seed(seed)  # type: ignore[attr-defined]
        answer = self.env.reset(**{name: value for name, value in given.items() if name in takes})  # type: ignore[arg-type]
        if isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], dict):
            return answer
        return (answer[0] if isinstance(answer, tuple) else answer), {}

    def step(self, action: Any) -> Any:
        """Step the environment, and separate termination from truncation."""
        obs, reward, done, *cut, info = self.env.step(action)
        late = bool(cut[0] if cut else info.get("TimeLimit.truncated", False))
        return obs, float(reward), bool(done) and (not late or bool(cut)), late, info


def _arguments(env: Any) -> Collection[str]:
    """Return the argument names of a reset; a wrapper that passes on any is looked through."""
    listed = signature(env.reset).parameters
    handed_on = any(one.kind is Parameter.VAR_KEYWORD for one in listed.values()) and isinstance(
        env, gymnasium.Wrapper
    )
    return _arguments(env.env) if handed_on else listed


class Adapter(MetaPathFinder):
    """Import hook that adapts all environments given to Stable-Baselines3 to Gymnasium."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module, and adapt its entrance after its execution."""
        name = _ENTRANCES.get(fullname.removeprefix("stable_baselines3.common."))
        spec = (
            PathFinder.find_spec(fullname, path)
            if name and fullname.startswith("stable_baselines3.")
            else None
        )
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def run(module: ModuleType) -> None:
                execute(module)
                entrance = getattr(module, str(name))
                if isclass(entrance):
                    setattr(entrance, "__init__", _adapted(entrance.__init__, 1))  # noqa: B010
                else:
                    setattr(module, str(name), _adapted(entrance, 0))

            spec.loader.exec_module = run  # type: ignore[method-assign]
        return spec


def _adapted(function: Any, place: int) -> Any:
    """Return a function that adapts its argument ``env``, at index ``place``, to Gymnasium."""

    def call(*given: Any, **named: Any) -> Any:
        env = given[place] if len(given) > place else named.pop("env")
        env = Today(env) if isinstance(env, gymnasium.Env) and not isinstance(env, Today) else env
        return function(*given[:place], env, *given[place + 1 :], **named)

    return call


def seed_generator(self: Any, seed: int | None = None) -> list[Any]:
    """Seed an environment's generator, as environments of gym did."""
    self._np_random, used = seeding.np_random(seed)
    return [used]
