"""When results count as the same: short races to nine decimals, the ends of long ones roughly."""

from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["differences"]

VALUE = 1e-9
"""Of 64-bit numbers of short races: another processor may round a last bit differently."""
FLOAT32 = 2e-6
"""Of observations, which are 32-bit numbers, relative: a last bit or two."""
LEAD = 0.05
"""Of the ends of long races, m and s: over 40 s rounding errors grow, and a planner's choice may fall another way."""
STRAY = 1
"""Long races of each kind that may end altogether differently for that reason."""


def differences(found: Mapping[str, Any], kept: Mapping[str, Any]) -> list[str]:
    """Say what differs between two sets of results, in a line each."""
    lines = [f"{name} is in one of the two only" for name in sorted(set(found) ^ set(kept))]
    for name in sorted(set(found) & set(kept)):
        new, old = np.asarray(found[name]), np.asarray(kept[name])
        if new.shape != old.shape or new.dtype.kind != old.dtype.kind:
            lines.append(f"{name} has shape {new.shape} and type {new.dtype}; it had {old.shape} and {old.dtype}")
        elif new.dtype.kind != "f":
            if (new != old).any():
                lines.append(f"{name} is {new[new != old].flat[0]!r} where it was {old[new != old].flat[0]!r}")
        elif name.startswith("ends "):
            strayed = (np.abs(new - old) > LEAD).any(axis=1).sum()
            if strayed > STRAY:
                lines.append(f"{name}: {strayed} of {len(new)} races end otherwise")
        else:
            allowed = VALUE + (FLOAT32 if new.dtype == np.float32 else VALUE) * np.maximum(np.abs(old), 1.0)
            worst = np.nanmax(np.abs(new.astype(np.float64) - old) / allowed)
            if worst > 1.0 or (np.isnan(new) != np.isnan(old)).any():
                at = np.unravel_index(np.argmax(np.abs(new - old)), new.shape)
                lines.append(f"{name} is {new[at]:.12g} where it was {old[at]:.12g}")
    return lines
