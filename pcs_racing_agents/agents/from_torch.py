"""Torch modules as agents."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.envs.models import module_outputs
from pcs_racing.planners.racers import Reader, Request, own_name
from pcs_racing_agents.base.fingerprint import fingerprint


class TorchPolicy:
    """An agent that makes the move with the max output of a torch module.

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


def read_module(request: Request) -> TorchPolicy | None:
    """Return the agent of a torch module with a number for each move; 2 numbers drive a car."""
    if module_outputs(request.given) in (None, 2):
        return None
    return TorchPolicy(request.given, own_name(request.given))


TORCH = Reader(read_module)
