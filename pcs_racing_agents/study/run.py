"""Running a study: its stages in order, each in its own folder; finished stages are skipped.

A finished stage leaves a file ``done.yaml``; a stopped stage resumes its job. The results are functions of the study's
configuration alone. The time of a stage includes earlier runs of it that were stopped.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import yaml

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.track.loading import load_track
from pcs_racing_agents.jobs.folders import claim_folder
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.stages import DONE, STAGES, Stage
from pcs_racing_agents.study.study import Study


@contextmanager
def seconds_counted(file: Path) -> Iterator[Callable[[], float]]:
    """Measure the time of a stage, and return a function of it; a stop leaves it in a file, from which it goes on."""
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
        Names of stages to run; each needs the results of some earlier ones. All by default.
    executor : Executor, optional
        Runs the jobs (:func:`pcs_racing_agents.jobs.executors.make_executor`). It does not change the results.
    """
    remaining = stages_to_run(config, folder, only)
    study = Study(config, Path(folder), executor, quiet)
    with claim_folder(study.folder, "study", plain_settings(config)):
        for stage in remaining:
            _run_stage(study, stage)
    return study


def stages_to_run(config: StudyConfig, folder: str | Path, only: Sequence[str] | None = None) -> list[Stage]:
    """Return the stages that are still to be run, in order, after a check of their libraries and of all circuits.

    Arguments are those of :func:`run_study`.
    """
    names = [stage.name for stage in STAGES]
    for name in only or ():
        if name not in names:
            raise UnknownNameError(f"stage {name!r} is unknown; a study has {', '.join(names)}")
    remaining = [
        stage
        for stage in STAGES
        if (only is None or stage.name in only) and (stage.always or not _done(Path(folder), stage.name))
    ]
    for stage in remaining:
        stage.check_libraries(config)
    for name in config.every_track:
        load_track(name)
    return remaining


def _done(folder: Path, stage: str) -> bool:
    return (folder / stage / DONE).is_file()


def _run_stage(study: Study, stage: Stage) -> None:
    for name in stage.needs:
        if not _done(study.folder, name):
            raise InputError(f"stage {stage.name!r} needs stage {name!r}, which is not done in {study.folder}")
    if not study.quiet:
        print(f"{stage.name}: {stage.does}", flush=True)
    folder = study.folder / stage.name
    folder.mkdir(exist_ok=True)
    with seconds_counted(folder / "seconds.txt") as spent:
        stage.run(study)
        text = yaml.safe_dump({"stage": stage.name, "seconds": round(spent(), 1)})
        write_atomically(folder / DONE, lambda out: out.write(text.encode("utf-8")))
