"""Job folders: a manifest that records the settings, and a lock for one process at a time."""

import json
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from filelock import FileLock, Timeout

from pcs_racing.base.errors import InputError, check_path
from pcs_racing.base.files import plain_yaml, read_limited, write_atomically

FORMAT = "pcs-racing job"
VERSION = 1
_MAX_BYTES = 10_000_000
_HALF_WRITTEN = re.compile(r"\..+\.[0-9a-f]{8}")


class JobError(InputError):
    """Error of a job that can't continue now; finished tasks are saved."""


@contextmanager
def claim_folder(
    folder: Path, kind: str, settings: Mapping[str, Any]
) -> Iterator[Mapping[str, Any]]:
    """Create a job's folder, or open the folder of an earlier run with equal settings; lock it.

    The settings are provided as plain values.
    """
    facts = {"format": FORMAT, "version": VERSION, "kind": kind, "package": package_version()}
    plain = json.loads(json.dumps(settings, default=_plain))
    text = yaml.safe_dump(
        {**facts, "settings": plain}, sort_keys=False, allow_unicode=True, width=110
    )
    with _locked(folder):
        # Compared in the form that a later run reads.
        _check_same(folder, yaml.safe_load(text))
        clear_half_written(folder)
        if not (folder / "job.yaml").exists():
            write_atomically(folder / "job.yaml", text)
        yield plain


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Create and lock a folder, and delete half-written files of killed runs."""
    with _locked(folder):
        clear_half_written(folder)
        yield


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Create a folder, and lock it until the end of the ``with`` block or of the process."""
    check_path("the folder", folder)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / ".lock"
    try:
        # The operating system releases the lock however the process ends: no stale locks remain.
        lock = FileLock(file).acquire(blocking=False)
    except Timeout:
        raise JobError(
            f"{folder} is in use by another process; wait until it ends, or choose another folder"
        ) from None
    with lock:
        try:
            yield
        finally:
            # On Windows a locked file can't be deleted.
            with suppress(OSError):
                file.unlink()


def clear_half_written(folder: Path) -> None:
    """Delete partial files of killed runs, also in ``chunks`` (:mod:`pcs_racing.base.files`)."""
    for file in [*folder.glob(".*"), *folder.glob("chunks/.*")]:
        if _HALF_WRITTEN.fullmatch(file.name):
            shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)


def read_job(file: Path) -> Any:
    """Return the content of a job's manifest, unchecked."""
    return plain_yaml(read_limited(file, _MAX_BYTES, "a manifest of a job"))


def package_version() -> str:
    """Return the version of the installed package; ``"0"`` in a checkout that is not installed."""
    try:
        return version("pcs-racing")
    except PackageNotFoundError:
        return "0"


def _check_same(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a folder of another run, or with other content; a new or empty folder is fine."""
    file = folder / "job.yaml"
    if not file.exists():
        others = sorted(
            entry.name
            for entry in (folder.iterdir() if folder.exists() else ())
            if not entry.name.startswith(".")
        )
        # Chunks name their task and settings: a lost manifest loses no work.
        if others and not (folder / "chunks").is_dir():
            raise InputError(
                f"{folder} holds {others[0]} but no job.yaml; choose a new or an empty folder"
            )
        return
    try:
        earlier = read_job(file)
    except InputError:
        earlier = None
    if not isinstance(earlier, dict) or earlier.get("format") != FORMAT:
        raise InputError(
            f"{file} is no manifest of a job; choose a new or an empty folder, or, if it was"
            " damaged, delete it and rerun the same command to resume"
        )
    stored, wanted = (_flat(each, "") for each in (earlier, manifest))
    for where in [*stored, *wanted]:
        if stored.get(where) != wanted.get(where):
            raise InputError(
                f"{file} holds another run: its {where.removeprefix('settings.')} is"
                f" {stored.get(where, 'missing')}, not {wanted.get(where, 'given here')}; choose"
                " another folder, or those settings"
            )


def _flat(value: Any, where: str) -> dict[str, str]:
    """Return the values in nested mappings as texts, by their dotted names."""
    if not isinstance(value, dict) or not value:
        # As texts NaN equals NaN, and 1 differs from true.
        return {where: repr(value)}
    flat: dict[str, str] = {}
    for key, item in value.items():
        flat |= _flat(item, f"{where}.{key}" if where else str(key))
    return flat


def _plain(value: Any) -> Any:
    """Return a setting as a value of JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Path):
        return str(value)
    raise InputError(
        f"{value!r} is no setting of a job; it must be a text, number, list or mapping"
    )
