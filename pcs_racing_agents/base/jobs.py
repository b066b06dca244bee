"""Jobs: tasks on any executor, with results in chunk files, and stopped runs that resume.

A job is a folder. ``job.yaml`` describes its results, ``chunks/`` holds the result of every
finished task, and a lock excludes a second process. A run that opens the folder again with the same
settings resumes the work after Ctrl-C, a crash or ``kill -9``. The results are the same to the
byte, whichever run computed them:

    with open_job("out/trees", "trees", {"seed": 0}) as job, make_executor() as executor:
        results = job.run("tree", build, tasks, executor=executor, progress=show_progress("trees"))

Chunks: files with the result of one task each; damage and results of other tasks are detected.

A chunk is an ordinary ``.npz`` file of arrays. Its zip comment holds two SHA-256 digests: the
digest of its task, and the digest of the file itself, which is compared before any content of the
file is interpreted.

Progress of long work, as a line on the terminal.
"""

import hashlib
import io
import logging
import re
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, unpack_arrays, write_atomically
from pcs_racing_agents.base.executors import run_tasks
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.folders import claim_folder, package_version

Progress = Callable[[int, int, str], None]
"""``progress(done, total, label)``: called after every finished task."""


def show_progress(unit: str = "races") -> Progress:
    """Return a progress function that keeps a line on stderr up to date.

    If stderr is no terminal, it prints plain lines: at most one line every 2 s, and the last line.
    """
    begin = spoken = time.monotonic()
    first: tuple[float, int] | None = None

    def show(done: int, total: int, label: str) -> None:
        nonlocal first, spoken
        now = time.monotonic()
        # Earlier runs say nothing about the speed of this run.
        if first is None:
            first = (now, done) if now - begin < 0.2 else (begin, 0)
        line = f"{done}/{total} {unit}, {now - begin:.0f} s"
        if done < total and done > first[1]:
            left = (now - first[0]) * (total - done) / (done - first[1])
            line += f", about {duration_text(left)} left"
        if done < total:
            line += f": {label}"
        if sys.stderr.isatty():
            end = "\n" if done >= total else ""
            print(f"\r\x1b[K{line:.110}", end=end, file=sys.stderr, flush=True)
        elif done >= total or now - spoken >= 2.0:
            spoken = now
            print(line, file=sys.stderr, flush=True)

    return show


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"90 s"``, ``"5 min"``, ``"2.5 h"``."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


Arrays = dict[str, NDArray[Any]]

_MARK = b"pcs-racing chunk "
_COMMENT = len(_MARK) + 128
_MAX_BYTES = 4_000_000_000


def chunk_file(folder: str | Path, name: str, index: int) -> Path:
    """Return the path of a task's chunk in a job's folder."""
    return Path(folder) / "chunks" / f"{name}-{index:05d}.npz"


def write_chunk(path: Path, arrays: Arrays, task: str) -> None:
    """Write a chunk atomically: arrays without objects; equal arrays make equal files.

    ``task`` is the digest of the task, 64 hexadecimal digits
    (:func:`~pcs_racing_agents.base.fingerprint.fingerprint`).
    """
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    # A zip file ends with the length of its comment, which np.savez leaves at 0.
    body = buffer.getvalue()[:-2] + struct.pack("<H", _COMMENT)
    comment = _MARK + task.encode() + _digest(body, task).encode()
    write_atomically(path, lambda file: (file.write(body), file.write(comment)))


def read_chunk(path: Path, task: str | None = None) -> Arrays:
    """Read a chunk after a check that its bytes are as written and that it belongs to ``task``."""
    try:
        content = read_limited(path, _MAX_BYTES, "a chunk")
    except OSError as error:
        raise InputError(f"{path} can't be read: {error.strerror}") from None
    # The digest is compared before any content is interpreted: a damaged zip file can mislead its
    # reader.
    body, comment = content[:-_COMMENT], content[-_COMMENT:]
    written_for = comment[len(_MARK) : len(_MARK) + 64].decode("latin-1")
    if (
        not comment.startswith(_MARK)
        or _digest(body, written_for).encode() != comment[len(_MARK) + 64 :]
    ):
        raise InputError(f"{path} is damaged: its content has changed")
    if task is not None and written_for != task:
        raise InputError(f"{path} belongs to another task or another run")
    try:
        return unpack_arrays(content, _MAX_BYTES)
    except InputError as error:
        raise InputError(f"{path} holds no arrays: {error}") from None


def _digest(body: bytes, task: str) -> str:
    return hashlib.sha256(body + task.encode("latin-1")).hexdigest()


A = TypeVar("A")

_log = logging.getLogger("pcs_racing_agents")


@dataclass(frozen=True)
class Job:
    """Folder for long work; made by :func:`open_job`."""

    folder: Path
    kind: str  #: Kind of the results.
    settings: Mapping[str, Any]  #: All inputs of the results, as plain values.

    def file(self, name: str, index: int) -> Path:
        """Return the path of a task's chunk."""
        return chunk_file(self.folder, name, index)

    def run(
        self,
        name: str,
        function: Callable[[A], Mapping[str, Any]],
        arguments: Sequence[A],
        *,
        executor: Executor | None = None,
        progress: Progress | None = None,
        keep: bool = True,
    ) -> list[Arrays]:
        """Return the results of all tasks in order; results of earlier runs come from their chunks.

        Parameters
        ----------
        name : str
            Name of the group of tasks: small letters, digits, ``-`` and ``_``. Its chunks are
            called ``NAME-00012.npz``.
        function : callable
            Function that returns arrays (or numbers) by name: ``function(argument)``. Other
            processes need a function defined in a module.
        arguments : sequence
            Argument of each task. It must contain all that the result depends on: a chunk of
            another argument is not used.
        executor : Executor, optional
            Executor of the tasks (:func:`make_executor`); this thread by default. It does not
            change the results.
        progress : callable, optional
            Called as ``progress(done, len(arguments), name)`` when the chunks are counted and after
            every task.
        keep : bool
            Whether to return the results. False returns an empty list, and memory does not grow
            with the tasks.
        """
        run: Run = {"job": self, "executor": executor, "progress": progress}
        return run_with_or_without(name, function, arguments, keep=keep, **run)

    def marks(self, name: str, arguments: Sequence[Any]) -> list[str]:
        """Return the digests of all inputs of the tasks."""
        if not re.fullmatch(r"[a-z0-9_-]{1,80}", name):
            raise InputError(
                f"the name of a group of tasks is {name!r}; use small letters, digits, - and _"
            )
        # All inputs of a result: a chunk of other settings or of another version is made again.
        identity = fingerprint(self.kind, self.settings, package_version(), name)
        return [fingerprint(identity, index, argument) for index, argument in enumerate(arguments)]

    def keep(self, name: str, index: int, value: Any, mark: str) -> Arrays:
        """Write the result of a task to its chunk."""
        arrays = _plain_arrays(value, f"task {index} of {name}")
        path = self.file(name, index)
        path.parent.mkdir(exist_ok=True)
        write_chunk(path, arrays, mark)
        return arrays

    def stored(self, name: str, index: int, mark: str) -> Arrays | None:
        """Return the stored result of a task; None if it is missing or damaged."""
        path = self.file(name, index)
        if not path.exists():
            return None
        try:
            return read_chunk(path, mark)
        except InputError as error:
            _log.warning("%s; it is made again", error)
            return None


class Workers(TypedDict, total=False):
    """Executor and progress, for functions that pass them on: ``**workers: Unpack[Workers]``."""

    executor: Executor | None
    progress: Progress | None


class Run(Workers, total=False):
    """Options of long work, with a job or without: ``def work(..., **run: Unpack[Run])``."""

    job: Job | None


def run_with_or_without(
    name: str,
    function: Callable[[A], Mapping[str, Any]],
    arguments: Sequence[A],
    *,
    keep: bool = True,
    **run: Unpack[Run],
) -> list[Any]:
    """Return the results of all tasks in order, as :meth:`Job.run`; save them if there is a job."""
    job, progress, total = run.get("job"), run.get("progress"), len(arguments)
    marks = [""] * total if job is None else job.marks(name, arguments)
    results: list[Any] = [{}] * total if keep else []
    missing = []
    for index, mark in enumerate(marks):
        stored = None if job is None else job.stored(name, index, mark)
        if stored is None:
            missing.append(index)
        elif keep:
            results[index] = stored
    done = total - len(missing)
    if progress is not None and job is not None:
        progress(done, total, name)
    tasks = run_tasks(function, (arguments[i] for i in missing), run.get("executor"), name)
    for number, value in tasks:
        index = missing[number]
        result = value if job is None else job.keep(name, index, value, marks[index])
        if keep:
            results[index] = result
        done += 1
        if progress is not None:
            progress(done, total, name)
    return results


def run_races(
    name: str, race: Callable[..., Mapping[str, Any]], arguments: Sequence[Any], **run: Unpack[Run]
) -> list[Any]:
    """Return the results of :func:`run_with_or_without` for a function that takes ``threads``."""
    # Without an executor all cores share the races; with an executor its workers share the cores.
    driven = race if run.get("executor") is None else partial(race, threads=1)
    return run_with_or_without(name, driven, arguments, **run)


def _plain_arrays(value: Any, where: str) -> Arrays:
    arrays = (
        {str(key): np.asarray(item) for key, item in value.items()}
        if isinstance(value, Mapping)
        else None
    )
    if arrays is None or any(array.dtype == object for array in arrays.values()):
        raise InputError(
            f"{where} returned {type(value).__name__}; it must return arrays and numbers by name"
        )
    return arrays


# Opening a folder


@contextmanager
def open_job(folder: str | Path, kind: str, settings: Mapping[str, Any]) -> Iterator[Job]:
    """Open the folder of a job: new, or of a stopped run of the same kind and settings.

    Parameters
    ----------
    folder : str or Path
        Folder that is new, empty, or made by this function.
    settings : Mapping
        All inputs of the results: texts, numbers, lists and mappings (arrays, tuples, paths and
        dataclasses become these).
    """
    with claim_folder(Path(folder), kind, settings) as plain:
        yield Job(Path(folder), kind, plain)
