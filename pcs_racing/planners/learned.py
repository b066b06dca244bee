"""Learned planners from folders, whatever their kind."""

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

LOADERS = {
    f"format: pcs-racing {LIDAR_FORMAT.noun}": load_lidar_planner,
    f"format: pcs-racing {LINE_FORMAT.noun}": load_line_planner,
}


def is_planner_folder(place: str | Path) -> bool:
    """Return whether a place is a folder with a manifest."""
    return (Path(place) / MANIFEST).is_file()


def folder_format(folder: str | Path) -> str:
    """Return the first line of a folder's manifest, which names the format of the folder."""
    content = read_limited(Path(folder) / MANIFEST, MAX_YAML, "a manifest", InputError)
    return content.decode("utf-8", "replace").partition("\n")[0].strip()


def load_planner(folder: str | Path) -> Planner:
    """Return the learned planner of a folder; its name is the folder."""
    first = folder_format(folder)
    if first not in LOADERS:
        raise InputError(
            f"{Path(folder) / MANIFEST} begins with {first[:80]!r}; a learned planner's begins with"
            f" one of {', '.join(map(repr, LOADERS))}"
        )
    return replace(LOADERS[first](folder), name=str(folder))


def read_learned(request: Request) -> Policy | None:
    """Return the policy of a trained planner's folder."""
    place = split_name(request.text)[0]
    if not place or not is_planner_folder(place) or folder_format(place) not in LOADERS:
        return None
    return policy_of(load_planner(place), request.text)


LEARNED = Reader(read_learned)
