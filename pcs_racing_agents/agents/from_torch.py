"""Torch modules as competitors, and Stable-Baselines3 policies as networks without torch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.torch_layers import layers_from_torch


class TorchPolicy:
    """A competitor that makes the move with the max output of a torch module.

    Parameters
    ----------
    module : torch.nn.Module
        Module that takes observations, a float32 tensor of shape (B, D), and returns a tensor of
        shape (B, M): a number for each move, such as its logit or its value. It is put into
        evaluation mode.
    name : str
        Name in tables.

    Notes
    -----
    Torch may round a matrix product differently for another batch size. If two outputs are equal
    except for rounding, the move may depend on the batch.
    """

    def __init__(self, module: Any, name: str = "torch") -> None:
        require("torch", extra="learning")
        import torch

        if not isinstance(module, torch.nn.Module):
            raise InputError(f"module is a {type(module).__name__}; it must be a torch.nn.Module")
        broken = [
            key for key, tensor in module.state_dict().items() if not torch.isfinite(tensor).all()
        ]
        if broken:
            raise InputError(f"weights {broken[0]!r} of the module hold NaN or infinity")
        self.module, self.name = module.eval(), name

    @property
    def content_hash(self) -> str:
        """SHA-256 of the weights and of the module's printed structure."""
        weights = {
            key: tensor.detach().cpu().numpy() for key, tensor in self.module.state_dict().items()
        }
        return fingerprint(str(self.module), weights)

    def act(self, observations: NDArray[np.float32], turn: Any = None) -> NDArray[np.int64]:
        """Return the move with the max output for each observation."""
        import torch

        rows = np.asarray(observations, np.float32)
        with torch.no_grad():
            values = self.module(torch.from_numpy(np.ascontiguousarray(rows)))
        if not isinstance(values, torch.Tensor) or values.ndim != 2 or len(values) != len(rows):
            found = (
                tuple(values.shape) if isinstance(values, torch.Tensor) else type(values).__name__
            )
            raise InputError(
                f"the module returned {found} for {len(rows)} observations; it must be"
                f" ({len(rows)}, M)"
            )
        if not torch.isfinite(values).all():
            raise InputError("the module returned NaN or infinity")
        return np.asarray(values.argmax(dim=1).numpy())


def network_from_sb3(
    model: Any, identity: GameIdentity, name: str = "ppo", training: "dict[str, Any] | None" = None
) -> RegretNetwork:
    """Return a model's policy as a network whose outputs are the logits of the moves.

    Parameters
    ----------
    model : stable_baselines3 model
        Model with an ``MlpPolicy`` on plain observations and ReLUs between the layers
        (``policy_kwargs={"activation_fn": torch.nn.ReLU}``). Its actions are the moves of the game.
    identity : GameIdentity
        Game of the training (:func:`pcs_racing.game.identity.game_identity`).
    training : dict of str to text or number, optional
        Facts about the training, for reports.
    """
    policy = getattr(model, "policy", None)
    try:
        hidden, last = list(policy.mlp_extractor.policy_net), policy.action_net  # type: ignore[union-attr]
    except AttributeError:
        kind = type(model).__name__
        raise InputError(
            f"{kind} has no actor of fully connected layers; train with MlpPolicy"
        ) from None
    layers = []
    for i, module in enumerate(hidden):
        kind = type(module).__name__
        if kind != ("Linear", "ReLU")[i % 2]:
            raise InputError(
                f"layer {i} of the actor is {kind}; train with policy_kwargs={{'activation_fn':"
                " torch.nn.ReLU} to race without torch"
            )
        layers += [module] if i % 2 == 0 else []
    extractor = type(policy.features_extractor).__name__  # type: ignore[union-attr]
    if extractor != "FlattenExtractor" or type(last).__name__ != "Linear":
        raise InputError(
            f"the model reads observations by {extractor}; only plain observations can be taken"
            " over"
        )
    parameters = [
        parameter for layer in (*layers, last) for parameter in (layer.weight, layer.bias)
    ]
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
