"""The stages of a study, one after the other: each works in a folder of its own, and what is done is not done again.

    archive -> trees -> networks -> blind -> responses -> ppo -> races -> exploitability -> report

A stage that was finished left a file ``done.yaml``; a stage that was stopped goes on where its job was left. The
results are functions of the study's configuration alone.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.optional import require
from pcs_racing.base.reading import parse_yaml
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.game import RaceGame, make_game
from pcs_racing.track.track import Track, load_track
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.jobs.folders import claim_folder
from pcs_racing_agents.jobs.jobs import Progress, show_progress
from pcs_racing_agents.learning.ppo.learner import check_packages
from pcs_racing_agents.study.clock import seconds_counted
from pcs_racing_agents.study.config import BEST_BLIND, StudyConfig
from pcs_racing_agents.synthesis.config import load_archive_config

__all__ = ["STAGES", "Stage", "Study", "run_study", "stage_seconds", "stages_to_run"]

DONE = "done.yaml"
NETWORK_AGENTS = {
    "cfr-argmax": "regret",
    "cfr-regret-matching": "regret",
    "normalised-regret": "normalised",
    "advantage": "advantage",
    "static-q": "static-q",
    "nash": "nash",
    "ppo": "ppo",
}
"""What the networks of the zoo's agents are trained to say."""


@dataclass(frozen=True)
class Study:
    """A study and where it stands.

    Attributes
    ----------
    config : StudyConfig
    folder : Path
    executor : Executor, optional
        Where its jobs run.
    quiet : bool
        Show no progress.
    """

    config: StudyConfig
    folder: Path
    executor: Executor | None = None
    quiet: bool = False

    @cached_property
    def archive(self) -> PolicyArchive:
        """The archive that was made, or the one that the configuration names."""
        return load_archive(self.config.archive if self.config.synthesis is None else self.folder / "archive")

    @cached_property
    def setting(self) -> Setting:
        """Archive and rules, as agents know them."""
        return make_setting(self.archive, self.config.game)

    def game(self, track: str) -> RaceGame:
        """Return the game on a circuit."""
        return make_game(self.track(track), self.archive, self.config.game)

    def tree_game(self, track: str) -> RaceGame:
        """Return the game on a circuit as trees are played: without "stay", which makes them six times as large."""
        return make_game(self.track(track), self.archive, self.config.game, stay=False)

    def track(self, name: str) -> Track:
        """Return a circuit."""
        return load_track(name)

    def network(self, kind: str) -> Path:
        """Return the folder of a network that this study trains."""
        return self.folder / "networks" / kind

    def agent(self, name: str) -> Competitor:
        """Return an agent or driver by name: with the networks and choices of this study, where it has them.

        Besides the names of the zoo there are those of the configuration's ``responses``: the answer that was learned,
        made without a margin.
        """
        seed = self.config.seed
        if name in self.config.responses:
            agent = build("cfr-argmax", self.setting, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return Agent(name, agent.strategy, agent.setting, agent.seed, agent.facts)
        options: dict[str, Any] = {}
        kind = NETWORK_AGENTS.get(name)
        if name == "adaptive" and self.config.responses:
            options = {"network": self.network(self.config.responses[0]), "blind": self.agent("best-fixed")}
        elif kind is not None and self.network(kind).is_dir():
            options = {"network": self.network(kind)}
        elif name in BEST_BLIND:
            options = {"fit": self.folder / "blind" / f"{name}.yaml"}
        return build(name, self.setting, seed=seed, **options)

    def progress(self, unit: str) -> Progress | None:
        """Return a line on stderr that is kept up to date."""
        return None if self.quiet else show_progress(unit)


class Stage(NamedTuple):
    """A stage of a study.

    Attributes
    ----------
    name : str
        Also of its folder.
    does : str
        What it does, in a sentence.
    run : callable
        ``run(study)`` does it; what an earlier call has done is not done again.
    """

    name: str
    does: str
    run: Callable[[Study], None]


def _stages() -> tuple[Stage, ...]:
    from pcs_racing_agents.study import preparing, racing, reporting

    return (
        Stage("archive", "finds the policies", preparing.make_the_archive),
        Stage("trees", "plays game trees", preparing.play_trees),
        Stage("networks", "trains networks on the trees", preparing.train_networks),
        Stage("blind", "chooses the best strategies that never look at the race", preparing.choose_blind),
        Stage("responses", "learns answers to opponents", preparing.learn_responses),
        Stage("ppo", "trains the PPO baseline", preparing.train_ppo_baseline),
        Stage("races", "drives the races of the table", racing.race_cells),
        Stage("rivals", "lets agents race all against all", racing.race_rivals),
        Stage("exploitability", "judges agents on trees that no network has seen", racing.judge_on_trees),
        Stage("report", "writes results.csv and report.html", reporting.write_report),
    )


STAGES = (
    "archive",
    "trees",
    "networks",
    "blind",
    "responses",
    "ppo",
    "races",
    "rivals",
    "exploitability",
    "report",
)
"""Names of the stages, in order."""


def run_study(
    config: StudyConfig,
    folder: str | Path,
    *,
    only: Sequence[str] | None = None,
    executor: Executor | None = None,
    quiet: bool = False,
) -> Study:
    """Run a study, or what is left of it.

    Parameters
    ----------
    config : StudyConfig
    folder : str or Path
        New, empty, or left by the same study.
    only : sequence of str, optional
        Stages to run; each needs what the earlier ones left. All by default.
    executor : Executor, optional
        Where its jobs run (:func:`pcs_racing_agents.jobs.jobs.make_executor`). It does not change the results.
    quiet : bool
        Show no progress.

    Raises
    ------
    UnknownNameError
        If there is no such stage.
    InputError
        If the folder holds something else, or a stage needs what an earlier one has not left yet.
    ModuleNotFoundError
        If a library is missing that one of the stages needs; nothing is begun then.
    """
    left = stages_to_run(config, folder, only)
    study = Study(config, Path(folder), executor, quiet)
    for name in config.every_track:
        study.track(name)  # an unknown circuit is an error now, not in an hour
    with claim_folder(study.folder, "study", plain_settings(config)):
        for stage in _stages():
            if stage.name in left:
                _run_stage(study, stage)
    return study


def stages_to_run(config: StudyConfig, folder: str | Path, only: Sequence[str] | None = None) -> list[str]:
    """Return the stages that are still to be run, in order, after checking that what they need is installed.

    Parameters
    ----------
    config, folder, only
        As for :func:`run_study`.

    Raises
    ------
    UnknownNameError
        If there is no such stage.
    ModuleNotFoundError
        If a library is missing that one of them needs; the message says how to install it.
    """
    chosen = list(STAGES if only is None else only)
    for name in chosen:
        if name not in STAGES:
            raise UnknownNameError(f"stage {name!r} is unknown; a study has {', '.join(STAGES)}")
    # The report costs seconds and shows what is there: it is always written anew.
    left = [
        name for name in STAGES if name in chosen and (name == "report" or not (Path(folder) / name / DONE).is_file())
    ]
    if "archive" in left and config.synthesis is not None:
        method = load_archive_config(config.synthesis).method
        require("moocore", *(("cma",) if method == "mo-cma-es" else ()), extra="synthesis")
    if ("networks" in left and config.pairs > 0) or ("responses" in left and config.responses):
        require("torch", extra="learning")
    if "ppo" in left and config.ppo is not None:
        check_packages()
    return left


def stage_seconds(study: Study) -> dict[str, float]:
    """Return how long each stage that is done took, s; with the time before it was stopped, if it was."""
    seconds = {}
    for name in STAGES:
        file = study.folder / name / DONE
        if file.is_file():
            seconds[name] = _seconds(file)
    return seconds


def _seconds(file: Path) -> float:
    note = parse_yaml(file, file.read_bytes())
    found = note.get("seconds") if isinstance(note, dict) else None
    if isinstance(found, bool) or not isinstance(found, int | float) or not 0.0 <= found < 1e9:
        raise InputError(f"{file} is damaged: seconds are {found!r:.80}; delete it, and the stage runs again")
    return float(found)


def _run_stage(study: Study, stage: Stage) -> None:
    folder = study.folder / stage.name
    for earlier in STAGES[: STAGES.index(stage.name)]:
        if not (study.folder / earlier / DONE).is_file():
            raise InputError(f"stage {stage.name!r} needs stage {earlier!r}, which is not done in {study.folder}")
    file = folder / DONE
    if not study.quiet:
        print(f"{stage.name}: {stage.does}", flush=True)
    folder.mkdir(exist_ok=True)
    with seconds_counted(folder / "seconds.txt") as spent:
        stage.run(study)
        text = yaml.safe_dump({"stage": stage.name, "seconds": round(spent(), 1)})
        write_atomically(file, lambda out: out.write(text.encode("utf-8")))
