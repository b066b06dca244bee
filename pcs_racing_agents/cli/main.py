"""The command line ``pcs-racing``: parse the arguments, run the command, and print an error as one line."""

import argparse
import io
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.commands import Parser, add_commands
from pcs_racing_agents.cli.early import check_command, check_names
from pcs_racing_agents.cli.options import Terminated, load_drivers

FAILED = 2

FILES = {
    "race": "race",
    "tournament": "tournament",
    "overtaking": "overtaking",
    "track": "track",
    "agents": "agents",
    "policies": "agents",
    "synthesize": "synthesize",
    "headroom": "headroom",
    "benchmark": "benchmark",
    "leaderboard": "benchmark",
    "tree": "tree",
    "solve": "solve",
    "export": "solve",
    "train": "train",
    "learn": "learn",
    "best-reply": "learn",
    "ppo": "ppo",
    "study": "study",
    "explain": "explain",
    "view": "view",
    "play": "view",
    "compile": "compilation",
}
"""The file of each command in this folder, in the order of the help. Only what a call needs is imported."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command of these words behind ``pcs-racing``, by default those of the process; return the exit status.

    It is 0, or 2 after an error that the user can correct, which is printed as one line on stderr; 130 after Ctrl-C,
    and 143 after SIGTERM.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what a terminal can't show is escaped: names of files, say
            stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    try:
        if words:
            check_command(words[0], list(FILES))
            check_names(words)
    except InputError as error:
        return _fail(error)
    return run_parsed(_parser(words[0] if words else None).parse_args(words))


def run_parsed(parsed: argparse.Namespace) -> int:
    """Run a command whose words were parsed, and return the exit status of :func:`main`."""
    logging.basicConfig(format="pcs-racing: %(message)s", level=logging.WARNING)
    try:
        with _terminable():
            load_drivers(parsed)
            parsed.run(parsed)
            sys.stdout.flush()
    except (InputError, ModuleNotFoundError) as error:
        return _fail(error)
    except BrokenPipeError:
        # The reader (a pager, head) has closed the pipe. Without this the interpreter would fail again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.filename is None or error.strerror is None:
            return _fail(error)
        return _fail(InputError(f"can't read or write {error.filename}: {error.strerror}"))
    except KeyboardInterrupt as stop:
        terminated = isinstance(stop, Terminated)
        print(f"pcs-racing: {'terminated' if terminated else 'interrupted'}", file=sys.stderr)
        return 143 if terminated else 130
    except Exception as error:
        # Here, since it takes as long to import as a race to drive.
        from pcs_racing_agents.jobs.executors import is_lost

        if not is_lost(error):
            raise
        return _fail(InputError(f"a worker died or the cluster is gone ({error}); mend that and start the same again"))
    return 0


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C would: files are closed, folders unlocked and workers sent home."""
    if threading.current_thread() is not threading.main_thread():  # only there Python handles signals
        yield
        return

    def stop(*_: object) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _fail(error: Exception) -> int:
    print(f"pcs-racing: error: {' '.join(str(error).split())}", file=sys.stderr)
    return FAILED


def _parser(command: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of one command, or of all where there is no such command (for help and errors)."""
    parser = Parser(
        prog="pcs-racing",
        description="Simulate head-to-head races of two cars; search, train and compare policies and agents for them.",
        epilog="'pcs-racing help COMMAND' shows the options of a command and an example of its use.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {_version()}")
    commands: Any = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    # Each file imports what its commands need for their options, which for all of them takes longer than a race.
    wanted = [FILES[command]] if command in FILES else FILES.values()
    for file in dict.fromkeys(wanted):
        add_commands(commands, import_module(f"pcs_racing_agents.cli.{file}"))
    return parser


def _version() -> str:
    try:
        return version("pcs-racing")
    except PackageNotFoundError:  # a checkout that is not installed
        return "(not installed)"
