"""Learned planners of all kinds, from folders."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import MAX_YAML, read_limited
from pcs_racing.planners.field.lidar_ppo import LIDAR_FORMAT, load_lidar_planner
from pcs_racing.planners.line_ppo import LINE_FORMAT, load_line_planner
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.racers import Reader, Request
from pcs_racing.planners.registry import policy_of
from pcs_racing.planners.shipped import split_name

LOADERS = {LIDAR_FORMAT.noun: load_lidar_planner, LINE_FORMAT.noun: load_line_planner}
"""Loaders of learned planners by the kind of their folders."""


def folder_kind(folder: str | Path) -> str:
    """Return the kind of a folder: the format that its manifest begins with, or else its line.

    It is empty without a manifest.
    """
    file = Path(folder) / MANIFEST
    if not file.is_file():
        return ""
    content = read_limited(file, MAX_YAML, "a manifest", InputError)
    line = content.decode("utf-8", "replace").partition("\n")[0].strip()
    return line.removeprefix("format: pcs-racing ")


def wrong_kind(folder: Path, kind: str, known: Iterable[str]) -> InputError:
    """Return the error for a folder of another kind."""
    found = f"a folder of {kind!r:.80}" if kind else "no folder with a manifest"
    return InputError(f"{folder} is {found}; it must be of {', '.join(known)}")


def load_planner(folder: str | Path) -> Planner:
    """Return the learned planner of a folder; its name is the folder."""
    kind = folder_kind(folder)
    if kind not in LOADERS:
        raise wrong_kind(Path(folder), kind, LOADERS)
    return replace(LOADERS[kind](folder), name=str(folder))


def read_learned(request: Request) -> Policy | None:
    """Return the policy of a trained planner's folder."""
    place = split_name(request.text)[0]
    if not place or folder_kind(place) not in LOADERS:
        best = Path(place, "best")
        if place and folder_kind(best) in LOADERS:
            raise InputError(f"{place} is the folder of a training; its best network is {best}")
        return None
    return policy_of(load_planner(place), request.text)


LEARNED = Reader(read_learned)
