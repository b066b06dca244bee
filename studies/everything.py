"""``python -m studies all``: archives, studies and tables, one command after another."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from pcs_racing.base.errors import InputError, choices
from pcs_racing_agents.base.folders import claim_folder
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import output_folder
from studies.circuits import real_circuits

GAME, STUDIES = ("-m", "pcs_racing_agents"), ("-m", "studies")
"""Command lines of the package and of the studies, as arguments of Python."""
FIVE = Path(__file__).parent / "five_archives"
REACTING = 1, 3
"""Seeds of the archives whose policies may react to the lead by themselves."""
REAL = "Austin", "Monza"
"""Real circuits added to the tests of the contest."""

ENTRANTS = (
    *("never-switch", "random-moves", "best-fixed", "best-schedule", "best-lead-plan"),
    *("cfr-argmax", "cfr-regret-matching", "response", "ppo", "psro", "self-play"),
    *("line-ppo", "lidar-ppo", "lattice", "iterated-best-response", "gap-follower"),
)
"""Agents and planners raced by the shipped protocol."""


class Step(NamedTuple):
    """A command that writes into a folder of its own."""

    name: str
    program: tuple[str, ...]  #: Command line or script, as arguments of Python.
    arguments: tuple[str, ...]  #: Arguments without the folder.
    result: str  #: Last file that the command writes, relative to its folder.
    parallel: bool = True  #: True for a command with options of workers.


def steps(maps: Path, out: Path, small: bool) -> list[Step]:
    """Return all steps in their order; a step needs the results of earlier ones only."""
    seeds = range(2 if small else 5)
    paper = Step("paper", GAME, ("study", "quick" if small else "paper"), "report.html")
    return [
        *(archive_step(seed, small) for seed in seeds),
        paper,
        *(contest_step(seed, maps, out, small) for seed in seeds),
        *table_steps(seeds, maps, out, small),
        protocol_step(small),
    ]


def archive_step(seed: int, small: bool) -> Step:
    """Return the search for an archive; the archive of seed 0 has the name of the shipped one."""
    config = str(FIVE / "reacts.yaml") if seed in REACTING else "contest"
    config = str(FIVE / "small_archive.yaml") if small else config
    name = f"contest-{seed}" if seed else "contest"
    given = ("--config", config, "--seed", str(seed), "--name", name)
    return Step(f"archive-{seed}", GAME, ("synthesize", *given), "manifest.yaml")


def contest_step(seed: int, maps: Path, out: Path, small: bool) -> Step:
    """Return the study of the contest with an archive."""
    own = "small_study.yaml" if small else "table.yaml"
    study = str(FIVE / own) if seed or small else "contest"
    real = [str(maps / name) for name in REAL]
    archive = ("--archive", str(out / f"archive-{seed}"), "--seed", str(seed))
    return Step(
        f"contest-{seed}", GAME, ("study", study, *archive, "--test-track", *real), "report.html"
    )


def table_steps(seeds: Sequence[int], maps: Path, out: Path, small: bool) -> list[Step]:
    """Return the tables of the studies, and further races on the same circuits."""
    tables = tuple(str(out / f"contest-{seed}") for seed in seeds)
    where = ("--maps", str(maps), *(["--small"] if small else []))
    family = ("--archive", str(out / f"archive-{seeds[0]}"), *where)
    return [
        Step("rows", STUDIES, ("rows", str(out / "paper")), "rows.csv", parallel=False),
        Step("pool", STUDIES, ("pool", *tables), "gains.csv", parallel=False),
        Step("family", STUDIES, ("family", *family), "family.csv", parallel=False),
        Step("field", STUDIES, ("field", *where), "scores.csv"),
        Step("ppo-against-cfr", STUDIES, ("ppo-against-cfr", *where), "scores.csv"),
    ]


def protocol_step(small: bool) -> Step:
    """Return the races by the shipped protocol, in the small run of two agents."""
    agents = ENTRANTS[:2] if small else ENTRANTS
    given = ("tournament", "--protocol", "bench-v4", "--agents", *agents)
    return Step("protocol", GAME, given, "results.csv")


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
        print(f"{step.name}: python {' '.join((*step.program, *words))}", flush=True)
        done = subprocess.run([sys.executable, *step.program, *words], check=False)
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
    real_circuits(REAL, maps)  # a wrong folder is refused before the first step
    known = {one.name: one for one in steps(maps, out, small)}
    for name in step:
        if name not in known:
            raise InputError(f"step is {name!r}; {choices(name, known)}")
    options = [f"--workers={workers}"] if workers is not None else []
    options += [f"--scheduler={scheduler}"] if scheduler is not None else []
    # A folder belongs to one size and to one folder of circuits.
    with claim_folder(output_folder(out), "results", {"small": small, "maps": str(maps)}):
        run_steps([known[name] for name in step or known], out, options)
