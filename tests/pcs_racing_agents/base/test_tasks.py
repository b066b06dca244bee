"""Work that is more than a list of tasks: several groups side by side."""

import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from pcs_racing_agents.base.executors import make_executor, tasks_in_flight
from pcs_racing_agents.base.folders import JobError
from pcs_racing_agents.base.tasks import in_other_processes, numbered_tasks, run_task, run_tasks
from pcs_racing_agents.networks.training import torch_alone


def double(task: int) -> dict[str, int]:
    return {"value": 2 * task}


def test_results_come_with_their_keys_and_only_threads_are_here():
    with make_executor("threads", 2) as threads:
        for executor in (None, threads):
            found = dict(run_tasks(numbered_tasks(double, range(20)), executor))
            assert found == {i: {"value": 2 * i} for i in range(20)}
            assert in_other_processes(executor) is None
        assert run_task(double, 21, threads) == {"value": 42}
    with make_executor("processes", 1) as processes:
        assert in_other_processes(processes) is processes


class OddError(Exception):
    """Can be pickled, but not unpickled."""

    def __init__(self, what: str, where: str) -> None:
        super().__init__(f"{what} in {where}")


def fail(task: str) -> None:
    if task == "exit":
        sys.exit(3)
    raise OddError("fog", task)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_errors_of_tasks_are_named_wherever_they_run(kind):
    with make_executor(kind, 1) as executor:
        with pytest.raises(JobError, match=r"a task ended with SystemExit\(3\)"):
            run_task(fail, "exit", executor)
        with pytest.raises((OddError, RuntimeError), match="fog in Spa") as stop:
            run_task(fail, "Spa", executor)
        assert "OddError" in repr(stop.value)
        assert run_task(double, 21, executor) == {"value": 42}  # no worker was lost


def test_tasks_are_made_when_they_are_asked_for():
    """A million tasks need not be in memory, and a task may follow from the result of another."""
    made = []

    def arguments():
        for i in range(100):
            made.append(i)
            yield i

    with make_executor("threads", 2) as executor:
        for done, _ in enumerate(run_tasks(numbered_tasks(double, arguments()), executor), start=1):
            assert len(made) <= done + tasks_in_flight(executor)
    assert len(made) == 100


def test_torch_belongs_to_one_thread_at_a_time():
    pytest.importorskip("torch")
    inside = []

    def work(number: int) -> int:
        with torch_alone() as torch, torch_alone():  # it may be asked for within itself
            inside.append(number)
            alone = inside == [number] and torch.get_num_threads() == 1
            inside.remove(number)
        return alone

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(50)))
