"""Runner of a study: its stages in order, each in its own folder; finished stages are skipped.

A finished stage leaves a file ``done.yaml`` with digests of its outputs for later stages; a
stopped stage resumes its job. The results depend on the study's configuration alone. The time of
a stage includes its stopped runs.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pcs_racing.base.checks import is_number
from pcs_racing.base.errors import InputError, UnknownNameError, require
from pcs_racing.base.files import MAX_YAML, parse_yaml, read_limited, write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.folders import claim_folder, clear_half_written
from pcs_racing_agents.learning.ppo.learner import check_packages
from pcs_racing_agents.study import playing, preparing, reporting
from pcs_racing_agents.study.study import Study, StudyConfig

DONE, SECONDS = "done.yaml", "seconds.txt"
"""Files in the folder of a finished stage and of a stopped stage."""


def _report(study: Study) -> None:
    reporting.write_report(study, stage_seconds(study))


class Stage(NamedTuple):
    """A stage of a study, with a folder of the same name."""

    name: str
    needs: tuple[str, ...]  #: Stages to finish first.
    does: str  #: Short description of its work.
    run: Callable[[Study], None]  #: Function ``run(study)``; it skips finished work.
    always: bool = False  #: True to run again after it is done.

    def check_libraries(self, config: StudyConfig) -> None:
        """Raise ModuleNotFoundError if a required library is missing."""
        learns = {
            "networks": config.pairs > 0,
            "responses": bool(config.responses),
            "sampled-cfr": config.sampled_cfr is not None,
        }
        if learns.get(self.name):
            require("torch", extra="learning")
        elif self.name == "ppo" and config.ppo is not None:
            check_packages()
        elif self.name == "archive" and config.synthesis is not None:
            require("moocore", "cma", extra="synthesis")


LEARNED = ("networks", "sampled-cfr", "open-loop", "responses", "ppo")

STAGES = (
    Stage("archive", (), "searches policies", preparing.make_the_archive),
    Stage("trees", ("archive",), "plays game trees", preparing.play_trees),
    Stage("networks", ("trees",), "trains networks on the trees", preparing.train_networks),
    Stage(
        "sampled-cfr",
        ("archive",),
        "learns regrets from sampled games",
        preparing.learn_sampled_regrets,
    ),
    Stage(
        "open-loop",
        ("archive",),
        "chooses the best agents that look at nothing but who leads",
        preparing.choose_open_loop,
    ),
    Stage(
        "responses",
        ("networks", "open-loop"),
        "learns answers to opponents",
        preparing.learn_responses,
    ),
    Stage("ppo", ("archive",), "trains the PPO baseline", preparing.train_ppo_baseline),
    Stage("races", LEARNED, "drives the races of the table", playing.race_tables),
    Stage("ratings", LEARNED, "lets agents race all against all", playing.race_for_ratings),
    Stage(
        "report", ("races", "ratings"), "writes results.csv and report.html", _report, always=True
    ),
)
"""All stages, in order of execution."""


def stage_seconds(study: Study) -> dict[str, float]:
    """Return the time of each finished stage, s, including its stopped runs."""
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
        "networks": config.targets,
        "responses": config.responses,
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
        if file.is_file() and not file.name.startswith(".") and file.name not in (DONE, SECONDS)
    }


@contextmanager
def seconds_counted(file: Path) -> Iterator[Callable[[], float]]:
    """Yield a function of a stage's elapsed time; a stopped run saves the time for the next."""
    try:
        before = float(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        before = 0.0
    began = time.monotonic()

    def spent() -> float:
        return (before if 0.0 <= before < 1e9 else 0.0) + time.monotonic() - began

    try:
        yield spent
    except BaseException:
        write_atomically(file, lambda out: out.write(f"{spent():.1f}\n".encode()))
        raise
    file.unlink(missing_ok=True)


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
        and (stage.always or not _done(Path(folder), stage.name))
    ]
    for stage in remaining:
        stage.check_libraries(config)
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
    for name in config.every_track:
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
    # The note is written last: a stopped stage is not done, and runs again.
    with seconds_counted(folder / SECONDS) as spent:
        stage.run(study)
        files = {} if stage.always else _digests(study.config, study.folder, stage.name)
        text = yaml.safe_dump({"stage": stage.name, "seconds": round(spent(), 1), "files": files})
        write_atomically(folder / DONE, lambda out: out.write(text.encode("utf-8")))
