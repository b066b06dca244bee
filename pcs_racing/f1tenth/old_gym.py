"""What programs written for gym 0.21 expect: its wrappers, and its environments under today's Stable-Baselines3."""

import multiprocessing
import sys
from collections.abc import Collection, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from inspect import Parameter, isclass, signature
from types import ModuleType
from typing import Any

import gymnasium

# Where Stable-Baselines3 is handed an environment: by module, a function or a class.
_ENTRANCES = {"vec_env.patch_gym": "_patch_env", "env_checker": "check_env", "monitor": "Monitor"}


class Wrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper as in gym: it shows the attributes of what it wraps, hands on any values, and may change three."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.env, name)

    def observation(self, observation: Any) -> Any:
        """Return the changed observation, wherever it stands in front of other values."""
        return observation

    def action(self, action: Any) -> Any:
        """Return the changed action."""
        return action

    def reward(self, reward: Any) -> Any:
        """Return the changed reward."""
        return reward

    def reset(self, *args: Any, **named: Any) -> Any:
        """Reset what is wrapped, with any arguments."""
        answer = self.env.reset(*args, **named)
        return (self.observation(answer[0]), *answer[1:]) if isinstance(answer, tuple) else self.observation(answer)

    def step(self, action: Any) -> Any:
        """Step what is wrapped."""
        obs, reward, *rest = self.env.step(self.action(action))
        return (self.observation(obs), self.reward(reward), *rest)

    def render(self, *args: Any, **named: Any) -> Any:
        """Render what is wrapped, with any arguments."""
        return self.env.render(*args, **named)


class TimeLimit(Wrapper):
    """Ends an episode after so many steps, and says so among the infos."""

    def __init__(self, env: Any, max_episode_steps: int) -> None:
        super().__init__(env)
        self._most, self._left = max_episode_steps, max_episode_steps

    def reset(self, *args: Any, **named: Any) -> Any:
        """Begin an episode."""
        self._left = self._most
        return super().reset(*args, **named)

    def step(self, action: Any) -> Any:
        """Step what is wrapped, and count."""
        self._left -= 1
        obs, reward, done, info = super().step(action)
        more = {"TimeLimit.truncated": not done} if self._left <= 0 else {}
        return obs, reward, done or self._left <= 0, info | more


class Today(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment of gym 0.21 with Gymnasium's interface; what has it already passes through."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Hand on what the environment takes."""
        takes = _arguments(self.env)
        given = {"seed": seed, "options": options}
        if seed is not None and "seed" not in takes and callable(getattr(self.env, "seed", None)):
            self.env.seed(seed)  # type: ignore[attr-defined]
        answer = self.env.reset(**{name: value for name, value in given.items() if name in takes})  # type: ignore[arg-type]
        if isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], dict):
            return answer
        return (answer[0] if isinstance(answer, tuple) else answer), {}

    def step(self, action: Any) -> Any:
        """Tell an end from a limit."""
        obs, reward, done, *cut, info = self.env.step(action)
        late = bool(cut[0] if cut else info.get("TimeLimit.truncated", False))
        return obs, float(reward), bool(done) and (not late or bool(cut)), late, info


def _arguments(env: Any) -> Collection[str]:
    """Names of the arguments that a reset takes; of one that hands on any, what it hands them to."""
    listed = signature(env.reset).parameters
    handed_on = any(one.kind is Parameter.VAR_KEYWORD for one in listed.values()) and isinstance(env, gymnasium.Wrapper)
    return _arguments(env.env) if handed_on else listed


class _Adapter(MetaPathFinder):
    """Lets Stable-Baselines3 see environments with the interface of today, wherever it is handed one."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module whose entrance is adapted once it has run."""
        name = _ENTRANCES.get(fullname.removeprefix("stable_baselines3.common."))
        spec = PathFinder.find_spec(fullname, path) if name and fullname.startswith("stable_baselines3.") else None
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
    """Return a function whose argument ``env``, at this place, is one of today."""

    def call(*given: Any, **named: Any) -> Any:
        env = given[place] if len(given) > place else named.pop("env")
        env = Today(env) if isinstance(env, gymnasium.Env) and not isinstance(env, Today) else env
        return function(*given[:place], env, *given[place + 1 :], **named)

    return call


def install() -> None:
    """Adapt Stable-Baselines3 as soon as it is imported, and let processes that the program starts begin like it."""
    sys.meta_path.insert(0, _Adapter())
    if "forkserver" in multiprocessing.get_all_start_methods():
        multiprocessing.set_forkserver_preload(["pcs_racing.f1tenth.in_workers"])
