"""Python processes that start at once, for tests of scripts and of what is killed.

A new interpreter spends one second of processor time on importing numba and our packages, and four
where it trains. Here it is forked from a process that has imported them and done nothing else.
Everything else is as in a process of its own: arguments, folder, environment, output, exit code,
and it can be killed. What a test says about imports needs a new interpreter, and so do systems
where forking is not safe: there all processes are new ones.
"""

import os
import runpy
import signal
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from subprocess import CompletedProcess, TimeoutExpired
from typing import Any

IMPORTED = [
    "pcs_racing",
    "pcs_racing_agents.cli.main",
    "pcs_racing_agents.tournament",
    "pcs_racing_agents.trees",
]
IMPORTED += [
    "stable_baselines3",
    "matplotlib.pyplot",
    "distributed.cli.dask_worker",
    "filelock",
    "warm_start",
]
"""What most scripts import. A library that is not installed is left out."""


@cache
def _context() -> Any:
    if sys.platform != "linux":
        return get_context("spawn")
    from multiprocessing import forkserver  # not on Windows

    context = get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    before = os.environ.get("PYTHONPATH")
    # It would look for our packages in the folder of this moment, and then find those of another
    # checkout.
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    try:
        forkserver.ensure_running()
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
    return context


def start_python(
    *arguments: object,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    stdout: Path | None = None,
    stderr: Path | None = None,
) -> BaseProcess:
    """Start ``python ARGUMENTS``: a script, or ``-c`` and code, or ``-m`` and a module.

    Its output is added to the end of the given files; without one it goes nowhere.
    """
    given = (
        tuple(map(str, arguments)),
        str(cwd or Path.cwd()),
        dict(os.environ if env is None else env),
    )
    process = _context().Process(
        target=_run, args=(*given, str(stdout or os.devnull), str(stderr or os.devnull))
    )
    process.start()
    return process


def call_python(
    *arguments: object, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> CompletedProcess[str]:
    """Run ``python ARGUMENTS`` to its end, which must come within five minutes; return its exit
    code and output.
    """
    with tempfile.TemporaryDirectory() as folder:
        stdout, stderr = Path(folder, "stdout"), Path(folder, "stderr")
        process = start_python(*arguments, cwd=cwd, env=env, stdout=stdout, stderr=stderr)
        process.join(300)
        if process.is_alive():
            kill(process)
            raise TimeoutExpired(arguments, 300)
        said = [file.read_text() if file.exists() else "" for file in (stdout, stderr)]
        return CompletedProcess(arguments, process.exitcode or 0, *said)


def kill(process: BaseProcess) -> None:
    """Kill a process and wait for its end."""
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL


def _run(
    arguments: tuple[str, ...], cwd: str, environment: dict[str, str], stdout: str, stderr: str
) -> None:
    for number, path in ((1, stdout), (2, stderr)):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    what, *rest = arguments
    sys.path.insert(0, cwd if what in ("-c", "-m") else str(Path(what).resolve().parent))
    if what == "-c":
        sys.argv = ["-c", *rest[1:]]
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__"})
    elif what == "-m":
        sys.argv = rest
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    else:
        sys.argv = [what, *rest]
        runpy.run_path(what, run_name="__main__")
