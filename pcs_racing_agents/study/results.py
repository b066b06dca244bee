"""Loader of the results of a tournament or study, to repeat and watch their races."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing_agents.study.config import load_study_config
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament.race_files import read_results
from pcs_racing_agents.watch.results_folder import MANIFEST, ResultsFolder, read_manifest


def open_results(folder: str | Path, code: Sequence[str] = ()) -> ResultsFolder:
    """Open a tournament's or study's folder; agents named in ``code`` may be code, which is run."""
    path = Path(folder)
    manifest = read_manifest(path)
    if manifest is None or manifest["kind"] not in ("tournament", "study"):
        raise InputError(
            f"{folder} holds no races; give a folder that 'pcs-racing tournament' or 'pcs-racing"
            " study' wrote with --out"
        )
    # A study stores the races of its ratings in a separate folder, with their lines next to it.
    file, study = path / "results.csv", None
    if manifest["kind"] == "study":
        study = _study(path, manifest)
    else:
        above = read_manifest(path.resolve().parent)
        if above is not None and above["kind"] == "study":
            study = _study(path.resolve().parent, above)
            file = path.resolve().with_suffix(".csv")
    if not file.exists():
        raise InputError(f"there is no {file}; it is written when all races are driven")
    races = read_results(file)
    results = ResultsFolder(
        path, manifest["settings"], races, study, manifest["kind"] == "tournament", code
    )
    for name in code:
        results.check_raced(name)
    return results


def _study(folder: Path, manifest: Mapping[str, Any]) -> Study:
    try:
        return Study(load_study_config(**manifest["settings"]), folder, quiet=True)
    except InputError as error:
        raise InputError(f"{folder / MANIFEST}: {error}") from None
