"""Folders of the real circuits, which the studies hold out."""

import os
from collections.abc import Sequence
from pathlib import Path

from pcs_racing.base.errors import InputError, say_once


def real_circuits(names: Sequence[str], maps: Path | None) -> list[str]:
    """Return the folders of real circuits.

    ``maps``: folder of the circuits, which must have all of them; by default ``$PCS_RACING_MAPS``,
    where a missing circuit is left out with a message.
    """
    folder = maps or Path(os.environ.get("PCS_RACING_MAPS", ""))
    missing = [name for name in names if not (folder / name).is_dir()]
    if maps is not None and missing:
        raise InputError(f"{maps} lacks the circuits {', '.join(missing)}")
    if missing:
        say_once(f"without {', '.join(missing)}: give their folder as --maps")
    return [str(folder / name) for name in names if name not in missing]
