"""Runner of a study: its stages in order, each in its own folder; finished stages are skipped.

A finished stage leaves a file ``done.yaml`` with digests of its outputs for later stages; a
stopped stage resumes its job. The results depend on the study's configuration alone.
"""

import hashlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pcs_racing.base.checks import is_number
from pcs_racing.base.errors import InputError, UnknownNameError, require
from pcs_racing.base.files import MAX_YAML, parse_yaml, read_limited, write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.folders import claim_folder, clear_half_written
from pcs_racing_agents.study import stages
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.report import write_report
from pcs_racing_agents.study.study import Study

DONE = "done.yaml"
"""File in the folder of a finished stage."""


class Stage(NamedTuple):
    """A stage of a study, with a folder of the same name."""

    name: str
    does: str  #: Short description of its work.
    run: Callable[[Study], Any]  #: Function ``run(study)``; it skips finished work.
    needs: tuple[str, ...] = ()  #: Stages to finish first.


LEARNED = ("networks", "sampled-cfr", "open-loop", "responses", "ppo")

STAGES = (
    Stage("archive", "searches policies", stages.make_the_archive),
    Stage("trees", "plays game trees", stages.play_trees, ("archive",)),
    Stage("networks", "trains networks on the trees", stages.train_networks, ("trees",)),
    Stage(
        "sampled-cfr",
        "learns regrets from sampled games",
        stages.learn_sampled_regrets,
        ("archive",),
    ),
    Stage("open-loop", "chooses the open-loop agents", stages.choose_open_loop, ("archive",)),
    Stage(
        "responses",
        "learns best responses to opponents",
        stages.learn_responses,
        ("networks", "open-loop"),
    ),
    Stage("ppo", "trains the PPO baseline", stages.train_ppo_baseline, ("archive",)),
    Stage("races", "drives the races of the tables", stages.table_races, LEARNED),
    Stage("ratings", "lets agents race all against all", stages.race_for_ratings, LEARNED),
    Stage("report", "writes results.csv and report.html", write_report, ("races", "ratings")),
)
"""All stages, in order of execution; the report is written at every run."""


def check_libraries(config: StudyConfig, stage: str) -> None:
    """Raise ModuleNotFoundError if a library that a stage needs is missing."""
    learning = config.learning
    learns = {
        "networks": learning.trees > 0,
        "responses": bool(learning.responses),
        "sampled-cfr": learning.sampled_cfr is not None,
    }
    if learns.get(stage):
        require("torch", extra="learning")
    elif stage == "ppo" and learning.ppo is not None:
        require("stable_baselines3", extra="learning")
    elif stage == "archive" and config.synthesis is not None:
        require("moocore", "cma", extra="synthesis")


def stage_seconds(study: Study) -> dict[str, float]:
    """Return the time of each finished stage, s, of the run that finished it."""
    return {name: float(note["seconds"]) for name, note in _notes(study.folder).items()}


def _notes(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the notes of finished stages, by name."""
    notes = {}
    for stage in STAGES:
        file = folder / stage.name / DONE
        if file.is_file():
            note = parse_yaml(file, read_limited(file, MAX_YAML, "the note of a stage"))
            seconds, files = (
                note.get(key) if isinstance(note, dict) else None for key in ("seconds", "files")
            )
            if not is_number(seconds) or not 0.0 <= seconds < 1e9 or not isinstance(files, dict):
                wrong = f"seconds are {seconds!r:.80}, files {files!r:.80}"
                raise InputError(f"{file} is damaged: {wrong}; delete it, and the stage runs again")
            notes[stage.name] = note
    return notes


def _digests(config: StudyConfig, folder: Path, stage: str) -> dict[str, str]:
    """Return digests of a stage's outputs for later stages, by path; jobs guard their chunks."""
    names = {
        "networks": config.learning.targets,
        "responses": config.learning.responses,
        "sampled-cfr": (stage, "regret"),
    }
    left = [f"networks/{name}/**/*" for name in names.get(stage, (stage,))]
    left += [f"{stage}/*", f"{stage}/*/job.yaml", f"{stage.replace('-', '_')}.csv"]
    found = {
        file.relative_to(folder): file for pattern in left for file in sorted(folder.glob(pattern))
    }
    return {
        name.as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for name, file in found.items()
        if file.is_file() and not file.name.startswith(".") and file.name != DONE
    }


def run_study(
    config: StudyConfig,
    folder: str | Path,
    *,
    only: Sequence[str] | None = None,
    executor: Executor | None = None,
    quiet: bool = False,
) -> Study:
    """Run a study, or the rest of a stopped one.

    Parameters
    ----------
    folder : str or Path
        New, empty, or of the same study.
    only : sequence of str, optional
        Names of stages to run (default: all). A stage may need results of earlier stages.
    executor : Executor, optional
        Executor of the jobs (:func:`pcs_racing_agents.base.executors.make_executor`). The results
        do not depend on it.
    """
    # Checks come before the folder: a misspelt stage or a missing library leaves nothing behind.
    remaining = stages_to_run(config, folder, only)
    study = Study(config, Path(folder), executor, quiet)
    with claim_folder(study.folder, "study", plain_settings(config)):
        for inner in study.folder.rglob("*/"):
            clear_half_written(inner)
        for stage in remaining:
            _run_stage(study, stage)
    return study


def stages_to_run(
    config: StudyConfig, folder: str | Path, only: Sequence[str] | None = None
) -> list[Stage]:
    """Return the remaining stages in order, after a check of their libraries and of all tracks.

    The arguments are as in :func:`run_study`.
    """
    names = [stage.name for stage in STAGES]
    for name in only or ():
        if name not in names:
            raise UnknownNameError(f"stage {name!r} is unknown; a study has {', '.join(names)}")
    remaining = [
        stage
        for stage in STAGES
        if (only is None or stage.name in only)
        and (stage.name == "report" or not _done(Path(folder), stage.name))
    ]
    for stage in remaining:
        check_libraries(config, stage.name)
    # Damaged or changed files would silently give other results.
    for name, note in _notes(Path(folder)).items():
        present = _digests(config, Path(folder), name)
        for file in note["files"]:
            if present.get(file) != note["files"][file]:
                raise InputError(
                    f"{Path(folder) / str(file)} is not what stage {name!r} left, by"
                    f" {Path(folder) / name / DONE}; delete both, and the stage runs again"
                )
    # A missing track of the last stage is reported now, not after hours of other stages.
    for name in config.tracks:
        load_track(name)
    return remaining


def _done(folder: Path, stage: str) -> bool:
    return (folder / stage / DONE).is_file()


def _run_stage(study: Study, stage: Stage) -> None:
    for name in stage.needs:
        if not _done(study.folder, name):
            raise InputError(
                f"stage {stage.name!r} needs stage {name!r}, which is not done in {study.folder}"
            )
    if not study.quiet:
        print(f"{stage.name}: {stage.does}", flush=True)
    folder = study.folder / stage.name
    folder.mkdir(exist_ok=True)
    began = time.monotonic()
    stage.run(study)
    # The note is written last: a stopped stage is not done, and runs again.
    note = {
        "stage": stage.name,
        "seconds": round(time.monotonic() - began, 1),
        "files": {} if stage.name == "report" else _digests(study.config, study.folder, stage.name),
    }
    text = yaml.safe_dump(note)
    write_atomically(folder / DONE, text)
