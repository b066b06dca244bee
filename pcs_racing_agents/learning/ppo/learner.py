"""A PPO model of Stable-Baselines3, built from settings and trained one update at a time.

Stable-Baselines3 uses the global random generators of the process. :func:`own_randomness` restores
their states afterwards.
"""

import random
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing_agents.learning.ppo.settings import DuelSettings
from pcs_racing_agents.networks.torch_layers import layers_from_torch, torch_alone

if TYPE_CHECKING:
    from stable_baselines3 import PPO


@contextmanager
def own_randomness() -> Iterator[None]:
    """Restore the process's random generators at exit; reserve them and torch for one thread."""
    with torch_alone() as torch:
        states = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
        try:
            yield
        finally:
            random.setstate(states[0])
            np.random.set_state(states[1])  # noqa: NPY002
            torch.set_rng_state(states[2])


def group_seeds(seed: int, groups: int, purpose: int) -> list[int]:
    """Return the seeds of groups of environments.

    No two groups, seeds or purposes (0 to learn, 1 to evaluate) share a random generator.
    """
    sequences = [
        np.random.SeedSequence(seed, spawn_key=(purpose, group)) for group in range(groups)
    ]
    # Environment i of a group has the seed of the group plus i: two free bits avoid an overflow.
    return [int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(2)) for sequence in sequences]


# The model


def make_model(
    settings: DuelSettings,
    groups: Sequence[BatchVectorEnv],
    seed: int,
    activation: str,
    threads: int = 1,
) -> "PPO":
    """Make an untrained model.

    ``activation``: activation between the layers. ``threads``: number of groups stepped at the same
    time; no effect on the result.
    """
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger
    from torch import nn

    from pcs_racing.envs.sb3 import SB3VecEnv

    seeds = group_seeds(seed, len(groups), 0)
    envs = SB3VecEnv(list(groups), seeds=seeds, reward_scale=settings.reward_scale, threads=threads)
    policy: dict[str, Any] = {
        "net_arch": {"pi": list(settings.hidden), "vf": list(settings.value_hidden)},
        "activation_fn": {"relu": nn.ReLU, "tanh": nn.Tanh}[activation],
    }
    steps = settings.rollout * envs.num_envs
    batches = -(-steps // settings.batch_size)
    with warnings.catch_warnings():  # warning about a slightly smaller last batch
        warnings.simplefilter("ignore", UserWarning)
        model = PPO(
            "MlpPolicy",
            envs,
            seed=seed,
            learning_rate=settings.learning_rate,
            n_steps=settings.rollout,
            batch_size=-(-steps // batches),
            n_epochs=settings.epochs,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            ent_coef=settings.entropy,
            policy_kwargs=policy,
            device="cpu",
        )
    model.set_logger(Logger(None, []))
    return model


def learn_once(model: "PPO", settings: DuelSettings, limit: float) -> None:
    """Collect steps, and make one update.

    ``limit``: maximum absolute weight of the policy.
    """
    import torch

    # Stable-Baselines3's own schedule would restart with every call of `learn`: each call has a
    # constant rate.
    share = min(model.num_timesteps / settings.steps, 1.0)
    rate = settings.learning_rate + share * (settings.final_learning_rate - settings.learning_rate)
    model.lr_schedule = lambda _: rate
    is_nan = False
    try:
        model.learn(model.n_steps * model.n_envs, reset_num_timesteps=False, log_interval=None)  # type: ignore[arg-type]
    except ValueError as error:  # torch's distributions refuse NaN
        if isinstance(error, InputError):
            raise
        is_nan = True
    # The network will be a planner with bounded parameters: the limit also holds during training.
    with torch.no_grad():
        for parameter in _actor(model):
            parameter.clamp_(-limit, limit)
    if is_nan or not all(
        torch.isfinite(parameter).all() for parameter in model.policy.parameters()
    ):
        raise InputError(
            f"a weight is no longer a number after {model.num_timesteps} steps; take a"
            f" learning_rate below {settings.learning_rate:g}"
        )


def actor_layers(model: "PPO") -> DenseLayers:
    """Return copies of the layers of the policy."""
    return layers_from_torch(_actor(model))


def _actor(model: "PPO") -> list[Any]:
    """Return weights and biases of the policy, alternating, from the first layer to the last."""
    policy: Any = model.policy
    return [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
