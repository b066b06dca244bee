"""Copies of the gym that programs bring along: their maps are used, and their code is not run."""

import os
from pathlib import Path

from pcs_racing.base.errors import say
from pcs_racing.f1tenth.maps import OWN_MAPS

_PACKAGES = ("f110_gym", "f1tenth_gym")


def find_copy(program: Path) -> Path | None:
    """Return the gym package in or below a program's folder or a parent folder in its repository.

    A package is a folder with a folder ``envs``. A repository ends at the folder with ``.git``;
    without one, it is the program's folder and its parent.
    """
    above = program.resolve().parents
    root = next((i for i, folder in enumerate(above) if (folder / ".git").exists()), 1)
    patterns = [f"{start}{name}/envs" for start in ("", "*/", "*/*/") for name in _PACKAGES]
    found = (
        path.parent
        for folder in above[: root + 1]
        for pattern in patterns
        for path in sorted(folder.glob(pattern))
    )
    return next(found, None)


def replace_copy(program: Path) -> None:
    """Find maps in a program's copy of the gym, in its worker processes, too, and announce it."""
    os.environ.pop(OWN_MAPS, None)  # left by another program
    found = find_copy(program)
    if found is not None:
        os.environ[OWN_MAPS] = str(found / "envs" / "maps")
        say(
            f"{found} is not run: pcs_racing.f1tenth takes its place, with the defaults of the"
            " gym; give defaults of your own, such as timestep and params, to gym.make"
        )
