"""Executors for the tasks of a long job: this thread, threads, processes, or a dask cluster."""

import gc
import logging
import os
import platform
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from pickle import dumps, loads
from typing import Any

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.planners.own_files import files_run, run_file
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.base.folders import JobError, package_version

EXECUTORS = ("serial", "threads", "processes", "dask")

ANSWER_SECONDS = 5.0
"""Time limit for a scheduler's response, s."""
CONNECT_ATTEMPTS = 3
"""Maximum number of requests for a dask client, if dask's own thread does not start."""
WORKER_SECONDS = 60.0
"""Time limit for a scheduler's first worker, s."""
LARGE = 100_000
"""Size in bytes above which a function is sent once, not with every task."""

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_log = logging.getLogger("pcs_racing_agents")


@contextmanager
def make_executor(
    kind: str = "threads", workers: int | None = None, address: str | None = None
) -> Iterator[Executor | None]:
    """Provide an executor for the duration of a ``with`` block; None for "serial".

    Parameters
    ----------
    kind : {"serial", "threads", "processes", "dask"}
        Kind: one task after the other; threads of this process; processes of this machine; workers
        of a dask cluster. Processes are spawned, so a script needs ``if __name__ == "__main__":``.
    workers : int, optional
        Number of workers; by default the number of cores that this process may use. A running dask
        cluster has its own workers.
    address : str, optional
        Address of a running dask scheduler, like ``tcp://host:8786``; without an address a cluster
        of processes is started here.
    """
    if kind not in EXECUTORS:
        raise InputError(f"executor is {kind!r}; it must be one of {', '.join(EXECUTORS)}")
    if workers is not None:
        check_whole("workers", workers, 1, 10_000)
    if address is not None and kind != "dask":
        raise InputError(
            f"a scheduler's address ({address}) goes with the executor dask, not with {kind}"
        )
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
        pool = ProcessPoolExecutor(count, get_context("spawn"), _prepare, (files_run(),))
        with _one_thread_each(), _shut_down(pool) as executor:
            yield executor


def tasks_in_flight(executor: Executor | None) -> int:
    """Return the number of tasks to submit before the first wait: enough to keep workers busy."""
    if executor is None:
        return 1
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
    """Provide a ``submit`` function that sends a large function to the workers only once.

    A game with its track is such a function. Threads get the function itself. Other processes of
    this machine read it from a temporary file. A dask cluster passes it from worker to worker, and
    makes it again if the worker that had it is gone.
    """
    client = _dask_client(executor)
    submit: Callable[..., Any] = executor.submit
    if client is None and not isinstance(executor, ProcessPoolExecutor):
        yield partial(submit, call_task, function)
        return
    packed = dumps(function)
    if len(packed) < LARGE:
        yield partial(submit, _call, function)
    elif client is not None:
        import dask

        # large, but only once
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "4GB"}):
            sent = client.submit(loads, packed, pure=False)
        yield partial(submit, _call, sent)
    else:
        # A file instead of an argument: a ProcessPoolExecutor pickles its arguments again for every
        # task.
        with tempfile.TemporaryDirectory(prefix="pcs-racing-") as folder:
            file = Path(folder) / "function"
            file.write_bytes(packed)
            yield partial(submit, _call_packed, str(file))


def call_task(function: Callable[..., Any], argument: Any) -> Any:
    """Call the function of a task; ``SystemExit`` is an error of this task, not the end of the
    process.
    """
    try:
        return function(argument)
    except SystemExit as error:
        raise JobError(
            f"a task ended with SystemExit({error.code!r}); it must return its result"
        ) from error


def _call(function: Callable[..., Any], argument: Any) -> Any:
    """Call a task in another process; errors that don't unpickle would look like dead workers."""
    try:
        return call_task(function, argument)
    except Exception as error:
        try:
            loads(dumps(error))
        except Exception:
            kind = type(error)
            raise RuntimeError(f"{kind.__module__}.{kind.__qualname__}: {error}") from error
        raise


def _call_packed(file: str, argument: Any) -> Any:
    return _call(_unpacked(file), argument)


# Room for the functions of a few tracks with alternating tasks.
@lru_cache(maxsize=4)
def _unpacked(file: str) -> Any:
    return loads(Path(file).read_bytes())


@contextmanager
def _shut_down(executor: Executor) -> Iterator[Executor]:
    """Shut down like the executor's own context, but drop waiting tasks after an exception."""
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=True, cancel_futures=True)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit linear algebra to one thread in new processes: more would compete for the cores."""
    before = {key: os.environ.get(key) for key in _ONE_THREAD}
    os.environ.update({key: "1" for key in _ONE_THREAD if before[key] is None})
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)


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
        # of a file that is gone or fails here, the task that needs it reports the error
        with suppress(InputError):
            run_file(file)


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _errors_alone(log: logging.Logger) -> Iterator[None]:
    """Hide a cluster's messages at its start and end: a screen of lines, more after Ctrl-C."""
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


@contextmanager
def _dask(workers: int, address: str | None) -> Iterator[Executor]:
    try:
        import dask
        from dask.distributed import Client, LocalCluster
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'the executor dask needs dask.distributed: pip install "pcs-racing[cluster]"'
        ) from None
    if address is None:
        # Port 0 is any free port: another cluster may use the usual port.
        dashboard = {"dashboard": False, "dashboard_address": ":0"}
        quiet: dict[str, Any] = {"silence_logs": logging.ERROR, "scheduler_kwargs": dashboard}
        with (
            _errors_alone(logging.getLogger("distributed")),
            _one_thread_each(),
            # a busy machine starts workers slowly
            dask.config.set({"distributed.comm.timeouts.connect": "120s"}),
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, **quiet
            ) as cluster,
            Client(cluster) as client,
        ):
            client.run(_prepare, files_run())
            yield client.get_executor(pure=False)
        return
    with _client(Client, address) as client:
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise InputError(
                f"the dask scheduler at {address} has no workers; start some: dask worker {address}"
                " --nthreads 1"
            ) from None
        _check_workers(client.run(worker_identity))
        client.run(_run_files, files_run())
        yield client.get_executor(pure=False)


def _client(make: Callable[..., Any], address: str) -> Any:
    """Connect to a scheduler; dask gives its own thread only 10 s, too few on a busy machine."""
    for _ in range(CONNECT_ATTEMPTS):
        try:
            return make(address, timeout=ANSWER_SECONDS)
        # dask raises this error if its own thread has not started in time.
        except AssertionError:
            failed = ""
        except (OSError, ValueError, TimeoutError) as error:
            failed = f"no dask scheduler answers at {address}: {error}"
        # A failed client closes itself when it is collected. During the start of another client,
        # which holds the lock that closing needs, both would wait for ever.
        gc.collect()
        if failed:
            raise InputError(failed)
    raise JobError(
        "dask's own thread does not start: this machine is too busy; start the same again to go on"
    )


def worker_identity() -> dict[str, str]:
    """Return library versions ("" if missing) and the processor: equal values give equal bytes."""
    from llvmlite import binding

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return ""

    return {
        "pcs-racing": package_version(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{
            name: installed(name)
            for name in ("numpy", "numba", "llvmlite", "torch", "stable-baselines3")
        },
        "processor": os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name(),
    }


def _check_workers(identities: dict[str, dict[str, str]]) -> None:
    """Raise an error if a worker has other versions than this process; warn of another processor."""
    own = worker_identity()
    for address, other in identities.items():
        for key, value in other.items():
            # A task that needs a missing library fails with its own error.
            if value == own[key] or "" in (value, own[key]):
                continue
            if key != "processor":
                raise InputError(
                    f"the worker at {address} has {key} {value}, not {own[key]}; install the same"
                    " there"
                )
            _log.warning(
                "the worker at %s has a processor of another kind (%s, here %s): what is trained or"
                " searched there may differ in the last bit from what one machine makes",
                address,
                value,
                own[key],
            )
