"""Job folders: a manifest that records the settings, and a lock for one process at a time.

A digest next to the manifest distinguishes a damaged manifest, which is written again, from a
manifest of other settings.
"""

import hashlib
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
DIGEST = ".job.sha256"  # file with the manifest's digest
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
    check_path("the folder of a job", folder)
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
    digest = hashlib.sha256(text.encode()).hexdigest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _check_same(folder, manifest, digest)
        lock = _take_lock(folder)
    except OSError as error:
        raise _unusable(folder, error) from None
    with lock:
        try:
            # Again under the lock: another process may have begun in between.
            if not _check_same(folder, manifest, digest):
                write_atomically(folder / DIGEST, lambda file: file.write(digest.encode()))
                write_atomically(folder / "job.yaml", lambda file: file.write(text.encode()))
            clear_half_written(folder)
        except OSError as error:
            raise _unusable(folder, error) from None
        yield manifest["settings"]


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Create and lock a folder without a manifest: for short work that is never resumed."""
    check_path("the folder", folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _take_lock(folder)
        clear_half_written(folder)
    except OSError as error:
        raise _unusable(folder, error) from None
    with lock:
        yield
        # On Windows a locked file can't be deleted.
        with suppress(OSError):
            (folder / ".lock").unlink(missing_ok=True)


def clear_half_written(folder: Path) -> None:
    """Delete partial files of killed runs, also in ``chunks`` (:mod:`pcs_racing.base.files`)."""
    for file in [*folder.glob(".*"), *folder.glob("chunks/.*")]:
        if _HALF_WRITTEN.fullmatch(file.name):
            shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)


def read_job(file: Path) -> Any:
    """Return the content of a job's manifest, unchecked."""
    return plain_yaml(read_limited(file, _MAX_BYTES, "a manifest of a job"))


def is_unchanged(folder: Path) -> bool:
    """Return whether a job's manifest matches its digest; True if there is no digest."""
    seal = folder / DIGEST
    text = read_limited(folder / "job.yaml", _MAX_BYTES, "a manifest of a job")
    return (
        not seal.exists()
        or read_limited(seal, 100, "a digest") == hashlib.sha256(text).hexdigest().encode()
    )


def package_version() -> str:
    """Return the version of the installed package; ``"0"`` in a checkout that is not installed."""
    try:
        return version("pcs-racing")
    except PackageNotFoundError:
        return "0"


def _unusable(folder: Path, error: OSError) -> JobError:
    return JobError(
        f"can't work in the folder {folder}: {error.strerror} ({error.filename or folder})"
    )


def _check_same(folder: Path, manifest: Mapping[str, Any], digest: str) -> bool:
    """Return whether a folder holds this manifest; False if it or its digest must be written."""
    file = folder / "job.yaml"
    with suppress(OSError, InputError):
        if read_limited(folder / DIGEST, 100, "a digest") == digest.encode():
            # Every chunk has its own digest, so no result is trusted because of this check.
            return (
                file.exists()
                and hashlib.sha256(read_limited(file, _MAX_BYTES, "")).hexdigest() == digest
            )
    if not file.exists():
        others = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))
        if others:
            raise InputError(
                f"{folder} holds {others[0]} but no job.yaml; choose a new or an empty folder"
            )
        return False
    try:
        earlier = read_job(file)
    except InputError:
        earlier = None
    if not isinstance(earlier, dict) or earlier.get("format") != FORMAT:
        raise InputError(
            f"{file} is no manifest of a job; choose a new or an empty folder, or, if it was"
            " damaged, the settings of the run that made it"
        )
    for key, noun in (
        ("version", "format version"),
        ("kind", "kind"),
        ("package", "package version"),
    ):
        if earlier.get(key) != manifest[key]:
            raise InputError(
                f"{folder} holds another run: its {noun} is {earlier.get(key)!r}, not"
                f" {manifest[key]!r}; choose another folder"
            )
    difference = _difference(earlier.get("settings"), manifest["settings"], "")
    if difference is not None:
        raise InputError(
            f"{folder} holds another run: {difference}; choose another folder, or those settings"
        )
    # the digest is missing or damaged: without it the next damage would make the folder unusable
    return False


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
