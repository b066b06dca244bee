"""Output files of a synthesis: the archive with its manifest, the search history, and a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from pcs_racing.base.settings import plain_settings
from pcs_racing.base.typing import Floats
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.moves import duplicate_share, no_op_share
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.base.folders import package_version
from pcs_racing_agents.base.jobs import Arrays
from pcs_racing_agents.base.style import save_picture
from pcs_racing_agents.base.tables import Column, table_rows, write_csv
from pcs_racing_agents.policies.config import ArchiveConfig
from pcs_racing_agents.policies.evaluate import Evaluation, summarise
from pcs_racing_agents.policies.pareto import Scale, front_layers, hypervolume
from pcs_racing_agents.policies.picture import archive_picture

COURSE = (
    Column("generation"),
    Column("evaluations"),
    Column("hypervolume", format=".6f"),
    Column("front"),
    Column("own_crash", format=".4f"),
)
"""Columns of ``hypervolume.csv``."""


def write_archive(
    folder: Path,
    config: ArchiveConfig,
    explored: tuple[Floats, Evaluation],
    scale: Scale,
    parameters: Floats,
    raced: Arrays,
    history: Sequence[object],
    notes: Mapping[str, str | float],
) -> PolicyArchive:
    """Write an archive's files into a folder and return the archive.

    ``explored`` holds parameters and results of all policies raced in the search, ``parameters``,
    shape (K, P), the parameters of the archive's policies, and ``raced`` the races of their
    measurement. Hypervolumes have the units of ``scale``; ``history`` holds the progress after each
    generation (:data:`COURSE`), and ``notes`` further entries of the manifest.
    """
    measured = summarise(raced)
    coordinates = measured.coordinates
    archive = PolicyArchive(
        name=config.name,
        planner=config.planner,
        parameter_names=get_planner(config.planner).parameter_names,
        parameters=parameters,
        characteristics=config.axes,
        coordinates=coordinates,
        explored_parameters=explored[0],
        explored_coordinates=explored[1].coordinates,
        rules=config.race_rules.name,
        spread=measured.spread,
        own_crash=measured.own_crash,
        explored_own_crash=explored[1].own_crash,
    )
    facts = _facts(archive, raced, scale)
    settings = {**stated_settings(config), **_versions(), **notes, **facts}
    archive = replace(archive, settings={key: _rounded(value) for key, value in settings.items()})
    rows = table_rows(COURSE, history)
    write_csv(rows, folder / "hypervolume.csv")
    if find_spec("matplotlib") is not None:
        save_picture(archive_picture(archive), folder / "front.png")
    save_archive(archive, folder)
    return archive


def _facts(archive: PolicyArchive, raced: Arrays, scale: Scale) -> dict[str, str | float]:
    """Return the manifest's entries about the policies of an archive and their races."""
    points = scale(archive.coordinates)
    crashes = raced["own_crash"].mean(axis=1)
    axes = zip(archive.characteristics, scale.ideal, scale.nadir, strict=True)
    return {
        "policies": len(archive),
        "policies_not_beaten": int(np.sum(front_layers(points) == 0)),
        "hypervolume": hypervolume(points),
        "own_crash_mean": crashes.mean(),
        "own_crash_max": crashes.max(),
        "win_share": (raced["winner"] == 0).mean(),
        "no_op_share": no_op_share(archive),
        "duplicate_share": duplicate_share(archive),
        **{
            f"hypervolume_unit_{axis}": f"0 at {low:.4f}, 1 at {high:.4f} (initial sample)"
            for axis, high, low in axes
        },
        **{f"correlation_{a}_{b}": value for (a, b), value in archive.correlations.items()},
    }


def stated_settings(config: ArchiveConfig) -> dict[str, str | int | float | bool]:
    """Return every option of a synthesis as a text or a number."""
    values = {**plain_settings(config), "characteristics": list(config.axes)}
    texts = {
        key: ", ".join(map(str, value)) for key, value in values.items() if isinstance(value, list)
    }
    return {
        key: "none" if value is None else texts.get(key, value) for key, value in values.items()
    }


def _versions() -> dict[str, str]:
    libraries = ("numpy", "numba", "cma", "moocore")
    versions = {f"{library}_version": version(library) for library in libraries}
    return {"package_version": package_version(), **versions}


def _rounded(value: str | float) -> str | int | float | bool:
    """Return a number for the manifest, rounded to six significant digits."""
    if isinstance(value, str | bool | int):
        return value
    return float(f"{float(value):.6g}")
