"""Tasks and their execution: a bounded number in flight, one error if workers die.

Results are yielded as they come in.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import Any, Generic, NamedTuple, TypeVar, cast

from pcs_racing_agents.base.executors import call_task, is_lost, sent_once, tasks_in_flight
from pcs_racing_agents.base.folders import GO_ON, JobError

A = TypeVar("A")
K = TypeVar("K")
R = TypeVar("R")


class Task(NamedTuple, Generic[K]):
    """Call of a function."""

    key: K  #: Key of the result.
    #: Function of the task, called as ``function(argument)``; a large function shared by several
    #: tasks (the same object) is sent only once.
    function: Callable[[Any], Any]
    argument: Any


def run_tasks(
    tasks: Iterable[Task[K]],
    executor: Executor | None = None,
    name: str = "the work",
) -> Iterator[tuple[K, Any]]:
    """Run tasks with a bounded number in flight, and yield keys and results as they come in.

    ``tasks`` is advanced only when a task can begin, so that not all tasks need be in memory.
    ``name`` describes the work in errors.
    """
    waiting = iter(tasks)
    if executor is None:
        for one in waiting:
            yield one.key, call_task(one.function, one.argument)
        return
    limit = tasks_in_flight(executor)
    under_way: dict[Future[Any], K] = {}
    # By identity, since functions may hold arrays, which have no hash.
    submit: dict[int, Callable[..., Future[Any]]] = {}
    functions: list[Callable[[Any], Any]] = []
    try:
        with ExitStack() as sent:
            while True:
                # The order of the two conditions matters: a task is taken from the iterator only
                # when it can begin.
                while len(under_way) < limit and (task := next(waiting, None)) is not None:
                    if id(task.function) not in submit:
                        # As long as the function lives, no other object has its identity.
                        functions.append(task.function)
                        submit[id(task.function)] = sent.enter_context(
                            sent_once(task.function, executor)
                        )
                    under_way[submit[id(task.function)](task.argument)] = task.key
                if not under_way:
                    return
                done = wait(under_way, return_when=FIRST_COMPLETED).done
                # Results of other tasks are yielded before a failure ends the run.
                for future in sorted(done, key=_failed):
                    key = under_way.pop(future)
                    yield key, future.result()
    except BaseException as error:
        if not is_lost(error):
            raise
        # Lost workers fail many futures at once; the first error is enough for the message.
        why = " ".join(str(error).split()) or "its tasks were cancelled"
        raise JobError(
            f"{name} was cut short: a worker died or the cluster is gone ({why}); {GO_ON}"
        ) from None
    finally:
        for future in under_way:
            future.cancel()


def numbered_tasks(function: Callable[[A], Any], arguments: Iterable[A]) -> Iterator[Task[int]]:
    """Return tasks of one function, with their numbers from 0 as keys."""
    return (Task(i, function, argument) for i, argument in enumerate(arguments))


def run_task(
    function: Callable[[A], R], argument: A, executor: Executor | None, name: str = "the work"
) -> R:
    """Return the result of a single task; see :func:`run_tasks`."""
    ((_, result),) = run_tasks(numbered_tasks(function, [argument]), executor, name)
    return cast(R, result)


def in_other_processes(executor: Executor | None) -> Executor | None:
    """Return the executor if its tasks run in other processes, else None.

    Training with torch needs other processes: torch's random generator and number of threads belong
    to the process.
    """
    return None if isinstance(executor, ThreadPoolExecutor) else executor


def _failed(future: Future[Any]) -> bool:
    return future.cancelled() or future.exception() is not None
