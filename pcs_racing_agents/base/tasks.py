"""Tasks on any executor: a bounded number in flight, one error if workers die."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import TypeVar

from pcs_racing_agents.base.executors import is_lost, sent_once, tasks_in_flight
from pcs_racing_agents.base.folders import JobError

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
