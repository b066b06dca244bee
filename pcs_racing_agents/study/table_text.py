"""The table of a study for people (plain text, Markdown) and for programs (CSV)."""

import csv
import io
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing_agents.results.text_table import aligned, markdown
from pcs_racing_agents.study.table import Difference, StudyTable, TableRow

__all__ = [
    "DETAILS",
    "detail_rows",
    "difference_text",
    "notes",
    "overview_rows",
    "p_text",
    "paper_text",
    "table_markdown",
    "table_text",
    "write_table",
]

DETAILS = ("agent", "score", "sd", "crash", "own fault", "difference", "95 % interval", "p", "p (Holm)", "paired t")
"""Columns of :func:`detail_rows`."""


def p_text(p: float) -> str:
    """Return a p-value with two digits that count."""
    if np.isnan(p):
        return "-"
    return f"{p:.3f}" if p >= 0.01 else f"{p:.1e}" if p >= 1e-99 else "< 1e-99"


def difference_text(found: Difference) -> str:
    """Return a difference with its interval."""
    return f"{found.result.difference:+.3f} [{found.result.low:+.3f}, {found.result.high:+.3f}]"


def paper_text(row: TableRow) -> str:
    """Return what the paper says about a row; empty where it says nothing."""
    if row.paper is None:
        return ""
    paper = row.paper
    return (
        f"{paper.non_gt:.3f} ± {paper.non_gt_sd:.3f} non-GT, {paper.gt:.3f} ± {paper.gt_sd:.3f} GT, "
        f"difference {paper.difference:+.3f}, p {paper.p:.3g}"
    )


def overview_rows(table: StudyTable, show: Callable[[Difference], str] = difference_text) -> list[tuple[str, ...]]:
    """Return the short table, its head first: a line for each row, a column for each agent's difference."""
    others = [arm for arm in table.arms if arm != table.base]
    gain = [] if table.best is None or table.blind is None else [f"{table.best} - {table.blind}"]
    papers = any(row.paper is not None for row in table.rows)
    told = ["paper: GT"] if papers else []
    lines: list[tuple[str, ...]] = [("circuit", "opponent", *told, table.base, *others, *gain)]
    for row in table.rows:
        found = {one.arm: show(one) for one in row.differences}
        lines.append(
            (
                f"{row.track} ({'seen' if row.seen else 'unseen'})",
                row.opponent,
                *(["" if row.paper is None else f"{row.paper.difference:+.3f}"] if papers else []),
                f"{row.arms[0].score:.3f}",
                *(found.get(arm, "") for arm in others),
                *(["" if row.gain is None else show(row.gain)] if gain else []),
            )
        )
    return lines


def detail_rows(row: TableRow) -> Iterator[tuple[str, ...]]:
    """Return the lines of one row in the columns :data:`DETAILS`: one for each agent, then the adaptivity gain."""
    found = {one.arm: one for one in row.differences}
    for arm in row.arms:
        shares = (f"{arm.score:.3f}", f"{arm.sd:.3f}", f"{arm.crash:.1%}", f"{arm.own_crash:.1%}")
        yield arm.arm, *shares, *(_columns(found[arm.arm]) if arm.arm in found else ("",) * 5)
    if row.gain is not None:
        yield f"{row.gain.arm} minus {row.gain.base}", *("",) * 4, *_columns(row.gain)


def notes(table: StudyTable) -> list[str]:
    """Return the sentences that say what the columns are."""
    races = sorted({arm.races for row in table.rows for arm in row.arms})
    some = f"{races[0]}" if len(races) == 1 else f"{races[0]} to {races[-1]}"
    known = {row.lines_drawn for row in table.rows}
    kinds = "egos, opponents and start lines" if known == {True} else "egos and opponents"
    found = [
        f"Each agent drove {some} races in each row, the same ones as the other agents of the row. Score: races won, a "
        "tie counting half. Sd: standard deviation over the ego's start policies. Own fault: crashes that the agent is "
        "also to blame for.",
        f"Differences are from {table.base}, with a 95 % interval and a p-value that are robust to "
        f"clusters of {kinds}. Holm: the p-value adjusted over the rows. Paired t: the paper's test over the ego's "
        "start policies, which takes the opponents as given.",
    ]
    if known != {True}:
        found.append(
            "Where the intervals leave out the start lines, each pair had its own, or there were too few to say how "
            "much they matter: then the result is about these lines."
        )
    if table.best is not None and table.blind is not None:
        found.append(
            f"Adaptivity gain: {table.best} minus {table.blind}, the best of the agents that never look at the race; "
            "that one was chosen on training races."
        )
    return found


def table_text(table: StudyTable) -> str:
    """Return the table as plain text."""
    short = aligned(overview_rows(table, _starred))
    blocks = ["\n".join([*short, "*: p (Holm) below 0.05"])]
    for row in table.rows:
        paper = f"\npaper: {paper_text(row)}" if row.paper is not None else ""
        blocks.append("\n".join([f"{row.name}{paper}", *aligned([DETAILS, *detail_rows(row)])]))
    return "\n\n".join([*blocks, "\n".join(notes(table))]) + "\n"


def table_markdown(table: StudyTable) -> str:
    """Return the table in Markdown."""
    blocks = ["\n".join(markdown(overview_rows(table)))]
    for row in table.rows:
        paper = f"\n\nPaper: {paper_text(row)}." if row.paper is not None else ""
        blocks.append(f"### {row.name}{paper}\n\n" + "\n".join(markdown([DETAILS, *detail_rows(row)])))
    return "\n\n".join([*blocks, *notes(table)]) + "\n"


CSV_COLUMNS = (
    "kind", "track", "seen", "opponent", "arm", "base", "races", "egos", "opponents", "lines", "score", "score_base",
    "score_sd", "crash", "own_crash", "difference", "low", "high", "p", "p_holm", "two_way_low", "two_way_high",
    "two_way_p", "paired_t_p", "cohen_d", "paper_non_gt", "paper_gt", "paper_difference", "paper_p",
)  # fmt: skip


def write_table(table: StudyTable, path: str | os.PathLike[str]) -> Path:
    """Write one line for each comparison as CSV; the same table gives the same bytes.

    The kind of a comparison is ``difference`` (from the base) or ``adaptivity gain``.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row in table.rows:
        for one in row.differences:
            writer.writerow(_csv_row("difference", row, one))
        if row.gain is not None:
            writer.writerow(_csv_row("adaptivity gain", row, row.gain))
    write_atomically(Path(path), lambda file: file.write(text.getvalue().encode("utf-8")))
    return Path(path)


def _csv_row(kind: str, row: TableRow, one: Difference) -> list[object]:
    arm = next(arm for arm in row.arms if arm.arm == one.arm)
    result, two_way, paper = one.result, one.two_way, row.paper
    numbers = (
        result.mean_a, result.mean_b, arm.sd, arm.crash, arm.own_crash, result.difference, result.low, result.high,
        result.p_clustered, one.p_holm, two_way.low, two_way.high, two_way.p_clustered, result.p_paired_t,
        result.cohen_d,
    )  # fmt: skip
    told = ("",) * 4 if paper is None else (paper.non_gt, paper.gt, paper.difference, paper.p)
    counts = (result.units, result.egos, result.opponents, row.lines)
    names = (kind, row.track, int(row.seen), row.opponent, one.arm, one.base)
    return [*names, *counts, *(f"{value:.6g}" for value in numbers), *told]


def _starred(one: Difference) -> str:
    return f"{one.result.difference:+.3f}{'*' if one.p_holm < 0.05 else ' '}"


def _columns(one: Difference) -> tuple[str, ...]:
    result = one.result
    interval = f"[{result.low:+.3f}, {result.high:+.3f}]"
    p_values = (p_text(result.p_clustered), p_text(one.p_holm), p_text(result.p_paired_t))
    return (f"{result.difference:+.3f}", interval, *p_values)
