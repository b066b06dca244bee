import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from refusal import refused
from repository import REPOSITORY
from same_arrays import assert_same
from warm_start import kill, start_python

from pcs_racing import InputError, load_rules, load_track
from pcs_racing_agents.base.executors import (
    in_other_processes,
    make_executor,
    run_tasks,
    tasks_in_flight,
)
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.folders import JobError, package_version
from pcs_racing_agents.base.jobs import chunk_file, open_job, read_chunk, show_progress, write_chunk
from pcs_racing_agents.networks.training import torch_alone

CHECKOUT = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests")])
RACE = {"duration": 16.0, "tracks": ["Pipkin", "Saltmere"]}
SETTINGS = {"seed": 3, "race": RACE}


def square(task: float) -> dict[str, object]:
    """A task: an array, a whole number and a text."""
    return {"values": np.arange(task) ** 2.0, "count": int(task), "name": np.array(f"task {task}")}


def same(results, others):
    for result, other in zip(results, others, strict=True):
        assert_same(result, other)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_results_come_in_the_order_of_the_tasks_and_progress_counts_what_was_there(tmp_path):
    with open_job(tmp_path, "squares", SETTINGS) as job:
        results = job.run("square", square, [3, 0, 5])
        assert [int(result["count"]) for result in results] == [3, 0, 5]
        np.testing.assert_array_equal(results[2]["values"], [0.0, 1.0, 4.0, 9.0, 16.0])
    same([read_chunk(chunk_file(tmp_path, "square", k)) for k in range(3)], results)
    told = []
    with open_job(tmp_path, "squares", SETTINGS) as job:
        job.run("square", square, [1, 2])
        job.run("square", square, [1, 2, 3, 4], progress=lambda *news: told.append(news))
    assert told == [(2, 4, "square"), (3, 4, "square"), (4, 4, "square")]


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_files_are_the_same_whatever_the_executor(tmp_path, kind, request):
    tasks, executor = list(range(9)), request.getfixturevalue(kind)
    with open_job(tmp_path / "a", "squares", SETTINGS) as job:
        expected = job.run("square", square, tasks)
    with open_job(tmp_path / "b", "squares", SETTINGS) as job:
        same(job.run("square", square, tasks, executor=executor), expected)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_names_and_results_that_can_not_be_are_refused(tmp_path):
    for value in [[1, 2], {"object": object()}, {"ragged": [None, {}]}, 3]:
        with (
            open_job(tmp_path, "squares", SETTINGS) as job,
            pytest.raises(InputError, match="task 0 of odd"),
        ):
            job.run("odd", lambda _, value=value: value, [0])
    for name in ["", "../up", "A", "a b", "x" * 81]:
        with (
            open_job(tmp_path, "squares", SETTINGS) as job,
            pytest.raises(InputError, match="small letters"),
        ):
            job.run(name, square, [1])


def test_a_job_goes_on_where_it_failed(tmp_path):
    asked = []

    def fails_once(task):
        asked.append(task)
        if task == 3 and asked.count(3) == 1:
            raise ZeroDivisionError("the third")
        return square(task)

    with (
        open_job(tmp_path, "squares", SETTINGS) as job,
        pytest.raises(ZeroDivisionError, match="the third"),
    ):
        job.run("square", fails_once, range(5))
    with open_job(tmp_path, "squares", SETTINGS) as job:
        results = job.run("square", fails_once, range(5))
    assert asked == [0, 1, 2, 3, 3, 4]
    same(results, [{key: np.asarray(v) for key, v in square(k).items()} for k in range(5)])


def test_a_damaged_chunk_is_named_and_made_again(tmp_path, caplog):
    with open_job(tmp_path, "squares", SETTINGS) as job:
        expected = job.run("square", square, range(4))
        whole = contents(tmp_path)
        file = job.file("square", 2)
        for content in (b"", file.read_bytes()[:99], job.file("square", 3).read_bytes()):
            file.write_bytes(content)
            caplog.clear()
            same(job.run("square", square, range(4)), expected)
            (record,) = caplog.records
            assert record.getMessage().startswith(f"{file} ")
            assert record.getMessage().endswith("; it is made again")
            assert contents(tmp_path) == whole


@given(data=st.data())
def test_no_changed_byte_goes_unnoticed(data, tmp_path_factory):
    file = tmp_path_factory.getbasetemp() / "chunk.npz"
    write_chunk(file, {"x": np.arange(5.0), "y": np.array([True, False])}, "0" * 64)
    content = bytearray(file.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    file.write_bytes(content)
    refused(r"damaged|another task", read_chunk, file, "0" * 64)


def kill_yourself(task: int) -> dict[str, int]:
    if task == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"task": task}


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_killed_worker_is_told_in_a_line_and_loses_nothing_that_is_done(tmp_path):
    with (
        open_job(tmp_path, "squares", SETTINGS) as job,
        pytest.raises(JobError, match=r"^square .*worker died"),
        make_executor(1) as executor,
    ):
        job.run("square", kill_yourself, range(8), executor=executor)
    done = sorted(file.name for file in (tmp_path / "chunks").iterdir())
    assert done == [f"square-{k:05d}.npz" for k in range(len(done))]
    assert 1 <= len(done) <= 5


def leaves_a_mark(task: int) -> dict[str, int]:
    (Path(os.environ["PID_FOLDER"]) / str(os.getpid())).touch()
    time.sleep(0.05)
    return {"task": task}


ORPHANS = """
import sys
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.executors import make_executor
from tests.pcs_racing_agents.base.test_jobs import leaves_a_mark

if __name__ == "__main__":
    with open_job(sys.argv[1], "squares", {}) as job, make_executor(1) as executor:
        job.run("square", leaves_a_mark, range(1000), executor=executor, keep=False)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")
def test_workers_end_when_their_parent_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ORPHANS)
    pids = tmp_path / "pids"
    pids.mkdir()
    environment = {**os.environ, "PYTHONPATH": CHECKOUT, "PID_FOLDER": str(pids)}
    process = start_python(script, tmp_path / "job", env=environment)
    while not list(pids.iterdir()):
        assert process.is_alive()
        time.sleep(0.01)
    kill(process)

    def alive(pid: str) -> bool:
        state = Path(f"/proc/{pid}/stat")
        return state.exists() and state.read_text().rsplit(")", 1)[1].split()[0] != "Z"

    patience = time.monotonic() + 20.0
    while any(alive(file.name) for file in pids.iterdir()):
        assert time.monotonic() < patience
        time.sleep(0.02)


def test_an_interruption_drops_what_has_not_begun(tmp_path):
    asked = []

    def interrupted(done, total, what):
        if done == 3:
            raise KeyboardInterrupt

    def count(task):
        asked.append(task)
        return square(task)

    with (
        open_job(tmp_path, "squares", SETTINGS) as job,
        pytest.raises(KeyboardInterrupt),
        ThreadPoolExecutor(2) as executor,
    ):
        job.run("square", count, range(500), executor=executor, progress=interrupted)
    assert 3 <= len(asked) <= 3 + 16  # so many tasks wait for a worker at most
    with open_job(tmp_path, "squares", SETTINGS) as job:  # the lock is free again
        assert len(job.run("square", count, range(10))) == 10


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "cubes"}, "its kind is 'squares', not 'cubes'"),
        ({"version": "99.0"}, r"its package is '.*', not '99\.0'"),
        ({"seed": 4}, "its seed is 3, not 4"),
        ({"seed": True}, "its seed is 3, not True"),
        ({"moves": 4}, "its moves is missing, not 4"),
        ({"race": "fast"}, r"its race\.duration is 16\.0, not given here"),
        ({"race": {**RACE, "duration": 8.0}}, r"its race\.duration is 16\.0, not 8\.0"),
    ],
)
def test_a_folder_of_another_run_is_refused_and_left_alone(tmp_path, change, message, monkeypatch):
    settings = SETTINGS | change
    kind, version = settings.pop("kind", "squares"), settings.pop("version", package_version())
    with open_job(tmp_path, "squares", SETTINGS) as job:
        job.run("square", square, [3])
    before = contents(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("pcs_racing_agents.base.folders.package_version", lambda: version)
        refused(f"holds another run: {message}", open_job(tmp_path, kind, settings).__enter__)
    assert contents(tmp_path) == before


def test_a_lost_manifest_is_written_again_and_no_chunk_is_made_again(tmp_path):
    with open_job(tmp_path, "squares", SETTINGS) as job:
        job.run("square", square, range(3))
    whole = contents(tmp_path)
    (tmp_path / "job.yaml").unlink()
    with open_job(tmp_path, "squares", SETTINGS) as job:
        job.run("square", None, range(3))
    assert contents(tmp_path) == whole


def test_settings_may_be_arrays_tuples_and_dataclasses(tmp_path):
    epsilon, race = (0.1, np.float64(0.2)), load_rules("paper", duration=40.0)
    settings = {"epsilon": epsilon, "race": race, "bounds": np.eye(2), "tiny": 1e-30}
    for _ in range(2):
        with open_job(tmp_path, "squares", settings) as job:
            assert job.settings["epsilon"] == [0.1, 0.2]
            assert job.settings["race"]["duration"] == 40.0
            assert job.settings["tiny"] == 1e-30
    assert yaml.safe_load((tmp_path / "job.yaml").read_text())["settings"]["bounds"] == [
        [1.0, 0.0],
        [0.0, 1.0],
    ]
    refused("<function square .* is no setting", open_job(tmp_path, "k", {"f": square}).__enter__)


def test_folders_of_other_things_or_manifests_are_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    refused(r"thesis\.tex .*job\.yaml", open_job(tmp_path, "k", {}).__enter__)
    assert contents(tmp_path) == {"thesis.tex": b"years of work"}
    for text in ["", "[1, 2", "format: something\n", "- 1\n"]:
        (tmp_path / "job.yaml").write_text(text)
        refused(r"job\.yaml is no manifest", open_job(tmp_path, "k", {}).__enter__)


def test_impossible_executors_are_refused_and_processes_keep_linear_algebra_to_one_thread(
    tmp_path, monkeypatch
):
    for workers in (0, True, "two"):
        refused(f"workers is {workers!r}", make_executor(workers).__enter__)
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with open_job(tmp_path, "k", {}) as job, make_executor(1) as executor:
        assert job.run("threads", blas_threads, [0], executor=executor)[0]["threads"] == "1"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


def blas_threads(task: int) -> dict[str, str]:
    return {"threads": os.environ.get("OPENBLAS_NUM_THREADS", "")}


def test_fingerprints_tell_values_apart():
    config = load_rules("paper")
    values = [
        0,
        0.0,
        False,
        "0",
        b"0",
        None,
        [],
        [0],
        [[0]],
        [0, 0],
        {},
        {0: 0},
        {"0": 0},
        np.zeros(1),
        np.zeros(2),
        np.zeros((1, 1)),
        np.zeros(1, np.float32),
        np.int64(0),
        config,
        load_rules("contest"),
        float("nan"),
        len,
        fingerprint,
    ]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint(config, np.arange(3)) == fingerprint(load_rules("paper"), np.arange(3))
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})


def test_rules_have_the_fingerprint_of_their_races():
    changes = [{}, {"laps": 1}, {"laps": 2}, {"laps": 1, "duration": 8.0}, {"duration": 8.0}]
    every = [load_rules("paper", **one) for one in changes]
    assert fingerprint(every[0]) == fingerprint(load_rules("paper"))
    assert len(set(map(fingerprint, every))) == len(every)
    assert fingerprint((1, 2)) == fingerprint([1, 2])
    assert fingerprint(np.asfortranarray(np.eye(3) + 1)) == fingerprint(np.eye(3) + 1)
    assert fingerprint(load_track("Pipkin")) != fingerprint(load_track("Saltmere"))


def test_the_time_left_counts_only_this_run(capsys, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    show = show_progress("trees")
    show(50, 100, "tree")
    clock[0] += 10.0
    show(55, 100, "tree")
    clock[0] += 20.0
    show(100, 100, "tree")
    assert capsys.readouterr().err.splitlines() == [
        "55/100 trees, 10 s, about 90 s left: tree",
        "100/100 trees, 30 s",
    ]


def double(task: int) -> dict[str, int]:
    return {"value": 2 * task}


def test_tasks_are_made_when_they_are_asked_for_and_threads_belong_to_this_process():
    """A million tasks need not be in memory."""
    made = []

    def arguments():
        for i in range(100):
            made.append(i)
            yield i

    with ThreadPoolExecutor(2) as executor:
        assert in_other_processes(executor) is None
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
