"""Tasks on executors: their results, and when they are made."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from pcs_racing_agents.base.executors import make_executor, tasks_in_flight
from pcs_racing_agents.base.tasks import in_other_processes, run_tasks
from pcs_racing_agents.networks.training import torch_alone


def double(task: int) -> dict[str, int]:
    return {"value": 2 * task}


def test_results_come_with_their_keys_and_only_threads_are_here():
    with ThreadPoolExecutor(2) as threads:
        for executor in (None, threads):
            found = dict(run_tasks(double, range(20), executor))
            assert found == {i: {"value": 2 * i} for i in range(20)}
            assert in_other_processes(executor) is None
    with make_executor(1) as processes:
        assert in_other_processes(processes) is processes


def test_tasks_are_made_when_they_are_asked_for():
    """A million tasks need not be in memory."""
    made = []

    def arguments():
        for i in range(100):
            made.append(i)
            yield i

    with ThreadPoolExecutor(2) as executor:
        for done, _ in enumerate(run_tasks(double, arguments(), executor), start=1):
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
