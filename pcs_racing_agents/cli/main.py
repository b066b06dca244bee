"""The command line ``pcs-racing``: argument parser, command runner, and one-line errors."""

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
from typing import Any

from pcs_racing.base.errors import InputError, UnknownNameError, choices
from pcs_racing.race.config import load_rules
from pcs_racing.track.maps import find_shipped
from pcs_racing_agents.base.folders import package_version
from pcs_racing_agents.cli.commands import Parser, add_commands
from pcs_racing_agents.cli.options import Terminated

FAILED = 2

FILES = {
    "race": ("race", "simulate one race between two or more policies"),
    "tournament": (
        "tournament",
        "race every pair of agents and policies, or all by a protocol, and print a table",
    ),
    "track": ("track", "show, import, generate and calibrate circuits"),
    "agents": (
        "agents",
        "list agents and planners, or describe one: options, training, strength; parameters",
    ),
    "export": ("agents", "write the network of a policy or planner as an ONNX file"),
    "tune": (
        "search",
        "tune the parameters of a planner by races, and check them on circuits held out",
    ),
    "synthesize": (
        "search",
        "search for an archive of policies that drive differently",
    ),
    "tree": (
        "trees",
        "build game trees: simulate all moves of both players, for pairs of starting policies",
    ),
    "solve": (
        "trees",
        "solve game trees exactly and by regret minimisation, or export a tree",
    ),
    "train": (
        "train",
        "train the network of an agent: on game trees, by PPO, or in branched races",
    ),
    "study": (
        "study",
        "run a complete study: archive, game trees, networks, agents, races and report",
    ),
    "view": (
        "view",
        "write a page that lists and plays the races of a tournament or study, or explain a race",
    ),
    "compile": (
        "compilation",
        "compile the kernels now (they are cached on disk)",
    ),
}
"""File in this folder and summary of each command, in help order: a call imports its file only."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command from the words after ``pcs-racing`` (default: ``sys.argv``).

    Return the exit status: 0, or 2 after a correctable error (printed as one line on stderr), 130
    after Ctrl-C, and 143 after SIGTERM.
    """
    if sys.stderr is None:  # closed: output is dropped, and no later file gets its number
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    if sys.stdout is None:
        return _fail(InputError("the standard output is closed; send it to a file or to /dev/null"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # escape unsupported characters
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
    return run_parsed(_parser(words[0] if words else None, brief=True).parse_args(words))


def run_parsed(parsed: argparse.Namespace) -> int:
    """Run a parsed command, and return the exit status of :func:`main`."""
    logging.basicConfig(format="pcs-racing: %(message)s", level=logging.WARNING)
    try:
        with _terminable():
            parsed.run(parsed)
            sys.stdout.flush()
    except (InputError, ModuleNotFoundError) as error:
        return _fail(error)
    except BrokenPipeError:
        # The reader (a pager, head) has closed the pipe. Without this Python fails at exit.
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
    except SystemExit as stop:  # e.g. from an agent
        return _fail(InputError(f"code of your own ended the process: SystemExit: {stop.code}"))
    except Exception as error:
        # Imported here, since the import takes as long as a race.
        from pcs_racing_agents.base.executors import is_lost

        if not is_lost(error):
            raise
        return _fail(
            InputError(f"a worker failed or the cluster is unreachable ({error}); rerun to resume")
        )
    return 0


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end the block like Ctrl-C: close files, unlock folders and stop workers."""
    if threading.current_thread() is not threading.main_thread():  # no signals elsewhere
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


def _parser(command: str | None = None, *, brief: bool = False) -> argparse.ArgumentParser:
    """Return the parser of a command, or of all if unknown; a brief parser only lists commands."""
    parser = Parser(
        prog="pcs-racing",
        description=(
            "Simulate head-to-head races of two cars; search, train and compare policies and agents"
            " for them."
        ),
        epilog=(
            "'pcs-racing help COMMAND' shows the options of a command and an example of its use."
        ),
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {package_version()}")
    commands: Any = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    if brief and command not in FILES:
        for name, (_, summary) in FILES.items():
            commands.add_parser(name, help=summary)
        return parser
    # Each file imports modules for its options: importing all files takes longer than a race.
    wanted = [FILES[command]] if command in FILES else FILES.values()
    for file in dict.fromkeys(file for file, _ in wanted):
        add_commands(commands, import_module(f"pcs_racing_agents.cli.{file}"))
    return parser


def check_command(word: str, commands: Sequence[str]) -> None:
    """Refuse an unknown command."""
    if word not in commands and not word.startswith("-"):
        raise UnknownNameError(f"command {word!r} is unknown; {choices(word, commands)}")


def check_names(words: Sequence[str]) -> None:
    """Refuse unknown names of tracks and rules before the import of the racing code."""
    option = ""
    for word in words[1:]:
        if word.startswith("--"):
            option, _, word = word.partition("=")
        if not word or os.path.exists(word) or os.sep in word:
            continue
        if option == "--track":
            find_shipped(word)
        elif option == "--rules" and "." not in word:
            load_rules(word)
