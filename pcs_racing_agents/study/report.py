"""The last stage: race results line by line, tables, and the report page."""

import platform
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.fits import load_fit
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.folders import package_version
from pcs_racing_agents.base.statistics import clustered_mean, varied
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.study.config import BEST_OPEN_LOOP
from pcs_racing_agents.study.report_page import (
    ExplainedRace,
    ReportContent,
    TitledTable,
    report_page,
)
from pcs_racing_agents.study.stages import StudyRaces, table_races
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.study.table import StudyTable, by_progress, make_table
from pcs_racing_agents.study.table_output import (
    overview_rows,
    paper_rows,
    table_text,
    verdict_text,
    write_table,
)
from pcs_racing_agents.tournament import (
    Pairing,
    RaceTable,
    RoundRobin,
    closeness_text,
    concatenate_races,
    read_results,
    round_robin,
    write_results,
)
from pcs_racing_agents.watch.explain import explain_race
from pcs_racing_agents.watch.pages import Standing, winner_text
from pcs_racing_agents.watch.race_choice import OUTCOMES, outcomes
from pcs_racing_agents.watch.words import story

FURTHER = "further"  # the second table
GAME_THEORETIC = "cfr-argmax"  # the paper's agent
MIN_RACES = 1000  # per agent and row; below it is a smoke test; paper: 4,000
WATCHED = (
    ("a win by switching", "a win with switches"),
    ("a loss",),
    ("a crash of its own",),
)
"""Outcomes of the report's example races; of several, the first that occurred."""


def write_report(study: Study) -> None:
    """Write the races, the tables and the report.

    The files are ``results.csv``, ``table.csv``, ``table.txt``, ``report.html``, and with a second
    table ``table_further.csv``.
    """
    cells = table_races(study)
    folder = study.folder
    write_results((row for cell in cells for row in cell.races), folder / "results.csv")
    main = study_table(study, races_of(cells))
    write_table(main, folder / "table.csv")
    write_atomically(folder / "table.txt", table_text(main))
    further = None if study.config.further is None else study_table(study, races_of(cells, FURTHER))
    if further is not None:
        write_table(further, folder / "table_further.csv")
    content = report_content(study, cells, main, further)
    write_atomically(folder / "report.html", report_page(content))


def races_of(cells: Sequence[StudyRaces], table: str = "main") -> RaceTable:
    """Return the races of one of the study's tables."""
    return concatenate_races(cell.races for cell in cells if cell.table == table)


def study_table(study: Study, races: RaceTable) -> StudyTable:
    """Compare the agents of one of the study's tables."""
    config, open_loop = study.config, best_open_loop(study)
    table = make_table(
        races,
        best=config.best,
        # The second table may lack the baselines of the first.
        open_loop=open_loop if open_loop in races.agents.words else None,
        train={load_track(name).name for name in config.learning.tracks},
    )
    if config.game.race.name == "paper":
        return table
    # The paper's figures are comparable under the paper's rules only.
    return replace(table, rows=tuple(replace(row, paper=None) for row in table.rows))


def best_open_loop(study: Study) -> str | None:
    """Return the fitted baseline with the max number of training wins; None without such agents.

    Candidates are the best fixed policy, the best open-loop sequence and the best lead plan. On
    the training races the sequence is at least as good as any constant move, and the plan as any
    fixed policy, since their searches begin with the best constant move and the best fixed policy.
    """
    if not set(BEST_OPEN_LOOP) <= set(study.config.table.agents):
        return None
    fits = {name: load_fit(study.folder / "open-loop" / f"{name}.yaml") for name in BEST_OPEN_LOOP}
    return max(BEST_OPEN_LOOP, key=lambda name: float(fits[name].training["reached"]))  # first max


def report_content(
    study: Study, cells: Sequence[StudyRaces], main: StudyTable, further: StudyTable | None
) -> ReportContent:
    """Return all that the report shows."""
    config, game = study.config, study.config.game
    sheets = list(_papers_statistic(study, races_of(cells)))
    if further is not None:
        head, *rows = overview_rows(further)
        races = further.rows[0].arms[0].races
        note = f"{races} races of each agent in each row."
        sheets.append(TitledTable("More opponents, tracks and agents", head, rows, note))
    ratings = study.folder / "ratings.csv"
    scores = standings(races_of(cells))
    return ReportContent(
        title=f"Study: {game.race.name} race, archive {study.archive.name}",
        facts=(
            f"{sum(len(cell.races) for cell in cells):,} races of {game.horizon:g} s between two"
            " cars."
        ),
        about=(
            f"Every {game.step_seconds:g} s an agent may change its policy, which is how its"
            f" car drives, by {game.epsilon} of the archive's range on an axis. The baseline is"
            f" {main.base}.\n\n"
            f"{closeness_text(concatenate_races(cell.races for cell in cells))}"
        ),
        findings=[winner_text(scores), *_findings(main)],
        caution=_caution(main),
        table=main,
        standings=scores,
        archive=study.archive,
        epsilon=game.epsilon,
        curves=_loss_curves(study),
        round_robin=_round_robin(study) if ratings.is_file() else None,
        sheets=sheets,
        races=list(_watched(study, [cell for cell in cells if cell.table == "main"])),
        settings=plain_settings(config),
        versions=software(),
    )


def standings(races: RaceTable) -> list[Standing]:
    """Return the score of each agent over all races, best first.

    The intervals are robust to clusters of start policies and of the opponents' variants; they
    hold for these tracks.
    """
    found = []
    egos, rivals = races.agents.codes.T.astype(np.int64)
    start, variant = races.variants.T.astype(np.int64)
    opponent = rivals * (variant.max() + 1) + variant
    for ego in np.unique(egos):
        own = egos == ego
        mean = clustered_mean(races.score[own], *varied(start[own], opponent[own]))
        low, high = max(mean.low, 0.0), min(mean.high, 1.0)
        name = races.agents.words[ego]
        found.append(Standing(name, mean.mean, low, high, int(own.sum())))
    return sorted(found, key=lambda one: (-one.score, one.name))


def _papers_statistic(study: Study, races: RaceTable) -> Iterator[TitledTable]:
    """Write the main table by the paper's statistic and yield it; only under the paper's rules."""
    table = study_table(study, by_progress(races))
    if GAME_THEORETIC not in table.arms or not any(row.paper for row in table.rows):
        return
    write_table(table, study.folder / "table_by_progress.csv")
    head, *rows = paper_rows(table, GAME_THEORETIC)
    title = "Who has progressed further at the end, crash or not: the paper's statistic"
    note = (
        "Mean and standard deviation over the ego's start policies; p: paired t-test over them, as"
        " in the paper."
    )
    yield TitledTable(title, head, rows, note)


def _findings(table: StudyTable) -> Iterator[str]:
    """Yield the results of the main table as sentences."""
    others = [arm for arm in table.arms if arm != table.base]
    for arm in sorted(others, key=lambda arm: arm != table.best):
        differences = [one for row in table.rows for one in row.differences if one.arm == arm]
        yield verdict_text(arm, table.base, [one.result for one in differences])
    gains = [row.gain.result for row in table.rows if row.gain is not None]
    if gains and table.best is not None:
        open_loop = f"{table.open_loop}, the best baseline in training"
        yield f"Gain from observing the race: {verdict_text(table.best, open_loop, gains)}"


def _caution(table: StudyTable) -> str:
    """Return a warning if a study is too small for conclusions, else an empty text."""
    races = min(arm.races for row in table.rows for arm in row.arms)
    if races >= MIN_RACES:
        return ""
    return (
        f"This is a smoke test, too small to conclude from: {races} races of an agent in a row, the"
        " paper has 4,000."
    )


def read_curves(path: str | Path) -> list[Curve]:
    """Read a trained network's training and validation loss."""
    names = ("epoch", "training_loss", "validation_loss")
    rows = read_csv(path).rows()
    epochs, *losses = (np.array([float(row[name] or "nan") for row in rows]) for name in names)
    labels = ("training", "validation")
    return [Curve(epochs, loss, label) for loss, label in zip(losses, labels, strict=True)]


def _loss_curves(study: Study) -> dict[str, list[Curve]]:
    """Return the learning curves of the networks, in the order of the configuration."""
    targets = study.config.learning.targets
    files = {name: study.network(name) / "learning_curves.csv" for name in targets}
    return {name: read_curves(file) for name, file in files.items() if file.is_file()}


def _round_robin(study: Study) -> RoundRobin:
    races = read_results(study.folder / "ratings.csv")
    return round_robin(study.config.rated, races, seed=study.config.seed)


def _watched(study: Study, cells: Sequence[StudyRaces]) -> Iterator[ExplainedRace]:
    """Yield the best agent's closest win, loss and crash of the main table."""
    best = study.config.best
    races = races_of(cells)
    ends = np.cumsum([len(cell.races) for cell in cells])
    own = races.agents.codes[:, 0] == races.agents.words.index(best)
    outcome = np.where(own, outcomes(races, 0), -1)
    for kinds in WATCHED:
        kind = next((one for one in kinds if (outcome == OUTCOMES.index(one)).any()), None)
        if kind is None:
            continue
        rows = np.flatnonzero(outcome == OUTCOMES.index(kind))
        row = int(rows[np.argmin(np.abs(races.lead[rows]))])
        gap = abs(float(races.lead[row]))
        title = f"{best}: {kind}; of {len(rows)} such races the closest, {gap:.1f} m at the end"
        place = int(np.searchsorted(ends, row, side="right"))
        race = row - int(ends[place]) + len(cells[place].races)
        yield watch_race(cells[place].pairing, race, title)


def watch_race(pairing: Pairing, race: int, title: str) -> ExplainedRace:
    """Repeat a race for the report; the pairing's ego makes moves."""
    explanation = explain_race(pairing, race)
    picture = b""
    if find_spec("matplotlib") is not None:
        from pcs_racing_agents.base.style import picture_bytes
        from pcs_racing_agents.watch.pictures import explanation_picture

        picture = picture_bytes(explanation_picture(explanation))
    return ExplainedRace(title, story(explanation), explanation.replay, picture)


def software() -> dict[str, str]:
    """Return the versions of the libraries that the results depend on, and the machine."""
    versions = {"pcs-racing": package_version(), "Python": platform.python_version()}
    for library in ("numpy", "numba", "torch", "cma", "moocore", "scipy", "matplotlib"):
        try:
            versions[library] = version(library)
        except PackageNotFoundError:
            continue
    return {**versions, "machine": f"{platform.system()} {platform.machine()}"}
