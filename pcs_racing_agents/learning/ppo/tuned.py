"""Tuned settings of Stable-Baselines3's PPO by environment, from a file in the format of rl_zoo3.

The file also works with rl_zoo3's ``train.py``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pcs_racing.base.checks import check_choice
from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.settings import read_settings
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.learning.ppo.learner import check_packages

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv


TUNED_FILE = shipped_configs("sb3")["ppo"]
"""File with the settings of all environments, in the format of rl_zoo3."""

UNEQUAL_CARS = "pcs_racing_agents.learning.ppo.unequal_cars.UnequalCars"
"""Wrapper supported as ``vec_env_wrapper`` in the file."""

LINEAR = "lin_"
"""Prefix of a learning rate that falls linearly to 0, in the format of rl_zoo3."""


@dataclass(frozen=True)
class TunedPPO:
    """Task of an environment, with tuned settings of PPO."""

    environment: str  #: Id of the environment.
    arguments: Mapping[str, Any]  #: Arguments of the environment, defining the task.
    num_envs: int  #: Number of parallel environments.
    steps: int  #: Training steps, over all environments.
    normalize: bool = False  #: True to normalise observations and rewards by ``VecNormalize``.
    #: Arguments of :class:`pcs_racing_agents.learning.ppo.unequal_cars.UnequalCars`; None for no
    #: such wrapper.
    unequal_cars: Mapping[str, Any] | None = None
    #: Arguments of ``PPO``. The learning rate is a number, or text such as "lin_1e-3" for a linear
    #: decrease to 0.
    settings: Mapping[str, Any] = field(default_factory=dict)

    def make_envs(self, num_envs: int | None = None) -> "VecEnv":
        """Return compiled, unwrapped environments of the task for Stable-Baselines3.

        ``num_envs``: number of environments; by default the tuned number.
        """
        check_packages()
        from pcs_racing.envs.sb3 import make_sb3_vec_env

        return make_sb3_vec_env(self.environment, num_envs or self.num_envs, **self.arguments)

    def make_model(self, seed: int = 0) -> "PPO":
        """Return an untrained model with its environments; train by ``model.learn(tuned.steps)``.

        ``seed``: seed of the networks, the environments and the exploration.
        """
        check_packages()
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecNormalize

        envs = self.make_envs()
        if self.unequal_cars is not None:
            from pcs_racing_agents.learning.ppo.unequal_cars import UnequalCars

            envs = UnequalCars(envs, seed=seed, **self.unequal_cars)
        if self.normalize:
            envs = VecNormalize(envs, gamma=float(self.settings.get("gamma", 0.99)))
        settings = {
            **self.settings,
            "learning_rate": learning_rate(self.settings.get("learning_rate", 3e-4)),
        }
        return PPO(env=envs, seed=seed, device="cpu", **settings)


def tuned_environments() -> tuple[str, ...]:
    """Return the ids of all environments with tuned settings."""
    return tuple(read_settings(TUNED_FILE))


def tuned_ppo(environment: str) -> TunedPPO:
    """Return the tuned settings of PPO for an environment.

    Parameters
    ----------
    environment : str
        Id of the environment, for instance ``"pcs_racing/Match-v0"``.

    Examples
    --------
    >>> tuned = tuned_ppo("pcs_racing/Match-v0")
    >>> tuned.arguments["archive"], tuned.settings["policy"]
    ('contest', 'MlpPolicy')
    """
    known = read_settings(TUNED_FILE)
    check_choice("environment", environment, known, UnknownNameError)
    values = dict(known[environment])
    return TunedPPO(
        environment,
        arguments=values.pop("env_kwargs"),
        num_envs=values.pop("n_envs"),
        steps=values.pop("n_timesteps"),
        normalize=values.pop("normalize", False),
        unequal_cars=values.pop("vec_env_wrapper", {}).get(UNEQUAL_CARS),
        settings=values,
    )


def learning_rate(value: float | str) -> Any:
    """Return a learning rate for PPO: a number, or a function of the remaining training share."""
    if not isinstance(value, str):
        return float(value)
    try:
        first = float(value.removeprefix(LINEAR)) if value.startswith(LINEAR) else float("nan")
    except ValueError:
        first = float("nan")
    if not first > 0.0:
        raise ConfigError(
            f"learning_rate is {value!r}; it must be a number, or one after {LINEAR!r}"
        )
    return lambda left: left * first
