"""What several commands share: options, checks of the files and folders that they write, pages in a browser."""

import argparse
import os
import sys
import webbrowser
from http.server import ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from pcs_racing.base.errors import InputError
from pcs_racing.race.config import PRESETS, RaceConfig, load_race_config

DEFAULT_TRACK = "Brackwater"
"""The circuit that commands and environments use by default."""
TRACK_HELP = "name of a shipped circuit (see 'pcs-racing track list') or a map folder"
POLICY_HELP = "planner, planner:variant or planner:parameter=value,... (see 'pcs-racing policies')"


class Commands(Protocol):
    """What ``ArgumentParser.add_subparsers`` returns."""

    def add_parser(self, name: str, **options: Any) -> argparse.ArgumentParser:
        """Add a command."""


def add_command(commands: Commands, name: str, summary: str, *examples: str) -> argparse.ArgumentParser:
    """Add a command with one sentence of help and examples of its use."""
    return commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        epilog="\n  ".join(["examples:" if len(examples) > 1 else "example:", *examples]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def add_track(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--track`` for one circuit."""
    parser.add_argument("--track", default=DEFAULT_TRACK, metavar="T", help=f"{TRACK_HELP} (default: {DEFAULT_TRACK})")


def add_tracks(parser: argparse.ArgumentParser) -> None:
    """Add the option that names one circuit or several."""
    parser.add_argument(
        "--track", default=[DEFAULT_TRACK], nargs="+", metavar="T", help=f"{TRACK_HELP} (default: {DEFAULT_TRACK})"
    )


def add_race(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--race`` for the rules of the race."""
    presets = ", ".join(PRESETS)
    parser.add_argument("--race", default="paper", help=f"rules of the race: {presets} or a YAML file (default: paper)")


def add_rules(parser: argparse.ArgumentParser, seed: int = 0) -> None:
    """Add the options that :func:`rules` reads, and the option ``--seed`` with its default."""
    add_race(parser)
    parser.add_argument(
        "--duration", type=float, metavar="S", help="duration of a race in s (default: that of the preset, 40)"
    )
    parser.add_argument(
        "--seed", type=int, default=seed, metavar="N", help=f"seed of the starts and of the noise (default: {seed})"
    )


def rules(arguments: argparse.Namespace) -> RaceConfig:
    """Return the race configuration that the options ask for."""
    changes = {} if arguments.duration is None else {"duration": arguments.duration}
    return load_race_config(arguments.race, **changes)


def can_draw(picture: str) -> bool:
    """Return whether matplotlib is installed; if not, print on stderr which picture is missing and what to install."""
    if find_spec("matplotlib") is not None:
        return True
    print(f'pcs-racing: {picture} is not drawn: pip install "pcs-racing[plots]" draws it', file=sys.stderr)
    return False


def output_file(path: Path, *endings: str) -> Path:
    """Check that a file can be written, before any long work, and return its path."""
    if path.suffix not in endings:
        raise InputError(f"can't write {path}: its name must end in {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise InputError(f"can't write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"can't write {path}: it is a folder")
    return path


def output_folder(path: Path) -> Path:
    """Make a folder if it does not exist, and return its path."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"can't make the folder {path}: {error.strerror}") from None
    return path


def open_page(address: str) -> None:
    """Open a browser if there is a display; without one, Python would start a browser in this terminal."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return
    webbrowser.open(address)


def serve(server: ThreadingHTTPServer, what: str, *, open_it: bool) -> None:
    """Serve a page until the command is interrupted; prints what is at which address."""
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    print(f"{what} at {address} (Ctrl-C ends it)", flush=True)
    if open_it:
        open_page(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
