"""Work that is more than a list of tasks: several groups side by side, and chains."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from pcs_racing_agents.jobs.chunks import read_chunk
from pcs_racing_agents.jobs.executors import make_executor, tasks_in_flight
from pcs_racing_agents.jobs.folders import JobError
from pcs_racing_agents.jobs.jobs import InputError, TaskGroup, open_job, run_groups
from pcs_racing_agents.jobs.tasks import Task, in_other_processes, numbered_tasks, run_task, run_tasks
from pcs_racing_agents.networks.torch_layers import torch_alone


def double(task: int) -> dict[str, int]:
    return {"value": 2 * task}


# Tasks


@pytest.mark.parametrize("kind", ["serial", "threads"])
def test_results_come_with_their_keys(kind):
    with make_executor(kind, 2) as executor:
        found = dict(run_tasks(numbered_tasks(double, range(20)), executor))
        assert run_task(double, 21, executor) == {"value": 42}
    assert found == {i: {"value": 2 * i} for i in range(20)}


@pytest.mark.parametrize("workers", [None, 2])
def test_tasks_are_made_when_they_are_asked_for(workers):
    """A million tasks need not be in memory, and a task may follow from the result of another."""
    made = []

    def arguments():
        for i in range(100):
            made.append(i)
            yield i

    with make_executor("threads" if workers else "serial", workers) as executor:
        for done, _ in enumerate(run_tasks(numbered_tasks(double, arguments()), executor), start=1):
            assert len(made) <= done + tasks_in_flight(executor)
    assert len(made) == 100


def test_one_task_follows_from_another():
    found = [1]
    again = lambda key: Task(key, double, found[-1]) if found[-1] < 100 else None  # noqa: E731
    for _, result in run_tasks([Task("a", double, 1)], follow=again):
        found.append(result["value"])
    assert found == [1, 2, 4, 8, 16, 32, 64, 128]


def test_only_threads_are_here():
    with make_executor("threads", 1) as threads, make_executor("processes", 1) as processes:
        assert in_other_processes(threads) is None
        assert in_other_processes(processes) is processes
    assert in_other_processes(None) is None


# Groups


def test_groups_of_several_jobs_are_done_side_by_side(tmp_path):
    together = threading.Barrier(2, timeout=30.0)  # broken if one group waits for the end of the other

    def meet(task: int) -> dict[str, int]:
        together.wait()
        return double(task)

    told = []
    with (
        open_job(tmp_path / "a", "k", {}) as a,
        open_job(tmp_path / "b", "k", {"other": 1}) as b,
        ThreadPoolExecutor(2) as executor,
    ):
        groups = [TaskGroup(a, "first", meet, [1]), TaskGroup(b, "second", meet, [2])]
        results = run_groups(groups, executor=executor, progress=lambda *news: told.append(news))
        assert [[int(one["value"]) for one in group] for group in results] == [[2], [4]]
        assert [(done, total) for done, total, _ in told] == [(0, 2), (1, 2), (2, 2)]
        assert run_groups(groups, keep=False) == [[], []]  # nothing is done again: nobody waits at the barrier
    assert (tmp_path / "a" / "chunks" / "first-00000.npz").is_file()
    assert (tmp_path / "b" / "chunks" / "second-00000.npz").is_file()


def test_no_groups_are_no_work():
    assert run_groups([]) == []


# Chains


def count_up(piece):
    """Count up to a number, three at a time."""
    goal, state = piece
    values = [] if state is None else state["values"].tolist()
    values += range(len(values), min(len(values) + 3, goal))
    return {"values": np.array(values, np.int64), "finished": len(values) == goal}


GOALS = (7, 2, 9)


@pytest.mark.parametrize("kind", ["serial", "threads", "processes"])
def test_chains_end_alike_whatever_the_executor(tmp_path, kind, executor):
    told = []
    with open_job(tmp_path, "k", {}) as job:
        last = job.run_chains("count", count_up, GOALS, executor=executor, on_state=lambda i, state: told.append(i))
        again = job.run_chains("count", None, GOALS)  # finished: there is nothing to do
    for found in (last, again, [read_chunk(job.file("count", i)) for i in range(3)]):
        assert [state["values"].tolist() for state in found] == [list(range(goal)) for goal in GOALS]
    assert sorted(told) == [0, 0, 0, 1, 2, 2, 2]


def test_a_chain_goes_on_where_it_was_stopped(tmp_path):
    class StopError(Exception):
        pass

    def stop(index, state):
        if index == 2 and len(state["values"]) == 6:
            raise StopError

    pieces = []

    def counted(piece):
        pieces.append((piece[0], 0 if piece[1] is None else len(piece[1]["values"])))
        return count_up(piece)

    with open_job(tmp_path, "k", {}) as job, pytest.raises(StopError):
        job.run_chains("count", counted, GOALS, on_state=stop)
    with open_job(tmp_path, "k", {}) as job:
        last = job.run_chains("count", counted, GOALS)
    assert [state["values"].tolist() for state in last] == [list(range(goal)) for goal in GOALS]
    assert sorted(pieces) == [(2, 0), (7, 0), (7, 3), (7, 6), (9, 0), (9, 3), (9, 6)]  # none of them twice


def test_a_damaged_state_is_named_and_its_chain_begins_again(tmp_path, caplog):
    with open_job(tmp_path, "k", {}) as job:
        job.run_chains("count", count_up, GOALS)
        job.file("count", 1).write_bytes(b"x" * 500)
        last = job.run_chains("count", count_up, GOALS)
    assert "count-00001.npz is damaged" in caplog.text
    assert [len(state["values"]) for state in last] == list(GOALS)


def test_errors_of_chains_are_those_of_jobs(tmp_path):
    with open_job(tmp_path, "k", {}) as job:
        with pytest.raises(InputError, match="'A!'"):
            job.run_chains("A!", count_up, GOALS)
        with pytest.raises(InputError, match=r"task 0 .* int"):
            job.run_chains("odd", lambda piece: 3, GOALS)
        (tmp_path / "chunks").write_text("in the way")
        with pytest.raises(JobError, match=r"can't write .*what is done is kept"):
            job.run_chains("count", count_up, GOALS)


# torch


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
