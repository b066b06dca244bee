"""Tasks handed to an executor: a bounded number of them under way, results as they come, one error when workers die."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar, cast

from pcs_racing_agents.jobs.executors import is_lost, sent_once, tasks_in_flight
from pcs_racing_agents.jobs.folders import GO_ON, JobError

__all__ = ["Work", "completed", "each", "in_other_processes", "run_one"]

K = TypeVar("K")
R = TypeVar("R")
T = TypeVar("T")


class Work(NamedTuple, Generic[K]):
    """A task for a function.

    Attributes
    ----------
    key
        What the result is known by.
    function : callable
        ``function(task)``; a large one that is the same object for several tasks travels only once.
    task
    """

    key: K
    function: Callable[[Any], Any]
    task: Any


def completed(
    following: Callable[[], Work[K] | None], executor: Executor | None, name: str = "the work"
) -> Iterator[tuple[K, Any]]:
    """Do tasks, and return the results as they come in, with a bounded number of tasks under way.

    Parameters
    ----------
    following : callable
        Returns the next task that can be done now, or None. It is asked again after every result: one task may follow
        from another. Tasks are made when they are asked for, so that they need not all be in memory.
    executor : Executor, optional
        Where they are done; in this thread by default.
    name : str
        What is being done, for errors.

    Yields
    ------
    key
        Of a task.
    result

    Raises
    ------
    JobError
        If the executor is broken: a worker died, or the cluster is gone.
    """
    if executor is None:
        while (work := following()) is not None:
            yield work.key, work.function(work.task)
        return
    limit = tasks_in_flight(executor)
    under_way: dict[Future[Any], K] = {}
    submit: dict[int, Callable[..., Future[Any]]] = {}  # by identity: functions may hold arrays
    functions: list[Callable[[Any], Any]] = []
    try:
        with ExitStack() as sent:
            while True:
                while len(under_way) < limit and (work := following()) is not None:
                    if id(work.function) not in submit:
                        functions.append(work.function)  # as long as it lives nothing else has its identity
                        submit[id(work.function)] = sent.enter_context(sent_once(work.function, executor))
                    under_way[submit[id(work.function)](work.task)] = work.key
                if not under_way:
                    return
                ended = wait(under_way, return_when=FIRST_COMPLETED).done
                for future in sorted(ended, key=_failed):  # what others have done is kept before a failure ends the run
                    key = under_way.pop(future)
                    yield key, future.result()
    except BaseException as error:
        if not is_lost(error):
            raise
        why = " ".join(str(error).split()) or "its tasks were cancelled"
        raise JobError(f"{name} was cut short: a worker died or the cluster is gone ({why}); {GO_ON}") from None
    finally:
        for future in under_way:
            future.cancel()


def each(function: Callable[[T], Any], tasks: Iterable[T]) -> Callable[[], Work[int] | None]:
    """Return what :func:`completed` asks for tasks that do not depend on each other; keys count them from 0."""
    return partial(next, (Work(i, function, task) for i, task in enumerate(tasks)), None)


def run_one(function: Callable[[T], R], task: T, executor: Executor | None, name: str = "the work") -> R:
    """Return the result of a single task; see :func:`completed`."""
    ((_, result),) = completed(each(function, [task]), executor, name)
    return cast(R, result)


def in_other_processes(executor: Executor | None) -> Executor | None:
    """Return an executor whose tasks run in other processes, else None: for work that a process does one at a time.

    What learns with torch is of that kind: its random generator and its number of threads belong to the process.
    """
    return None if isinstance(executor, ThreadPoolExecutor) else executor


def _failed(future: Future[Any]) -> bool:
    return future.cancelled() or future.exception() is not None
