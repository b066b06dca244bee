"""The last stage: race results line by line, tables, and one page of findings."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.blind import load_fit
from pcs_racing_agents.base.statistics import Comparison
from pcs_racing_agents.base.tables import table_rows
from pcs_racing_agents.study.config import BASELINES
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.study.table import (
    COLUMNS,
    GAIN,
    TableLine,
    by_progress,
    make_table,
    notes,
    overview_rows,
    table_text,
    write_table,
)
from pcs_racing_agents.tournament import RaceTable, closeness_text, write_results
from pcs_racing_agents.watch.pages import rendered

MIN_RACES = 1000  # per agent and row; below it is a smoke test; paper: 4,000


class TitledTable(NamedTuple):
    """A table of a report."""

    title: str
    rows: Sequence[Sequence[str]]  #: Rows, head first; numbers align right.
    note: str = ""


def report_page(
    title: str,
    *,
    facts: str = "",
    about: str = "",
    findings: Sequence[str] = (),
    caution: str = "",
    tables: Sequence[TitledTable] = (),
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return a report as HTML from the template ``report.html``; all text is escaped.

    Parameters
    ----------
    facts : str
        Number and kind of the races, in a line.
    about : str
        Subject of the study, in paragraphs.
    findings : sequence of str
        Results, one sentence each; the first is the headline.
    caution : str
        Reason to distrust the results.
    """
    return rendered(
        "pcs_racing_agents.study",
        "report.html",
        {"plain": _plain},
        title=title,
        result=findings[0] if findings else "",
        facts=facts,
        about=about,
        findings=findings[1:],
        caution=caution,
        tables=tables,
        settings=settings,
    )


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_plain(one)}" for name, one in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def write_report(study: Study, races: RaceTable) -> None:
    """Write the races, the tables and the report of a study.

    The files are ``results.csv``, ``table.csv``, ``table.txt``, ``report.html``, with a second
    table ``table_further.csv``, and under the paper's rules ``table_by_progress.csv``.
    """
    folder, config = study.folder, study.config
    main_races = races.with_seeds(study.table_seeds(0))
    main = study_table(study, main_races)
    tables = [
        TitledTable("Results", overview_rows(main), notes(main)),
        TitledTable("All columns", table_rows(COLUMNS, main)),
    ]
    write_results(races, folder / "results.csv")
    write_table(main, folder / "table.csv")
    write_atomically(folder / "table.txt", table_text(main))
    if config.further is not None:
        further = study_table(study, races.with_seeds(study.table_seeds(1)))
        write_table(further, folder / "table_further.csv")
        tables.append(TitledTable("More opponents, tracks and agents", overview_rows(further)))
    if config.rules.name == "paper":
        ahead = study_table(study, by_progress(main_races))
        write_table(ahead, folder / "table_by_progress.csv")
        title = "The paper's statistic: the car with more progress wins, crash or not"
        tables.append(TitledTable(title, table_rows(COLUMNS, ahead)))
    rules, archive = config.rules, study.archive
    page = report_page(
        f"Study: {rules.name} rules, archive {archive.name}",
        facts=f"{len(races):,} races of {rules.ends[-1]:g} s between two cars.",
        about=(
            f"Every {rules.step_seconds:g} s an agent may change its policy, which is how its"
            f" car drives, by {rules.epsilon} of the archive's range on an axis. Archive"
            f" {archive.name}: {len(archive)} policies of planner {archive.planner}, sha256"
            f" {archive.content_hash[:16]}.\n\n{closeness_text(races)}"
        ),
        findings=list(findings(main, config.best)),
        caution=caution(main),
        tables=tables,
        settings=plain_settings(config),
    )
    write_atomically(folder / "report.html", page)


def study_table(study: Study, races: RaceTable) -> list[TableLine]:
    """Compare the agents of one of the study's tables."""
    config, open_loop = study.config, best_baseline(study)
    return make_table(
        races,
        best=config.best,
        # The second table may lack the baselines of the first.
        open_loop=open_loop if open_loop in races.agents.words else None,
        train={load_track(name).name for name in config.learning.tracks},
        paper=config.rules.name == "paper",
        rules=config.rules,
    )


def best_baseline(study: Study) -> str | None:
    """Return the baseline with the max number of training wins; None if one is not in the table.

    On the training races the sequence is at least as good as any constant move, and the plan as any
    fixed policy, since their searches begin with the best constant move and the best fixed policy.
    """
    # A subset of them would pass the best of the subset off as the best baseline.
    if not set(BASELINES) <= set(study.config.table.agents):
        return None
    reached = {name: float(load_fit(study.fit(name)).training["reached"]) for name in BASELINES}
    return max(BASELINES, key=reached.__getitem__)  # the first one in case of a tie


def findings(lines: Sequence[TableLine], best: str) -> Iterator[str]:
    """Yield the results of a table as sentences, those about the best agent first."""
    compared: dict[tuple[str, str, str], list[Comparison]] = {}
    for line in lines:
        if line.kind != "score":
            compared.setdefault((line.arm, line.base, line.kind), []).append(line.result)
    for (arm, base, kind), own in sorted(compared.items(), key=lambda item: item[0][0] != best):
        more, less = sum(one.low > 0.0 for one in own), sum(one.high < 0.0 for one in own)
        ends = min(one.difference for one in own), max(one.difference for one in own)
        end = ", the best baseline in training" if kind == GAIN else ""
        yield (
            f"{arm} scores more in {more} and less in {less} of {len(own)} rows than {base}{end}"
            f" ({ends[0]:+.3f} to {ends[1]:+.3f}); in {len(own) - more - less} the 95 % interval"
            " contains 0."
        )


def caution(lines: Sequence[TableLine]) -> str:
    """Return a warning if a study is too small for conclusions, else an empty text."""
    races = min(line.result.units for line in lines)
    if races >= MIN_RACES:
        return ""
    return (
        f"This is a smoke test, too small to conclude from: {races} races of an agent in a row, the"
        " paper has 4,000."
    )
