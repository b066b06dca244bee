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
from pcs_racing_agents.study.config import load_study_config
from studies.circuits import real_circuits

GAME, STUDIES = ("-m", "pcs_racing_agents"), ("-m", "studies")
"""Command lines of the package and of the studies, as arguments of Python."""
SMALL = Path(__file__).parent / "small"
"""Folder of the configurations of the small run."""
REAL = {"paper": ("Austin", "Monza", "Sepang", "Zandvoort"), "contest": ("Austin", "Monza")}
"""Real circuits added to the tests of each study; the names of the studies are those of rules."""

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
    found = {rules: ("--archive", str(out / f"archive-{rules}")) for rules in REAL}
    real = {
        rules: ("--test-track", *(str(maps / name) for name in names))
        for rules, names in REAL.items()
    }
    where = ("--maps", str(maps), *(["--small"] if small else []))
    # A study of `quick` wants more policies than a small archive has.
    paper = ("quick",) if small else ("paper", *found["paper"], *real["paper"])
    contest = str(SMALL / "study.yaml") if small else "contest"
    return [
        *(archive_step(rules, small) for rules in REAL),
        Step("paper", GAME, ("study", *paper), "report.html"),
        Step(
            "contest", GAME, ("study", contest, *found["contest"], *real["contest"]), "report.html"
        ),
        *(ppo_step(rules, found[rules], small) for rules in REAL),
        psro_step(found["contest"], small),
        Step("rows", STUDIES, ("rows", str(out / "paper")), "rows.csv", parallel=False),
        Step("family", STUDIES, ("family", *found["contest"], *where), "family.csv", False),
        Step("field", STUDIES, ("field", *where), "scores.csv"),
        Step("ppo-against-cfr", STUDIES, ("ppo-against-cfr", *where), "scores.csv"),
        protocol_step(small),
    ]


def archive_step(rules: str, small: bool) -> Step:
    """Return the search for the archive of some rules."""
    config = str(SMALL / f"archive_{rules}.yaml") if small else load_study_config(rules).archive
    return Step(f"archive-{rules}", GAME, ("synthesize", "--config", config), "manifest.yaml")


def ppo_step(rules: str, archive: tuple[str, ...], small: bool) -> Step:
    """Return the training of ``ppo`` for some rules."""
    given = ("train", "ppo", "--config", f"study-{rules}", *archive)
    few = ("--steps", "4096") if small else ()
    return Step(f"ppo-{rules}", GAME, (*given, *few), "agent/manifest.yaml")


def psro_step(archive: tuple[str, ...], small: bool) -> Step:
    """Return the training of ``psro`` in the contest, with circuits and opponents of its study."""
    config = str(SMALL / "psro.yaml") if small else "default"
    learning = load_study_config("contest").learning
    game = ("--track", *learning.tracks, "--pool", *learning.response_opponents, *archive)
    given = ("train", "psro", "--config", config, "--rules", "contest", *game)
    return Step("psro", GAME, given, "agent/set.yaml")


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
    small: Annotated[bool, Option("few races, to see that all steps run")] = False,
    workers: Annotated[int | None, Option("number of workers (default: number of cores)")] = None,
    scheduler: Annotated[str | None, Option("address of a dask scheduler", "ADDRESS")] = None,
) -> None:
    """Make all archives, studies and tables; finished steps are kept."""
    real_circuits(REAL["paper"], maps)  # a wrong folder is refused before the first step
    known = {one.name: one for one in steps(maps, out, small)}
    for name in step:
        if name not in known:
            raise InputError(f"step is {name!r}; {choices(name, known)}")
    options = [f"--workers={workers}"] if workers is not None else []
    options += [f"--scheduler={scheduler}"] if scheduler is not None else []
    # A folder belongs to one size and to one folder of circuits.
    with claim_folder(output_folder(out), "results", {"small": small, "maps": str(maps)}):
        run_steps([known[name] for name in step or known], out, options)
