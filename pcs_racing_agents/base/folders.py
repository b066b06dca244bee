"""Job folders: a manifest that records the settings, and a lock for one process at a time."""

import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from filelock import FileLock, Timeout

from pcs_racing.base.checks import check_path
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import plain_yaml, read_limited, write_atomically

FORMAT = "pcs-racing job"
VERSION = 1
GO_ON = "completed work is saved; fix this and rerun the same command to resume"
_MAX_BYTES = 10_000_000
_HALF_WRITTEN = re.compile(r"\..+\.[0-9a-f]{8}")


class JobError(InputError):
    """Error of a job that can't continue now; finished tasks are saved.

    The message says how to continue.
    """


@contextmanager
def claim_folder(
    folder: Path, kind: str, settings: Mapping[str, Any]
) -> Iterator[Mapping[str, Any]]:
    """Create a job's folder, or open the folder of an earlier run with equal settings; lock it.

    The settings are provided as plain values.
    """
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "kind": kind,
        "package": package_version(),
        "settings": _plain(settings, "settings"),
    }
    text = yaml.safe_dump(manifest, sort_keys=False, allow_unicode=True, width=110)
    # Read back, so that it is compared in the form that a later run reads.
    manifest = yaml.safe_load(text)
    check_path("the folder of a job", folder)
    with _named(folder):
        _check_same(folder, manifest)
    with hold_folder(folder):
        # Again under the lock: another process may have begun in between.
        with _named(folder):
            _check_same(folder, manifest)
            if not (folder / "job.yaml").exists():
                write_atomically(folder / "job.yaml", text)
        yield manifest["settings"]


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Create and lock a folder, and delete what killed runs left half-written."""
    check_path("the folder", folder)
    with _named(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = _take_lock(folder)
        clear_half_written(folder)
    with lock:
        yield
        # On Windows a locked file can't be deleted.
        with suppress(OSError):
            (folder / ".lock").unlink()


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


@contextmanager
def _named(folder: Path) -> Iterator[None]:
    """Turn errors of the operating system into errors that name the folder."""
    try:
        yield
    except OSError as error:
        raise JobError(
            f"can't work in the folder {folder}: {error.strerror} ({error.filename or folder})"
        ) from None


def _check_same(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a folder of another run, or with other content; a new or empty folder is fine."""
    file = folder / "job.yaml"
    if not file.exists():
        others = sorted(
            entry.name
            for entry in (folder.iterdir() if folder.exists() else ())
            if not entry.name.startswith(".")
        )
        # Chunks say for which task and settings they were made: a lost manifest loses no work.
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
    facts = {key: value for key, value in manifest.items() if key != "settings"}
    difference = _difference({key: earlier.get(key) for key in facts}, facts, "") or _difference(
        earlier.get("settings"), manifest["settings"], ""
    )
    if difference is not None:
        raise InputError(
            f"{file} holds another run: {difference}; choose another folder, or those settings"
        )


def _difference(stored: Any, wanted: Any, where: str) -> str | None:
    """Return a clause that names the first difference between two plain values; None if they are
    equal.
    """
    if isinstance(stored, dict) and isinstance(wanted, dict):
        for key in [*stored, *(key for key in wanted if key not in stored)]:
            inner = f"{where}.{key}" if where else str(key)
            if key not in wanted:
                return f"its {inner} is {stored[key]!r}, which these settings do not have"
            if key not in stored:
                return f"it has no {inner}, which is {wanted[key]!r} in these settings"
            difference = _difference(stored[key], wanted[key], inner)
            if difference is not None:
                return difference
        return None
    # Compared as texts: there NaN equals NaN, and 1 differs from true.
    same = yaml.safe_dump(stored) == yaml.safe_dump(wanted)
    return None if same else f"its {where or 'settings'} is {stored!r}, not {wanted!r}"


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist(), where)
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value), where)
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, where) for item in value]
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, Path):
        return str(value)
    raise InputError(
        f"{where} is {value!r}; the settings of a job must be texts, numbers, lists and mappings"
    )


def _take_lock(folder: Path) -> AbstractContextManager[Any]:
    """Lock a folder until a ``with`` block or the process ends; the lock file names the process."""
    file = folder / ".lock"
    try:
        # The operating system releases the lock however the process ends: no stale locks remain.
        held = FileLock(file).acquire(blocking=False)
    except Timeout:
        owner = "(unknown)"
        # On Windows no other process can read a locked file.
        with suppress(OSError):
            owner = file.read_text(encoding="ascii", errors="replace").strip() or owner
        raise JobError(
            f"{folder} is in use by process {owner}; wait until it ends, or choose another folder"
        ) from None
    with suppress(OSError):
        file.write_text(f"{os.getpid()}\n", encoding="ascii")
    return held
