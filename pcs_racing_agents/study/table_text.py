"""The table of a study as plain text, Markdown and CSV."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcs_racing_agents.base.tables import aligned, interval_text, markdown, with_interval, write_csv
from pcs_racing_agents.study.table import Difference, StudyTable, TableRow
from pcs_racing_agents.tournament.statistics import Comparison

DETAILS = (
    "agent",
    "score",
    "sd",
    "crash",
    "own fault",
    "difference",
    "95 % interval",
    "p",
    "p (Holm)",
    "paired t",
)
"""Columns of :func:`detail_rows`."""


def p_text(p: float) -> str:
    """Return a p-value with two significant digits."""
    if np.isnan(p):
        return "-"
    return f"{p:.3f}" if p >= 0.01 else f"{p:.1e}" if p >= 1e-99 else "< 1e-99"


def difference_text(difference: Difference) -> str:
    """Return a difference with its interval."""
    result = difference.result
    return with_interval(result.difference, result.low, result.high)


def paper_text(row: TableRow) -> str:
    """Return the paper's figures for a row; empty without figures."""
    if row.paper is None:
        return ""
    paper = row.paper
    return (
        f"{paper.non_gt:.3f} ± {paper.non_gt_sd:.3f} non-GT, {paper.gt:.3f} ± {paper.gt_sd:.3f} GT,"
        f" difference {paper.difference:+.3f}, p {paper.p:.3g}"
    )


def overview_rows(
    table: StudyTable, show: Callable[[Difference], str] = difference_text
) -> list[tuple[str, ...]]:
    """Return the short table, head first: one line per row, one column per difference."""
    others = [arm for arm in table.arms if arm != table.base]
    gain = (
        []
        if table.best is None or table.open_loop is None
        else [f"{table.best} - {table.open_loop}"]
    )
    papers = any(row.paper is not None for row in table.rows)
    paper_column = ["paper: GT"] if papers else []
    lines: list[tuple[str, ...]] = [
        ("circuit", "opponent", *paper_column, table.base, *others, *gain)
    ]
    for row in table.rows:
        cells = {difference.arm: show(difference) for difference in row.differences}
        lines.append(
            (
                f"{row.track} ({'seen' if row.seen else 'unseen'})",
                row.opponent,
                *(["" if row.paper is None else f"{row.paper.difference:+.3f}"] if papers else []),
                f"{row.arms[0].score:.3f}",
                *(cells.get(arm, "") for arm in others),
                *(["" if row.gain is None else show(row.gain)] if gain else []),
            )
        )
    return lines


def paper_rows(table: StudyTable, arm: str) -> list[tuple[str, ...]]:
    """Return the rows of the paper's table, with the paper's columns and figures, head first."""
    lines: list[tuple[str, ...]] = [
        (
            "circuit",
            "opponent",
            table.base,
            arm,
            "difference",
            "p",
            "paper: non-GT",
            "GT",
            "difference",
            "p",
        )
    ]
    for row in table.rows:
        own = next(
            (difference.result for difference in row.differences if difference.arm == arm), None
        )
        if row.paper is not None and own is not None:
            scores = {result.arm: f"{result.score:.3f} ± {result.sd:.3f}" for result in row.arms}
            theirs = (
                f"{row.paper.non_gt:.3f} ± {row.paper.non_gt_sd:.3f}",
                f"{row.paper.gt:.3f} ± {row.paper.gt_sd:.3f}",
            )
            compared = (
                f"{own.difference:+.3f}",
                p_text(own.p_paired_t),
                *theirs,
                f"{row.paper.difference:+.3f}",
            )
            lines.append(
                (
                    row.track,
                    row.opponent,
                    scores[table.base],
                    scores[arm],
                    *compared,
                    p_text(row.paper.p),
                )
            )
    return lines


def detail_rows(row: TableRow) -> Iterator[tuple[str, ...]]:
    """Yield the lines of a row in the columns :data:`DETAILS`: agents, then the adaptivity gain."""
    differences = {difference.arm: difference for difference in row.differences}
    for arm in row.arms:
        shares = (f"{arm.score:.3f}", f"{arm.sd:.3f}", f"{arm.crash:.1%}", f"{arm.own_crash:.1%}")
        yield (
            arm.arm,
            *shares,
            *(_columns(differences[arm.arm]) if arm.arm in differences else ("",) * 5),
        )
    if row.gain is not None:
        yield f"{row.gain.arm} minus {row.gain.base}", *("",) * 4, *_columns(row.gain)


def notes(table: StudyTable) -> list[str]:
    """Return explanations of the columns, as sentences."""
    races = sorted({arm.races for row in table.rows for arm in row.arms})
    count = f"{races[0]}" if len(races) == 1 else f"{races[0]} to {races[-1]}"
    # Rows may differ here: then the weaker claim holds for all rows.
    lines_drawn = {row.lines_drawn for row in table.rows}
    kinds = "egos, opponents and start lines" if lines_drawn == {True} else "egos and opponents"
    sentences = [
        (
            f"Each agent drove {count} races in each row, the same ones as the other agents of the"
            " row. Score: races won, a tie counting half. Sd: standard deviation over the ego's"
            " start policies. Own fault: crashes that the agent is also to blame for."
        ),
        (
            f"Differences are from {table.base}, with a 95 % interval and a p-value that are robust"
            f" to clusters of {kinds}. Holm: the p-value adjusted over the rows. Paired t: the"
            " paper's test over the ego's start policies, which takes the opponents as given."
        ),
    ]
    if lines_drawn != {True}:
        sentences.append(
            "Where the intervals leave out the start lines, each pair had its own, or there were"
            " too few to say how much they matter: then the result is about these lines."
        )
    if table.best is not None and table.open_loop is not None:
        sentences.append(
            f"Adaptivity gain: {table.best} minus {table.open_loop}, the best of the baselines,"
            " whose moves depend on nothing of the race but, of best-lead-plan, who leads; it was"
            " chosen on training races."
        )
    return sentences


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
        blocks.append(
            f"### {row.name}{paper}\n\n" + "\n".join(markdown([DETAILS, *detail_rows(row)]))
        )
    return "\n\n".join([*blocks, *notes(table)]) + "\n"


CSV_COLUMNS = (
    "kind",
    "track",
    "seen",
    "opponent",
    "arm",
    "base",
    "races",
    "egos",
    "opponents",
    "lines",
    "score",
    "score_base",
    "score_sd",
    "crash",
    "own_crash",
    "difference",
    "low",
    "high",
    "p",
    "p_holm",
    "two_way_low",
    "two_way_high",
    "two_way_p",
    "paired_t_p",
    "cohen_d",
    "paper_non_gt",
    "paper_gt",
    "paper_difference",
    "paper_p",
)


def write_table(table: StudyTable, path: str | os.PathLike[str]) -> Path:
    """Write one line per comparison as CSV; the same table gives the same bytes.

    The kind of a comparison is ``difference`` (from the base) or ``adaptivity gain``.
    """
    lines: list[Sequence[object]] = [CSV_COLUMNS]
    for row in table.rows:
        lines += [_csv_row("difference", row, difference) for difference in row.differences]
        if row.gain is not None:
            lines.append(_csv_row("adaptivity gain", row, row.gain))
    return write_csv(lines, path)


def _csv_row(kind: str, row: TableRow, difference: Difference) -> list[object]:
    # Six digits: further digits depend on the processor, and files are compared byte by byte.
    arm = next(arm for arm in row.arms if arm.arm == difference.arm)
    result, two_way, paper = difference.result, difference.two_way, row.paper
    numbers = (
        result.mean_a,
        result.mean_b,
        arm.sd,
        arm.crash,
        arm.own_crash,
        result.difference,
        result.low,
        result.high,
        result.p_clustered,
        difference.p_holm,
        two_way.low,
        two_way.high,
        two_way.p_clustered,
        result.p_paired_t,
        result.cohen_d,
    )
    paper_cells = (
        ("",) * 4 if paper is None else (paper.non_gt, paper.gt, paper.difference, paper.p)
    )
    counts = (result.units, result.egos, result.opponents, row.lines)
    names = (kind, row.track, int(row.seen), row.opponent, difference.arm, difference.base)
    return [*names, *counts, *(f"{value:.6g}" for value in numbers), *paper_cells]


def _starred(difference: Difference) -> str:
    return f"{difference.result.difference:+.3f}{'*' if difference.p_holm < 0.05 else ' '}"


def _columns(difference: Difference) -> tuple[str, ...]:
    result = difference.result
    interval = interval_text(result.low, result.high)
    p_values = (p_text(result.p_clustered), p_text(difference.p_holm), p_text(result.p_paired_t))
    return (f"{result.difference:+.3f}", interval, *p_values)


def verdict_text(arm: str, base: str, results: Sequence[Comparison]) -> str:
    """Return one sentence that compares two arms over the rows of a table.

    ``results``: one difference per row, at least one.
    """
    more, less = (
        sum(result.low > 0.0 for result in results),
        sum(result.high < 0.0 for result in results),
    )
    smallest, largest = (pick(result.difference for result in results) for pick in (min, max))
    spread = f"{smallest:+.3f}" if len(results) == 1 else f"{smallest:+.3f} to {largest:+.3f}"
    rows = f"{len(results)} row{'s' * (len(results) != 1)}"
    if not more and not less:
        return (
            f"{arm} and {base} can't be told apart: in all of {rows} ({spread}) the 95 % interval"
            " contains 0."
        )
    verdicts = [f"{word} in {count}" for word, count in (("more", more), ("less", less)) if count]
    open_rows = len(results) - more - less
    rest = f"; in {open_rows} the 95 % interval contains 0" if open_rows else ""
    return f"{arm} scores {' and '.join(verdicts)} of {rows} than {base} ({spread}){rest}."
