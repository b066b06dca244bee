"""Running a study: its stages in order, each in its own folder; finished stages are skipped.

A finished stage leaves a file ``done.yaml``; a stopped stage resumes its job. The results are functions of the study's
configuration alone. The time of a stage includes earlier runs of it that were stopped or killed.
"""

import threading
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

BEAT = 20.0  # s: longest time that is lost when the process is killed


@contextmanager
def seconds_counted(file: Path) -> Iterator[Callable[[], float]]:
    """Measure the time of a stage, starting at the seconds in a file of a stopped run.

    Parameters
    ----------
    file : Path
        Updated regularly; removed when the work is done.

    Yields
    ------
    callable
        Returns the seconds so far.
    """
    before, began, done = _read(file), time.monotonic(), threading.Event()

    def spent() -> float:
        return before + time.monotonic() - began

    def write() -> None:
        text = f"{spent():.1f}\n".encode()
        write_atomically(file, lambda out: out.write(text))

    def write_regularly() -> None:
        while not done.wait(BEAT):
            write()

    thread = threading.Thread(target=write_regularly, daemon=True)
    thread.start()
    try:
        yield spent
    except BaseException:
        done.set()
        thread.join()
        write()
        raise
    done.set()
    thread.join()
    file.unlink(missing_ok=True)


def _read(file: Path) -> float:
    """Return the seconds in a file; 0 if there are none or they are impossible."""
    try:
        seconds = float(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0.0
    return seconds if 0.0 <= seconds < 1e9 else 0.0


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

    Parameters
    ----------
    config, folder, only
        As for :func:`run_study`.
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
