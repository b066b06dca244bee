"""Jobs: tasks on any executor, with results in chunk files, and stopped runs that resume.

A job is a folder. ``job.yaml`` describes its results, ``chunks/`` holds the result of every
finished task, and a lock excludes a second process. A run that opens the folder again with the same
settings resumes the work after Ctrl-C, a crash or ``kill -9``. The results are the same to the
byte, whichever run computed them:

    with open_job("out/trees", "trees", {"seed": 0}) as job, make_executor() as executor:
        results = job.run("tree", build, tasks, executor=executor, progress=show_progress("trees"))
"""

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.chunks import Arrays, chunk_file, read_chunk, write_chunk
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.folders import claim_folder, package_version
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.tasks import run_tasks

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
