"""Folders of policy archives: ``archive.npz`` and a manifest."""

import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import shipped_folder, unpack_arrays
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.registry import get_planner

_TEXTS = ("name", "planner", "rules")
_NAMES = ("parameter_names", "characteristics")
_ARRAYS = (
    "parameters",
    "coordinates",
    "ideal",
    "nadir",
    "explored_parameters",
    "explored_coordinates",
)
_OPTIONAL_ARRAYS = ("spread", "own_crash", "explored_own_crash")  # present if measured

ARCHIVE_FORMAT = ArtifactFormat(
    "archive",
    (*_TEXTS, *_NAMES, "settings", "arrays_sha256"),
    "save_archive",
    data_file="archive.npz",
    digest_key="arrays_sha256",
    max_bytes=256_000_000,
    shipped=shipped_folder(Path(__file__).resolve().parents[1], "archives"),
)


def save_archive(archive: PolicyArchive, folder: str | Path) -> Path:
    """Save an archive in a folder, created if missing; return the folder."""
    buffer = io.BytesIO()
    keys = [*_ARRAYS, *(key for key in _OPTIONAL_ARRAYS if getattr(archive, key) is not None)]
    np.savez_compressed(buffer, allow_pickle=False, **{key: getattr(archive, key) for key in keys})
    fields = {
        **{key: getattr(archive, key) for key in _TEXTS},
        **{key: list(getattr(archive, key)) for key in _NAMES},
        "settings": dict(archive.settings),
    }
    return ARCHIVE_FORMAT.save(folder, fields, buffer.getvalue())


def list_archives() -> list[str]:
    """Return the names of the archives shipped with the package, sorted."""
    return ARCHIVE_FORMAT.shipped_names()


def load_archive(source: str | os.PathLike[str] | PolicyArchive) -> PolicyArchive:
    """Return an archive from its shipped name or its folder; return an archive unchanged."""
    if isinstance(source, PolicyArchive):
        return source
    folder = ARCHIVE_FORMAT.find(source)
    fields, content = ARCHIVE_FORMAT.load(folder)
    del fields["arrays_sha256"]
    manifest, file = folder / MANIFEST, folder / ARCHIVE_FORMAT.data_file
    if not isinstance(fields["settings"], dict):
        raise InputError(f"{manifest}: settings is {fields['settings']!r}; it must be a mapping")
    for key in _NAMES:
        if not isinstance(fields[key], list):
            raise InputError(f"{manifest}: {key} is {fields[key]!r}; it must be a list of texts")
    try:
        arrays: dict[str, Any] = unpack_arrays(content)
    except InputError as error:
        raise InputError(f"{file} is no archive: {error}") from None
    if set(arrays) - set(_OPTIONAL_ARRAYS) != set(_ARRAYS):
        raise InputError(
            f"{file} holds {', '.join(sorted(arrays))}; an archive holds {', '.join(_ARRAYS)} and"
            f" perhaps {', '.join(_OPTIONAL_ARRAYS)}"
        )
    try:
        get_planner(fields["planner"])
        return PolicyArchive(**fields, **arrays)
    except InputError as error:
        raise type(error)(f"{folder}: {error}") from None
