"""Long jobs on a real cluster: a dask scheduler and worker processes, some of which are killed."""

import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from long_jobs import TREES, commands, files
from refusal import refused
from warm_start import kill, start_python

from pcs_racing_agents.base import executors
from pcs_racing_agents.base.executors import make_executor, sent_once, tasks_in_flight
from pcs_racing_agents.base.folders import JobError
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.cli.main import main

Client = pytest.importorskip("dask.distributed").Client
pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL"),
]

HERE = Path(__file__).resolve().parent
PATIENCE = 120.0  # s, for a busy machine; nothing waits so long on another


class Cluster:
    """A scheduler and workers, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scheduler = self._start("scheduler", "--port", "0", "--host", "127.0.0.1")
        self.address = self._address()
        self.workers: list[BaseProcess] = []

    def add_worker(self) -> BaseProcess:
        options = (
            "--nthreads",
            "1",
            "--no-nanny",
            "--memory-limit",
            "2GB",
            "--death-timeout",
            str(PATIENCE),
        )
        worker = self._start(
            "worker", self.address, *options, "--local-directory", str(self.folder / "scratch")
        )
        self.workers.append(worker)
        return worker

    def stop(self) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.join()

    def _start(self, what: str, *arguments: str) -> BaseProcess:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
        log = self.folder / f"{what}.log"
        return start_python(
            "-m",
            "dask",
            what,
            "--no-dashboard",
            *arguments,
            env=environment,
            stdout=log,
            stderr=log,
        )

    def _address(self) -> str:
        log = self.folder / "scheduler.log"
        wait_for(
            lambda: (
                (log.exists() and "Scheduler at:" in log.read_text())
                or not self.scheduler.is_alive()
            )
        )
        return log.read_text().split("Scheduler at:")[1].split()[0]


@contextmanager
def started(folder: Path, workers: int) -> Iterator[Cluster]:
    cluster = Cluster(folder)
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.stop()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    with (
        started(tmp_path_factory.mktemp("cluster"), 3) as cluster,
        make_executor(scheduler=cluster.address),
    ):
        Client.current().wait_for_workers(3, timeout=PATIENCE)
        yield cluster


@pytest.fixture
def dask(cluster) -> Iterator[Executor]:
    with make_executor(scheduler=cluster.address) as executor:
        Client.current().wait_for_workers(3, timeout=PATIENCE)
        yield executor


def wait_for(condition: Callable[[], bool]) -> None:
    patience = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < patience
        time.sleep(0.02)


@pytest.fixture(scope="module")
def long_commands(tmp_path_factory) -> dict[str, list[str]]:
    """Every long command; those that train learn from a few trees."""
    folder = tmp_path_factory.mktemp("settings")
    assert main(["tree", *TREES, "--pairs", "4", "--out", str(folder / "trees")]) == 0
    few = ["--epochs", "3", "--hidden", "8", "--name", "small"]
    return {**commands(), "train": ["train", "regret", str(folder / "trees"), *few]}


@pytest.mark.parametrize("what", ["tree", "ppo"])
def test_a_cluster_gives_the_same_bytes_as_threads(cluster, long_commands, tmp_path, what):
    if what != "tree":
        pytest.importorskip("stable_baselines3")
    command = long_commands[what]
    assert main([*command, "--out", str(tmp_path / "here")]) == 0
    there = ["--out", str(tmp_path / "there"), "--scheduler", cluster.address]
    assert main([*command, *there]) == 0
    here, there = files(tmp_path / "here"), files(tmp_path / "there")
    assert len(here) >= 3
    assert here == there


class Heavy:
    """A function that carries ten megabytes along."""

    def __init__(self) -> None:
        self.load = np.random.default_rng(0).random(1_250_000)

    def __call__(self, task: int) -> dict[str, float]:
        return {"sum": float(self.load[task])}


@pytest.mark.parametrize("kind", ["processes", "dask"])
def test_a_large_function_travels_once_and_not_with_every_task(tmp_path, kind, request, recwarn):
    executor = request.getfixturevalue(kind)
    heavy = Heavy()
    with open_job(tmp_path, "k", {}) as job:
        found = job.run("heavy", heavy, range(40), executor=executor)
    with sent_once(heavy, executor) as submit:
        assert 0 < len(repr(submit.args[1:])) < 1000  # the shared part of every task
    assert [float(result["sum"]) for result in found] == heavy.load[:40].tolist()
    assert not [warning for warning in recwarn if "large" in str(warning.message)]


def test_all_workers_have_tasks_and_equal_calls_are_two_calls(dask):
    assert tasks_in_flight(dask) == 6
    drawn = [dask.submit(os.urandom, 8) for _ in range(2)]
    assert drawn[0].result() != drawn[1].result()


def slow(task: tuple[int, str]) -> dict[str, object]:
    number, folder = task
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(0.1)
    return {"values": np.arange(number) ** 2.0}


def undisturbed(tasks, folder: Path) -> dict[str, bytes]:
    with open_job(folder, "k", {}) as job:
        job.run("slow", slow, tasks)
    return files(folder)


def test_a_killed_worker_loses_nothing(cluster, tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    tasks = [(number, str(marks)) for number in range(40)]
    killed = []

    with (
        open_job(tmp_path / "job", "k", {}) as job,
        make_executor(scheduler=cluster.address) as executor,
    ):
        victim = cluster.workers.pop(0)

        def kill_one(done, total, what):
            if not killed and (marks / str(victim.pid)).exists():
                kill(victim)
                killed.append(done)

        job.run("slow", slow, tasks, executor=executor, progress=kill_one, keep=False)
    cluster.add_worker()
    assert killed[0] < len(tasks)  # there was work left
    assert files(tmp_path / "job") == undisturbed(tasks, tmp_path / "undisturbed")


def test_a_killed_scheduler_is_told_in_a_line_and_another_goes_on(cluster, tmp_path):
    (tmp_path / "marks").mkdir()
    (tmp_path / "first").mkdir()
    tasks = [(number, str(tmp_path / "marks")) for number in range(25)]
    with started(tmp_path / "first", 1) as first:

        def kill_it(done, total, what):
            if done == 5:
                first.scheduler.kill()

        with (
            open_job(tmp_path / "job", "k", {}) as job,
            pytest.raises(JobError, match=r"^slow .*cluster is gone"),
            make_executor(scheduler=first.address) as executor,
        ):
            job.run("slow", slow, tasks, executor=executor, progress=kill_it)
    done = len(list((tmp_path / "job" / "chunks").iterdir()))
    assert 5 <= done < 25
    with (
        open_job(tmp_path / "job", "k", {}) as job,
        make_executor(scheduler=cluster.address) as executor,
    ):
        job.run("slow", slow, tasks, executor=executor)
    assert files(tmp_path / "job") == undisturbed(tasks, tmp_path / "undisturbed")


def out_of_memory(task: int) -> dict[str, int]:
    """Error of dask for a task whose workers died several times."""
    from distributed.scheduler import KilledWorker

    raise KilledWorker("out_of_memory-12", SimpleNamespace(address="tcp://there:1"), 3)


def test_a_task_that_kills_its_workers_and_a_scheduler_without_any_are_told_in_a_line(
    tmp_path, monkeypatch
):
    with (
        open_job(tmp_path, "k", {}) as job,
        pytest.raises(JobError, match=r"^deadly .*worker died.*out_of_memory-12"),
        ThreadPoolExecutor(1) as executor,
    ):
        job.run("deadly", out_of_memory, range(2), executor=executor)
    monkeypatch.setattr(executors, "WORKER_SECONDS", 0.5)
    with started(tmp_path, 0) as lonely:
        refused(
            f"{lonely.address} has no workers",
            make_executor(scheduler=lonely.address).__enter__,
        )


def test_workers_lost_outside_of_jobs_are_told_in_a_line(monkeypatch, capsys):
    """A tournament without a folder keeps nothing, and has no job."""

    def fail(*arguments, **options):
        raise CancelledError("scheduler-connection-lost")

    monkeypatch.setattr("pcs_racing_agents.tournament.plan_tournament", fail)
    assert main(["tournament", "--agents", "never-switch", "random-moves"]) == 2
    assert capsys.readouterr().err == (
        "pcs-racing: error: a worker failed or the cluster is unreachable"
        " (scheduler-connection-lost); rerun to resume\n"
    )


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://there"])
def test_a_wrong_address_is_one_clear_error(address, monkeypatch):
    monkeypatch.setattr(executors, "ANSWER_SECONDS", 1.0)
    other = make_executor(scheduler=address)
    refused(f"^no dask scheduler answers at {address}: ", other.__enter__)
    gc.collect()  # a failed client closes itself, not within the start of another client


def test_workers_with_other_libraries_are_refused(cluster, monkeypatch):
    found = Client.current().get_versions(packages=executors.LIBRARIES)
    executors._check_workers(found)
    theirs = next(iter(found["workers"].values()))["packages"]
    theirs["torch"] = None  # a race needs no torch
    executors._check_workers(found)
    theirs["numpy"] = "0.1"
    refused(
        r"tcp://127\S+ has numpy 0\.1, not \d.*install the same", executors._check_workers, found
    )
