"""Executors for the tasks of a long job: threads, processes, or workers of a dask cluster.

Tasks on any executor: a bounded number in flight, one error if workers die.
"""

import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from itertools import islice
from multiprocessing import connection, get_context, parent_process
from operator import call
from pathlib import Path
from pickle import dumps, loads
from typing import Any, TypeVar, cast

from pcs_racing.base.errors import InputError, check_whole, require
from pcs_racing.planners.own_files import files_run, own_file
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.base.folders import JobError

ANSWER_SECONDS = 5.0
"""Time limit for a scheduler's response, s."""
WORKER_SECONDS = 60.0
"""Time limit for a scheduler's first worker, s."""

LIBRARIES = ("pcs-racing", "numpy", "numba", "llvmlite", "torch", "stable-baselines3")
"""Libraries that must be the same on all workers."""

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def make_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Provide an executor for the duration of a ``with`` block; by default threads on all cores.

    Parameters
    ----------
    workers : int, optional
        Number of processes of this machine, which run the tasks in place of threads. They are
        spawned, so a script needs ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a running dask scheduler, like ``tcp://host:8786``; its workers run the tasks.
    """
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield executor
    elif workers is not None:
        count, spawn = int(check_whole("workers", workers, 1, 10_000)), get_context("spawn")
        with (
            _one_thread_each(),
            ProcessPoolExecutor(count, spawn, _prepare, (files_run(),)) as executor,
        ):
            yield executor
    else:
        with ThreadPoolExecutor(default_threads(), "pcs-racing") as executor:
            yield executor


def tasks_in_flight(executor: Executor) -> int:
    """Return the number of tasks to submit before the first wait: enough to keep workers busy."""
    client = _dask_client(executor)  # its number of workers changes
    # Two tasks per worker: while one task runs the next is on its way, and few arrays wait in
    # memory.
    workers = sum(client.ncores().values()) if client is not None else max(8, default_threads())
    return max(2, 2 * workers)


def _dask_client(executor: Executor) -> Any:
    """Return the client of an executor of dask, or None."""
    if not type(executor).__module__.startswith("distributed."):
        return None
    from dask.distributed import Client

    return Client.current()


def is_lost(error: BaseException) -> bool:
    """Return whether an error means that workers are gone, rather than that a task failed."""
    return isinstance(error, BrokenExecutor | CancelledError) or type(error).__module__.startswith(
        "distributed."
    )


@contextmanager
def sent_once(function: Callable[..., Any], executor: Executor) -> Iterator[Callable[..., Any]]:
    """Provide a ``submit`` function that sends a function to the workers only once.

    A function may hold a game with its track. Threads get the function itself. Other processes of
    this machine read it from a temporary file. A dask cluster passes it from worker to worker, and
    makes it again if the worker that had it is gone.
    """
    client, submit = _dask_client(executor), cast(Callable[..., Any], executor.submit)
    if client is not None:
        import dask

        # large, but only once
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "4GB"}):
            sent = client.submit(loads, dumps(function), pure=False)
        yield partial(submit, call, sent)
    elif isinstance(executor, ProcessPoolExecutor):
        # A file instead of an argument: the executor pickles its arguments again for every task.
        with tempfile.TemporaryDirectory(prefix="pcs-racing-") as folder:
            file = Path(folder) / "function"
            file.write_bytes(dumps(function))
            yield partial(submit, _call_packed, str(file))
    else:
        yield partial(submit, function)


def _call_packed(file: str, argument: Any) -> Any:
    return _unpacked(file)(argument)


# Room for the functions of a few tracks with alternating tasks.
@lru_cache(maxsize=4)
def _unpacked(file: str) -> Any:
    return loads(Path(file).read_bytes())


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit linear algebra to one thread in new processes: more would compete for the cores."""
    added = [key for key in _ONE_THREAD if key not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for key in added:
            del os.environ[key]


def _prepare(files: Sequence[str]) -> None:
    """Prepare a worker: ignore Ctrl-C (for the parent), end with the parent, and run own files."""
    # Ctrl-C reaches the whole group of processes; a worker that ends with it would look like a
    # crash.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    _run_files(files)


def _run_files(files: Sequence[str]) -> None:
    for file in files:
        # A file may be gone or fail here: the task that needs it reports the error.
        with suppress(InputError):
            own_file(file)


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    require("distributed", extra="cluster")
    from dask.distributed import Client

    try:
        client = Client(scheduler, timeout=ANSWER_SECONDS)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no dask scheduler answers at {scheduler}: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise InputError(
                f"the dask scheduler at {scheduler} has no workers; start some: dask worker"
                f" {scheduler} --nthreads 1"
            ) from None
        _check_workers(cast(Any, client.get_versions(packages=LIBRARIES)))
        client.run(_run_files, files_run())
        yield client.get_executor(pure=False)


def _check_workers(found: Mapping[str, Any]) -> None:
    """Refuse workers with other versions than this process: they would give other bytes.

    ``found``: result of ``Client.get_versions``.
    """
    own = found["client"]["packages"]
    for address, worker in found["workers"].items():
        for name in ("python", *LIBRARIES):
            versions = (worker["packages"][name], own[name])
            # A task that needs a missing library fails with its own error.
            if None not in versions and versions[0] != versions[1]:
                raise InputError(
                    f"the worker at {address} has {name} {versions[0]}, not {versions[1]}; install"
                    " the same there"
                )


A = TypeVar("A")
R = TypeVar("R")


def run_tasks(
    function: Callable[[A], R],
    arguments: Iterable[A],
    executor: Executor | None = None,
    name: str = "the work",
) -> Iterator[tuple[int, R]]:
    """Call a function with each argument; yield numbers from 0 and results as they come in.

    ``arguments`` is advanced only when a task can begin, so that not all of them need be in memory.
    ``name`` describes the work in errors.
    """
    waiting = enumerate(arguments)
    if executor is None:
        yield from ((number, function(argument)) for number, argument in waiting)
        return
    limit = tasks_in_flight(executor)
    under_way: dict[Future[R], int] = {}
    try:
        with sent_once(function, executor) as submit:
            while True:
                for number, argument in islice(waiting, limit - len(under_way)):
                    under_way[submit(argument)] = number
                if not under_way:
                    return
                done = wait(under_way, return_when=FIRST_COMPLETED).done
                # Results of other tasks are yielded before a failure ends the run.
                for future in sorted(done, key=_failed):
                    yield under_way.pop(future), future.result()
    except BaseException as error:
        if not is_lost(error):
            raise
        # Lost workers fail many futures at once; the first error is enough for the message.
        why = " ".join(str(error).split()) or "its tasks were cancelled"
        raise JobError(
            f"{name} was cut short: a worker died or the cluster is gone ({why}); completed work is"
            " saved; fix this and rerun the same command to resume"
        ) from None
    finally:
        for future in under_way:
            future.cancel()


def in_other_processes(executor: Executor | None) -> Executor | None:
    """Return the executor if its tasks run in other processes, else None.

    Training with torch needs other processes: torch's random generator and number of threads belong
    to the process.
    """
    return None if isinstance(executor, ThreadPoolExecutor) else executor


def _failed(future: Future[R]) -> bool:
    return future.cancelled() or future.exception() is not None
