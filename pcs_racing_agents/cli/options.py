"""Shared parts of commands: options, checks of output files and folders, browser pages."""

import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from pcs_racing.base.errors import InputError, check_path
from pcs_racing.race.config import KNOWN_RULES, PAPER, Rules, load_rules
from pcs_racing_agents.cli.commands import Option

DEFAULT_TRACK = "Brackwater"
"""The default track of commands and environments."""
TRACK_HELP = "name of a shipped circuit (see 'pcs-racing track show') or a map folder"
OWN_CODE = "FILE.py:Class, module:function"
FILES = f"model.zip, model.onnx, a folder of a trained planner, {OWN_CODE}"
POLICY_HELP = f"planner, planner:variant, planner:parameter=value,..., ARCHIVE[INDEX], {FILES}"
AGENT_HELP = f"agent, agent:option=value,... (see 'pcs-racing agents'), or a policy: {POLICY_HELP}"
LIKE_HELP = (
    "training environment of a model that does not name its own: duel, drive, or"
    " drive:argument=value,..."
)
RACED_CODE = (
    f"code of your own that raced in the folder, by the names that the results have: {OWN_CODE}"
)

Circuit = Annotated[str, Option(TRACK_HELP, "T")]
Circuits = Annotated[Sequence[str], Option(TRACK_HELP, "T")]
ArchiveName = Annotated[
    str | None, Option("policy archive: a name or a folder (default: the one for --rules)", "A")
]
RulesName = Annotated[str, Option(f"rules of the race: {', '.join(KNOWN_RULES)} or a YAML file")]
Like = Annotated[str | None, Option(LIKE_HELP, "ENV")]


class Terminated(KeyboardInterrupt):
    """SIGTERM, with the same effect as Ctrl-C."""


@dataclass(frozen=True, kw_only=True)
class RaceOptions:
    """Rules, duration and seed."""

    rules: RulesName = "paper"
    duration: Annotated[
        float | None, Option("duration of a race in s (default: from the rules, 40)", "S")
    ] = None
    seed: Annotated[int, Option("seed of the starts and of the noise")] = 0

    def read(self) -> Rules:
        """Return the rules of the options."""
        changes = {} if self.duration is None else {"duration": self.duration}
        return load_rules(self.rules, **changes)


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Parallel work."""

    workers: Annotated[
        int | None,
        Option("number of processes (default: threads of one process, on all cores)"),
    ] = None
    scheduler: Annotated[
        str | None,
        Option(
            "address of a dask scheduler, like tcp://host:8786; its workers run the tasks",
            "ADDRESS",
        ),
    ] = None

    def start(self) -> AbstractContextManager[Executor]:
        """Return the executor of the options, as a context."""
        # Imported late: the command `race`, without workers, reads this file, too.
        from pcs_racing_agents.base.executors import make_executor

        return make_executor(self.workers, self.scheduler)


def archive_for(archive: str | None, rules: Rules) -> str:
    """Return the requested archive, or the default archive for the rules' measure of its axis 0."""
    return archive or ("default" if rules.aggressiveness == PAPER.aggressiveness else "contest")


def can_draw(picture: str) -> bool:
    """Return whether matplotlib is installed; if not, print the missing picture and a remedy."""
    if find_spec("matplotlib") is not None:
        return True
    print(
        f'pcs-racing: {picture} is not drawn: pip install "pcs-racing[plots]" draws it',
        file=sys.stderr,
    )
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
    """Create a folder if it does not exist, and return its path."""
    check_path("the folder", path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"can't make the folder {path}: {error.strerror}") from None
    return path
