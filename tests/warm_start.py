"""Python processes that start at once, for tests of scripts and of killed processes.

A new interpreter spends one second of processor time on importing numba and our packages, and four
where it trains. Here it is forked from a process that has imported them and done nothing else.
Everything else is as in a separate process: arguments, folder, environment, output, exit code,
and it can be killed. Tests of imports need a new interpreter, and so do systems
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
from unittest.mock import patch

IMPORTED = [
    "pcs_racing",
    "pcs_racing_agents.cli.main",
    "pcs_racing_agents.tournament",
    "pcs_racing_agents.trees",
    "stable_baselines3",
    "matplotlib.pyplot",
    "distributed.cli.dask_worker",
    "filelock",
    "warm_start",
]
"""Imports of most scripts. A library that is not installed is left out."""


@cache
def _context() -> Any:
    if sys.platform != "linux":
        return get_context("spawn")
    from multiprocessing import forkserver  # not on Windows

    context = get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    # Without it our packages would be another checkout's.
    with patch.dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, sys.path))):
        forkserver.ensure_running()
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
    outputs = [str(file or os.devnull) for file in (stdout, stderr)]
    given = (list(map(str, arguments)), str(cwd or Path.cwd()), dict(env or os.environ), outputs)
    process = _context().Process(target=_run, args=given)
    process.start()
    return process


def call_python(
    *arguments: object, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> CompletedProcess[str]:
    """Run ``python ARGUMENTS`` to its end, which must come within five minutes; return its exit
    code and output.
    """
    with tempfile.TemporaryDirectory() as folder:
        outputs = [Path(folder, name) for name in ("stdout", "stderr")]
        process = start_python(*arguments, cwd=cwd, env=env, stdout=outputs[0], stderr=outputs[1])
        process.join(300)
        if process.is_alive():
            kill(process)
            raise TimeoutExpired(arguments, 300)
        said = [file.read_text() for file in outputs]
        return CompletedProcess(arguments, process.exitcode or 0, *said)


def kill(process: BaseProcess) -> None:
    """Kill a process and wait for its end."""
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL


def _run(arguments: list[str], cwd: str, environment: dict[str, str], outputs: list[str]) -> None:
    for number, path in enumerate(outputs, 1):
        with open(path, "ab") as file:
            os.dup2(file.fileno(), number)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    what, *rest = arguments
    sys.path.insert(0, cwd if what in ("-c", "-m") else str(Path(what).resolve().parent))
    if what == "-m":
        sys.argv = rest
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif what == "-c":
        sys.argv = ["-c", *rest[1:]]
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv = arguments
        runpy.run_path(what, run_name="__main__")
