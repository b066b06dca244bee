"""The last stage: race results line by line, tables, and one self-contained page."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.race.replay import Replay
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.blind import load_fit
from pcs_racing_agents.base.statistics import Comparison
from pcs_racing_agents.base.style import (
    COLOURS,
    INK,
    SOFT,
    new_figure,
    picture,
    picture_bytes,
    short,
    tidy,
)
from pcs_racing_agents.base.tables import table_rows
from pcs_racing_agents.policies.picture import archive_picture
from pcs_racing_agents.study.config import BASELINES
from pcs_racing_agents.study.study import Study, study_pairing
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
from pcs_racing_agents.watch.explain import explain_race
from pcs_racing_agents.watch.pages import rendered
from pcs_racing_agents.watch.pictures import explanation_picture
from pcs_racing_agents.watch.race_choice import OUTCOMES, outcomes
from pcs_racing_agents.watch.words import story

MIN_RACES = 1000  # per agent and row; below it is a smoke test; paper: 4,000
WATCHED = ("a win by switching", "a win with switches", "a loss", "a crash of its own")
"""Outcomes of the report's example races."""


class TitledTable(NamedTuple):
    """A table of a report."""

    title: str
    rows: Sequence[Sequence[str]]  #: Rows, head first; numbers align right.
    note: str = ""


class ExplainedRace(NamedTuple):
    """A race of a report."""

    title: str
    text: str  #: Explanation; may be empty.
    replay: Replay
    picture: bytes = b""  #: Observations and moves as an SVG picture; may be empty.


def report_page(
    title: str,
    *,
    facts: str = "",
    about: str = "",
    findings: Sequence[str] = (),
    caution: str = "",
    tables: Sequence[TitledTable] = (),
    races: Sequence[ExplainedRace] = (),
    pictures: Mapping[str, bytes] = MappingProxyType({}),
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
    pictures : mapping
        SVG pictures by caption.
    """
    return rendered(
        "pcs_racing_agents.study",
        "report.html",
        {"data": _data_url, "plain": _plain},
        title=title,
        result=findings[0] if findings else "",
        facts=facts,
        about=about,
        findings=findings[1:],
        caution=caution,
        tables=tables,
        races=races,
        pictures=pictures,
        settings=settings,
    )


def _data_url(svg: bytes) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"


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
        races=list(watched_races(study, main_races)),
        pictures=_pictures(study, main),
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


def watched_races(study: Study, races: RaceTable) -> Iterator[ExplainedRace]:
    """Yield the best agent's closest win, loss and crash of the main table."""
    best = study.config.best
    own = races.agents.codes[:, 0] == races.agents.words.index(best)
    outcome = np.where(own, outcomes(races, 0), -1)
    for kind in WATCHED:
        rows = np.flatnonzero(outcome == OUTCOMES.index(kind))
        if len(rows):
            row = races[int(rows[np.argmin(np.abs(races.lead[rows]))])]
            explanation = explain_race(study_pairing(study, races, row), row.race)
            title = f"{best}: {kind}; of {len(rows)} such races the closest, {abs(row.lead):.1f} m"
            svg = picture_bytes(explanation_picture(explanation)) if _can_draw() else b""
            yield ExplainedRace(title, story(explanation), explanation.replay, svg)


def _can_draw() -> bool:
    return find_spec("matplotlib") is not None


def _pictures(study: Study, lines: Sequence[TableLine]) -> dict[str, bytes]:
    """Return the pictures of a report as SVG by caption; none without matplotlib."""
    if not _can_draw():
        return {}
    figures = {
        f"Gain of each agent over {lines[0].arm}.": differences_picture(lines),
        "Policies, and the moves of one of them.": archive_picture(
            study.archive, epsilon=study.config.rules.epsilon
        ),
    }
    return {caption: picture_bytes(figure) for caption, figure in figures.items()}


@picture
def differences_picture(lines: Sequence[TableLine]) -> Any:
    """Draw the differences of each row in a panel, with their intervals."""
    panels: dict[str, list[TableLine]] = {}
    for line in lines:
        if line.kind != "score":
            panels.setdefault(f"{short(line.circuit, 20)}, {short(line.opponent, 16)}", []).append(
                line
            )
    # All panels share the names of the whole table: an agent missing from a row leaves a gap.
    names = list(dict.fromkeys(line.name for own in panels.values() for line in own))
    columns = max(1, min(3, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    figure = new_figure(2.0 + 2.3 * columns, 0.7 + (0.55 + 0.21 * len(names)) * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    for axes, (title, own) in zip(grid, panels.items(), strict=False):
        axes.set_title(title, fontsize=8.5)
        axes.axvline(0.0, color=INK, lw=0.8)
        for line in own:
            colour, height = COLOURS[line.kind == GAIN], -names.index(line.name)
            fill = colour if line.p_holm < 0.05 else "white"
            axes.plot([line.result.low, line.result.high], [height] * 2, color=colour, lw=2.0)
            axes.plot(
                line.result.difference, height, "o", ms=6, mec=colour, mew=1.4, mfc=fill, zorder=3
            )
        axes.set_yticks([-i for i in range(len(names))], [short(name) for name in names])
        axes.set_ylim(-len(names) + 0.4, 0.6)
        axes.locator_params(axis="x", nbins=5)
        tidy(axes, "x")
    label = f"difference of score from {short(lines[0].arm)}, 95 % intervals"
    figure.supxlabel(f"{label}; hollow: p (Holm) not below 0.05", fontsize=8.5, color=SOFT)
    return figure
