"""``python -m studies all``: archives, studies and tables, one command after another."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from pcs_racing.base.errors import InputError, choices
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import output_folder

GAME, STUDIES = "pcs_racing_agents", "studies"
"""Modules of the two command lines."""
FIVE = Path(__file__).parent / "five_archives"
REACTING = 1, 3
"""Seeds of the archives whose policies may react to the lead by themselves."""
REAL = "Austin", "Monza"
"""Real circuits added to the tests of the contest."""
CARDS = (
    *("never-switch", "random-moves", "best-fixed", "best-schedule", "best-lead-plan"),
    *("cfr-argmax", "cfr-regret-matching", "response", "ppo"),
    *("line-ppo", "lidar-ppo", "lattice", "lattice:early", "iterated-best-response"),
    *("alpha-racer", "ppo-drive", "gap-follower", "pure-pursuit", "spliner"),
)
"""Agents and planners on the leaderboard."""


class Step(NamedTuple):
    """A command that writes into a folder of its own."""

    name: str
    module: str  #: Command line: of the package or of the studies.
    arguments: tuple[str, ...]  #: Arguments without the folder.
    result: str  #: Last file that the command writes, relative to its folder.
    parallel: bool = True  #: True for a command with options of workers.


def steps(maps: Path, out: Path, small: bool) -> list[Step]:
    """Return all steps in their order; a step needs the results of earlier ones only."""
    seeds = range(2 if small else 5)
    archives = [str(out / f"archive-{seed}") for seed in seeds]
    real = [str(maps / name) for name in REAL]
    shorter = ("--small",) if small else ()
    where = ("--maps", str(maps), *shorter)
    cards = CARDS[:2] if small else CARDS
    found: list[Step] = []
    for seed in seeds:
        reacts = str(FIVE / "reacts.yaml") if seed in REACTING else "contest"
        config = str(FIVE / "small_archive.yaml") if small else reacts
        given = ("--config", config, "--seed", str(seed), "--name", _name(seed))
        found.append(Step(f"archive-{seed}", GAME, ("synthesize", *given), "manifest.yaml"))
    paper = "quick" if small else "paper"
    found.append(Step("paper", GAME, ("study", paper), "report.html"))
    for seed, archive in zip(seeds, archives, strict=True):
        study = str(FIVE / "small_study.yaml") if small else "contest"
        own = ("--archive", archive, "--seed", str(seed), "--test-track", *real)
        found.append(Step(f"contest-{seed}", GAME, ("study", study, *own), "report.html"))
    tables = tuple(str(out / f"contest-{seed}") for seed in seeds)
    return [
        *found,
        Step("rows", STUDIES, ("rows", str(out / "paper")), "rows.csv", parallel=False),
        Step("pool", STUDIES, ("pool", *tables), "gains.csv", parallel=False),
        Step("long-races", STUDIES, ("long-races", "--archives", *archives, *where), "gains.csv"),
        Step(
            "family",
            STUDIES,
            ("family", "--archive", archives[0], *where),
            "family.csv",
            parallel=False,
        ),
        Step("field", STUDIES, ("field", *where), "scores.csv"),
        Step("ppo-against-cfr", STUDIES, ("ppo-against-cfr", *where), "scores.csv"),
        Step(
            "cards",
            GAME,
            ("benchmark", "card", *cards),
            f"{cards[-1]}/card.json",
        ),
        Step(
            "leaderboard",
            GAME,
            ("benchmark", "leaderboard", str(out / "cards")),
            "leaderboard.html",
            parallel=False,
        ),
    ]


def _name(seed: int) -> str:
    """Return the name of an archive: the shipped one has seed 0."""
    return f"contest-{seed}" if seed else "contest"


def run_steps(chosen: Sequence[Step], out: Path, workers: Sequence[str]) -> None:
    """Run the steps without a result, each in a process of its own; the first failure ends it.

    ``workers``: options of commands that work in parallel.
    """
    for step in chosen:
        folder = out / step.name
        if (folder / step.result).is_file():
            print(f"{step.name}: finished, {folder / step.result}", flush=True)
            continue
        words = (*step.arguments, "--out", str(folder), *(workers if step.parallel else ()))
        print(f"{step.name}: python -m {step.module} {' '.join(words)}", flush=True)
        done = subprocess.run([sys.executable, "-m", step.module, *words], check=False)
        if done.returncode or not (folder / step.result).is_file():
            raise InputError(
                f"step {step.name!r} ended with status {done.returncode}; run the same command"
                " again to resume there"
            )


@command("all", "python -m studies all --maps maps --out out/all")
def run(
    *,
    maps: Annotated[Path, Option("folder of the real circuits", "DIR")],
    out: Annotated[Path, Option("folder with a folder for each step; resumes there", "DIR")],
    step: Annotated[Sequence[str], Option("steps to run (default: all)", "NAME")] = (),
    small: Annotated[bool, Option("two archives and few races, to see that all steps run")] = False,
    workers: Annotated[int | None, Option("number of workers (default: number of cores)")] = None,
    scheduler: Annotated[str | None, Option("address of a dask scheduler", "ADDRESS")] = None,
) -> None:
    """Make all archives, studies and tables; finished steps are kept."""
    missing = [name for name in REAL if not (maps / name).is_dir()]
    if missing:
        raise InputError(f"{maps} lacks the circuits {', '.join(missing)}")
    known = {one.name: one for one in steps(maps, out, small)}
    for name in step:
        if name not in known:
            raise InputError(f"step is {name!r}; {choices(name, known)}")
    options = [f"--workers={workers}"] if workers is not None else []
    options += [f"--scheduler={scheduler}"] if scheduler is not None else []
    run_steps([known[name] for name in step or known], output_folder(out), options)
