"""Policies of Stable-Baselines3 that score the candidates of the `Line` environments alike.

The planner ``line-ppo`` has this network: a correction of the lattice's costs. It begins as
the lattice, because its last layers are 0, and its weights race as a planner does
(:func:`pcs_racing.planners.line_ppo.network_policy`).
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.envs.line_options import LINE_ELEMENTS, split_observation
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.choice_rows import CONTEXT, MOVE, PAIR, SPEED
from pcs_racing.planners.line_ppo import (
    LATTICE_SIZE,
    LAYERS,
    SHARPNESS,
    read_line_planner,
    tensors_of,
)

try:
    import torch
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy
    from torch import Tensor, nn
except ModuleNotFoundError:
    require("torch", "stable_baselines3", "sb3_contrib", extra="learning")
    raise

TEMPER = 0.4  # first log of the factor of all scores


class CandidateNetwork(nn.Module):
    """Scores of the candidates, with the layers of `pcs_racing.planners.line_ppo.LAYERS`."""

    CONTEXT = CONTEXT
    """Number of the observation's first elements, which describe the situation."""

    context: nn.Linear
    situation: nn.Linear
    weights: nn.Linear
    candidate: nn.Linear
    score: nn.Linear

    def __init__(self) -> None:
        super().__init__()
        for name, (outputs, inputs) in LAYERS.items():
            setattr(self, name, nn.Linear(inputs, outputs))
        for layer in (self.weights, self.score):  # level with the lattice
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.temper = nn.Parameter(torch.tensor(TEMPER))

    def forward(self, seen: Tensor) -> Tensor:
        """Return the logits of the candidates, shape (N, 64); a rejected one has -1e9."""
        parts = split_observation(seen)
        tables = parts["moves"], parts["speeds"], parts["candidates"]
        # Rejected candidates, more than half, are left out.
        flat = (tables[2][..., -1] >= 0.0).flatten().nonzero()[:, 0]
        row, candidate = flat // CANDIDATES, flat % CANDIDATES
        places = row * GOALS + candidate % GOALS, row * SPEEDS + candidate // GOALS, flat
        each = torch.cat(
            [
                table.flatten(0, 1).index_select(0, place)
                for table, place in zip(tables, places, strict=True)
            ],
            dim=1,
        )
        inner = torch.tanh(self.context(parts["context"]))
        # Linear scores of moves, speeds and candidates are computed once each.
        weights = self.weights(inner).split((MOVE, SPEED, PAIR), dim=1)
        move, speed, pair = (
            torch.bmm(table, own[:, :, None])[:, :, 0]
            for table, own in zip(tables, weights, strict=True)
        )
        linear = move[:, None, :] + speed[:, :, None] + pair.view(-1, SPEEDS, GOALS)
        hidden = self.candidate(each) + self.situation(inner).index_select(0, row)
        score = torch.relu(hidden) @ self.score.weight[0] + linear.flatten()[flat]
        score = (score - SHARPNESS * each[:, -1]) * self.temper.exp()
        logits = score.new_full((len(seen) * CANDIDATES,), -1e9)
        return logits.index_copy(0, flat, score).view(-1, CANDIDATES)

    def tensors(self) -> dict[str, NDArray[np.float32]]:
        """Return the layers' tensors, for `network_policy` and `save_line_planner`."""
        names = [f"{layer}.{kind}" for layer in LAYERS for kind in ("weight", "bias")]
        state = self.state_dict()
        return {name: state[name].detach().cpu().numpy().copy() for name in names}

    def load(self, source: str | Path) -> None:
        """Take the weights of a line planner: a shipped name or a folder."""
        tensors = tensors_of(read_line_planner(source)[1][LATTICE_SIZE:])
        state = {key: torch.from_numpy(one).float() for key, one in tensors.items()}
        self.load_state_dict(state, strict=False)


class _Parts(nn.Module):
    """Inputs of actor and critic: all numbers, and the numbers of the situation."""

    latent_dim_pi = len(LINE_ELEMENTS)

    def __init__(self, width: int) -> None:
        super().__init__()
        self.latent_dim_vf = width
        left = len(LINE_ELEMENTS) - 2
        self.seen = [*range(CONTEXT), left, left + 1]
        self.critic = nn.Sequential(
            nn.Linear(len(self.seen), width), nn.Tanh(), nn.Linear(width, width), nn.Tanh()
        )

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs of the actor and of the critic's last layer."""
        return self.forward_actor(seen), self.forward_critic(seen)

    def forward_actor(self, seen: Tensor) -> Tensor:
        """Return the input of the actor."""
        return seen

    def forward_critic(self, seen: Tensor) -> Tensor:
        """Return the input of the critic's last layer."""
        hidden: Tensor = self.critic(seen[:, self.seen])
        return hidden


class _ScoresCandidates:
    """Parts of a policy class that score candidates."""

    def __init__(
        self, observation_space: Any, action_space: Any, *arguments: Any, **given: Any
    ) -> None:
        seen, acts = (len(LINE_ELEMENTS),), CANDIDATES
        found = observation_space.shape, getattr(action_space, "n", None)
        if found != (seen, acts):
            raise InputError(
                f"{type(self).__name__} got observations of shape {found[0]} and {found[1]}"
                f" choices; it learns in pcs_racing/Line-v0, where they are {seen} and {acts}"
            )
        if "use_sde" in given and isinstance(self, MaskableActorCriticPolicy):
            raise InputError(f"{type(self).__name__} is for MaskablePPO; PPO has CandidatePolicy")
        for name in ("net_arch", "activation_fn", "features_extractor_class"):
            if name in given:
                raise InputError(
                    f"{name} is {given[name]!r:.80}; {type(self).__name__} has its own"
                )
        super().__init__(observation_space, action_space, *arguments, **given)  # type: ignore[call-arg]

    def _build(self, lr_schedule: Any) -> None:
        self.mlp_extractor: Any = _Parts(128)
        self.action_net: Any = CandidateNetwork()
        self.value_net: Any = nn.Linear(self.mlp_extractor.latent_dim_vf, 1)
        own: Any = self
        self.optimizer = own.optimizer_class(
            own.parameters(), lr=lr_schedule(1), **own.optimizer_kwargs
        )


class CandidatePolicy(_ScoresCandidates, ActorCriticPolicy):
    """Policy of PPO and A2C for `Line`, level with the lattice before any training.

    Examples
    --------
    >>> from stable_baselines3 import PPO
    >>> from pcs_racing.envs import make_sb3_vec_env
    >>> model = PPO(CandidatePolicy, make_sb3_vec_env("line", 2), n_steps=8, batch_size=16)
    >>> model.policy.action_net.tensors()["context.weight"].shape
    (48, 46)
    """


class MaskableCandidatePolicy(_ScoresCandidates, MaskableActorCriticPolicy):
    """`CandidatePolicy` for MaskablePPO."""
