"""Torch modules as competitors: a network from observations to the logits of the moves."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.optional import require
from pcs_racing_agents.jobs.fingerprint import fingerprint


class TorchPolicy:
    """A competitor that makes the move to which a torch module gives the largest output.

    Parameters
    ----------
    module : torch.nn.Module
        Takes observations, a float32 tensor of shape (B, D), and returns a tensor of shape (B, M): a number for each
        move, such as its logit or its value. It is put into evaluation mode.
    name : str
        Name in tables.

    Notes
    -----
    Torch may round a matrix product differently in another batch size, so that a move may depend on the batch where two
    outputs are equal but for rounding.
    """

    def __init__(self, module: Any, name: str = "torch") -> None:
        require("torch", extra="learning")
        import torch

        if not isinstance(module, torch.nn.Module):
            raise InputError(f"module is a {type(module).__name__}; it must be a torch.nn.Module")
        broken = [key for key, tensor in module.state_dict().items() if not torch.isfinite(tensor).all()]
        if broken:
            raise InputError(f"weights {broken[0]!r} of the module hold NaN or infinity")
        self.module, self.name = module.eval(), name

    @property
    def content_hash(self) -> str:
        """SHA-256 of the weights and of the module's printed structure."""
        weights = {key: tensor.detach().cpu().numpy() for key, tensor in self.module.state_dict().items()}
        return fingerprint(str(self.module), weights)

    def predict(
        self, observation: NDArray[np.float32], state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.int64], None]:
        """Return the move with the largest output for each observation, whatever ``deterministic`` says."""
        import torch

        seen = np.asarray(observation, np.float32)
        rows = seen.reshape(-1, seen.shape[-1])
        with torch.no_grad():
            values = self.module(torch.from_numpy(np.ascontiguousarray(rows)))
        if not isinstance(values, torch.Tensor) or values.ndim != 2 or len(values) != len(rows):
            found = tuple(values.shape) if isinstance(values, torch.Tensor) else type(values).__name__
            raise InputError(f"the module returned {found} for {len(rows)} observations; it must be ({len(rows)}, M)")
        if not torch.isfinite(values).all():
            raise InputError("the module returned NaN or infinity")
        return values.argmax(dim=1).numpy().reshape(seen.shape[:-1]), None
