"""Where the tasks of a long job run: in this thread, in threads, in processes, or on a dask cluster."""

import argparse
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import connection, get_context, parent_process

from pcs_racing.errors import InputError
from pcs_racing.race import default_threads

__all__ = ["EXECUTORS", "add_executor_options", "executor_from", "make_executor", "tasks_in_flight"]

EXECUTORS = {
    "serial": "one task after the other",
    "threads": "threads of this process; compiled code holds no lock",
    "processes": "processes of this machine",
    "dask": "workers of a dask cluster (--scheduler), or as many processes",
}

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def make_executor(
    kind: str = "threads", workers: int | None = None, address: str | None = None
) -> Iterator[Executor | None]:
    """Provide an executor for as long as a ``with`` block lasts.

    Parameters
    ----------
    kind : {"serial", "threads", "processes", "dask"}
        See :data:`EXECUTORS`. Processes are spawned, so a script needs ``if __name__ == "__main__":``.
    workers : int, optional
        How many; as many as this process may use cores by default. A running dask cluster has its own.
    address : str, optional
        Of a running dask scheduler, like ``tcp://host:8786``; without it a cluster of processes is started here.

    Yields
    ------
    Executor or None
        None for "serial".

    Raises
    ------
    InputError
        If the kind or the number is impossible, or no scheduler answers.
    ModuleNotFoundError
        If dask is asked for and not installed.
    """
    if kind not in EXECUTORS:
        raise InputError(f"executor is {kind!r}; it must be one of {', '.join(EXECUTORS)}")
    if workers is not None and (
        isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 10_000
    ):
        raise InputError(f"workers is {workers!r}; it must be a whole number from 1 to 10000")
    if address is not None and kind != "dask":
        raise InputError(f"a scheduler's address ({address}) goes with the executor dask, not with {kind}")
    count = workers or default_threads()
    if kind == "serial":
        yield None
    elif kind == "dask":
        with _dask(count, address) as executor:
            yield executor
    elif kind == "threads":
        with _shut_down(ThreadPoolExecutor(count, "pcs-racing")) as executor:
            yield executor
    else:
        with _one_thread_each(), _shut_down(ProcessPoolExecutor(count, get_context("spawn"), _prepare)) as executor:
            yield executor


def tasks_in_flight(executor: Executor | None) -> int:
    """How many tasks to hand to an executor before waiting for the first: enough that no worker waits for the next."""
    if executor is None:
        return 1
    client = getattr(executor, "_client", None)  # dask's; its workers come and go
    workers = sum(client.ncores().values()) if client is not None else getattr(executor, "_max_workers", 16)
    return max(2, 2 * workers)


@contextmanager
def _shut_down(executor: Executor) -> Iterator[Executor]:
    """Like the executor's own context, but tasks that have not begun are dropped when something is raised."""
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=True, cancel_futures=True)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Keep linear algebra to one thread in processes started now: several of them would fight for the cores."""
    before = {key: os.environ.get(key) for key in _ONE_THREAD}
    os.environ.update({key: "1" for key in _ONE_THREAD if before[key] is None})
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)


def _prepare() -> None:
    """Prepare a worker process: the parent hears Ctrl-C, and a worker whose parent was killed ends, too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _dask(workers: int, address: str | None) -> Iterator[Executor]:
    try:
        from dask.distributed import Client, LocalCluster
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'the executor dask needs dask.distributed: pip install "pcs-racing[cluster]"'
        ) from None
    if address is None:
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None)
        with _one_thread_each(), cluster, Client(cluster) as client:
            yield client.get_executor()
        return
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no dask scheduler answers at {address}: {error}") from None
    with client:
        if not client.ncores():
            client.wait_for_workers(1, timeout=60)
        yield client.get_executor()


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`executor_from` reads."""
    kinds = "; ".join(f"{kind}: {meaning}" for kind, meaning in EXECUTORS.items())
    parser.add_argument("--executor", choices=list(EXECUTORS), default="threads", help=f"{kinds} (default: threads)")
    parser.add_argument("--workers", type=int, metavar="N", help="threads or processes (default: the cores there are)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a running dask scheduler, like tcp://host:8786")


def executor_from(arguments: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """Return the executor that the options ask for, as a context."""
    return make_executor(arguments.executor, arguments.workers, arguments.scheduler)
