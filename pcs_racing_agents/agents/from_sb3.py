"""Conversion of a policy trained with Stable-Baselines3: it races without torch, with the same bits in any batch."""

from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.torch_layers import layers_from_torch


def network_from_sb3(
    model: Any, identity: GameIdentity, name: str = "ppo", training: "dict[str, Any] | None" = None
) -> RegretNetwork:
    """Return a model's policy as a network whose outputs are the logits of the moves.

    Parameters
    ----------
    model : stable_baselines3 model
        With an ``MlpPolicy`` over the plain observation and ReLUs between the layers
        (``policy_kwargs={"activation_fn": torch.nn.ReLU}``), whose actions are the moves of the game.
    identity : GameIdentity
        The game that it was trained on (:func:`pcs_racing.game.identity.game_identity`).
    training : dict of str to text or number, optional
        How it was trained, for reports.
    """
    policy = getattr(model, "policy", None)
    try:
        hidden, last = list(policy.mlp_extractor.policy_net), policy.action_net  # type: ignore[union-attr]
    except AttributeError:
        kind = type(model).__name__
        raise InputError(f"{kind} has no actor of fully connected layers; train with MlpPolicy") from None
    layers = []
    for i, module in enumerate(hidden):
        kind = type(module).__name__
        if kind != ("Linear", "ReLU")[i % 2]:
            raise InputError(
                f"layer {i} of the actor is {kind}; train with policy_kwargs={{'activation_fn': torch.nn.ReLU}} "
                "to race without torch"
            )
        layers += [module] if i % 2 == 0 else []
    extractor = type(policy.features_extractor).__name__  # type: ignore[union-attr]
    if extractor != "FlattenExtractor" or type(last).__name__ != "Linear":
        raise InputError(f"the model reads observations by {extractor}; only plain observations can be taken over")
    parameters = [parameter for layer in (*layers, last) for parameter in (layer.weight, layer.bias)]
    size = len(identity.elements)
    return RegretNetwork(
        name=name,
        identity=identity,
        target="ppo",
        clipped=False,
        layers=layers_from_torch(parameters),
        mean=np.zeros(size, np.float32),
        scale=np.ones(size, np.float32),
        training=training or {},
    )
