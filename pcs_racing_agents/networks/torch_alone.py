"""torch for one training at a time: its number of threads and its random generator belong to the whole process."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["torch_alone"]

_TURN = threading.RLock()


@contextmanager
def torch_alone() -> Iterator[Any]:
    """Provide torch, working in one thread, to one thread of this process; others that want it wait.

    Several threads gain nothing for networks as small as ours, and would change the order of sums.

    Raises
    ------
    ModuleNotFoundError
        If torch is not installed; the message says how to install it.
    """
    try:
        import torch
    except ModuleNotFoundError:
        raise ModuleNotFoundError('training needs torch: pip install "pcs-racing[learning]"') from None
    with _TURN:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield torch
        finally:
            torch.set_num_threads(before)
