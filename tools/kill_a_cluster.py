"""Run a study on a dask cluster, kill a worker and then the scheduler, start again, and compare with a run by threads.

python tools/kill_a_cluster.py --study quick --out out/killed

The scheduler and the workers are processes of their own on this machine, as docs/cluster.md says. A worker is killed
(SIGKILL) when a part of the chunks of the whole study is there, the scheduler when another part is; the command then
ends with an error, and is started again with another cluster. At the end every file of the two folders is compared.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from pcs_racing_agents.jobs.chunks import read_chunk

PATIENCE = 120.0  # s, for a cluster to start
TIMES = re.compile(rb"<h3>Time, s</h3>.*?</table>", re.DOTALL)  # in the report


def say(text: str) -> None:
    """Print a line with the time."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


def study(name: str, folder: Path, options: Sequence[str], log: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start the command."""
    command = [sys.executable, "-m", "pcs_racing_agents", "study", name, "--out", str(folder), *options]
    say("pcs-racing " + " ".join(command[3:]))
    return subprocess.Popen(command, stdout=log, stderr=log)


class Cluster:
    """A scheduler and workers, each a process of its own."""

    def __init__(self, workers: int, scratch: Path) -> None:
        log = scratch / f"scheduler-{time.monotonic_ns()}.log"
        self.scheduler = _dask(log, "scheduler", "--host", "127.0.0.1", "--port", "0")
        patience = time.monotonic() + PATIENCE
        while not (found := re.findall(r"Scheduler at:\s*(\S+)", log.read_text() if log.exists() else "")):
            if time.monotonic() > patience or self.scheduler.poll() is not None:
                raise SystemExit(f"no scheduler started; see {log}")
            time.sleep(0.1)
        self.address = found[0]
        options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(scratch))
        self.workers = [
            _dask(log.with_name(f"worker-{i}-{log.name}"), "worker", self.address, *options) for i in range(workers)
        ]
        say(f"scheduler at {self.address}, process {self.scheduler.pid}; {workers} workers")

    def stop(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def _dask(log: Path, *arguments: str) -> subprocess.Popen[bytes]:
    with open(log, "wb") as out:
        return subprocess.Popen([sys.executable, "-m", "dask", *arguments, "--no-dashboard"], stdout=out, stderr=out)


@contextmanager
def cluster(workers: int, scratch: Path) -> Iterator[Cluster]:
    """Provide a cluster for as long as a ``with`` block lasts."""
    started = Cluster(workers, scratch)
    try:
        yield started
    finally:
        started.stop()


def chunks(folder: Path) -> int:
    """How much of a study is done."""
    return sum(1 for _ in folder.rglob("chunks/*.npz"))


def wait_for(command: subprocess.Popen[bytes], folder: Path, count: int) -> None:
    """Wait until so many chunks are there."""
    while chunks(folder) < count:
        if command.poll() is not None:
            raise SystemExit("the command ended before anything was killed; kill earlier")
        time.sleep(0.05)


def kill(process: subprocess.Popen[bytes], what: str, folder: Path) -> None:
    """Kill a process, and say when."""
    done = sorted(file.parent.name for file in folder.glob("*/done.yaml"))
    process.send_signal(signal.SIGKILL)
    process.wait()
    say(f"killed {what}, process {process.pid}: {chunks(folder)} chunks are there, stages done: {', '.join(done)}")


def compare(one: Path, two: Path) -> bool:
    """Print how the files of two studies compare; return whether they differ in nothing but times."""

    def files(folder: Path) -> dict[str, Path]:
        return {str(file.relative_to(folder)): file for file in folder.rglob("*") if file.is_file()}

    first, second = files(one), files(two)
    for folder, names in ((one, set(first) - set(second)), (two, set(second) - set(first))):
        for name in sorted(names):
            say(f"only in {folder}: {name}")
    both = sorted(set(first) & set(second))
    differ = [name for name in both if first[name].read_bytes() != second[name].read_bytes()]
    say(f"{len(both) - len(differ)} of {len(both)} files are the same to the byte")
    other = [name for name in differ if not _only_times(first[name], second[name])]
    for name in differ:
        say(f"{'DIFFERS' if name in other else 'differs in times only'}: {name}")
    return set(first) == set(second) and not other


def _only_times(one: Path, two: Path) -> bool:
    """Whether two files differ in nothing but how long something took."""
    if one.name in (".lock", "done.yaml"):
        return True
    if one.suffix == ".npz":
        first, second = read_chunk(one), read_chunk(two)
        return set(first) == set(second) and all(np.array_equal(first[k], second[k]) for k in first if k != "seconds")
    return TIMES.sub(b"", one.read_bytes()) == TIMES.sub(b"", two.read_bytes())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", default="quick", help="configuration (default: quick)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets threads/ and cluster/")
    parser.add_argument("--workers", type=int, default=3, metavar="N", help="of the cluster (default: 3)")
    parser.add_argument(
        "--kill-at", type=float, nargs=2, default=(0.2, 0.6), metavar="SHARE", help="of all chunks (default: 0.2 0.6)"
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    here, there = arguments.out / "threads", arguments.out / "cluster"
    with open(arguments.out / "commands.log", "ab") as log, tempfile.TemporaryDirectory() as scratch:
        if study(arguments.study, here, ["--executor", "threads"], log).wait() != 0:
            raise SystemExit(f"the run by threads failed; see {log.name}")
        total = chunks(here)
        say(f"by threads: {total} chunks")
        for attempt in ("first", "second"):
            with cluster(arguments.workers, Path(scratch)) as started:
                options = ["--executor", "dask", "--scheduler", started.address]
                command = study(arguments.study, there, options, log)
                if attempt == "first":
                    wait_for(command, there, round(arguments.kill_at[0] * total))
                    kill(started.workers[0], "a worker", there)
                    wait_for(command, there, round(arguments.kill_at[1] * total))
                    kill(started.scheduler, "the scheduler", there)
                code = command.wait()
                log.flush()
                say(f"the {attempt} command ended with code {code}{_error(Path(log.name)) if code else ''}")
    same = compare(here, there)
    say("the results are the same" if same else "THE RESULTS DIFFER")
    return 0 if same else 1


def _error(log: Path) -> str:
    errors = [line for line in log.read_text(errors="replace").splitlines() if "error: " in line]
    return f": {errors[-1]}" if errors else ""


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
