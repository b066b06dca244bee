"""The table of a study as plain text, Markdown and CSV."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcs_racing_agents.base.statistics import Comparison
from pcs_racing_agents.base.tables import aligned, interval_text, with_interval, write_csv
from pcs_racing_agents.study.table import GAIN, Difference, StudyTable, TableRow

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
    non_gt, gt = _plus_minus(paper.non_gt, paper.non_gt_sd), _plus_minus(paper.gt, paper.gt_sd)
    return f"{non_gt} non-GT, {gt} GT, difference {paper.difference:+.3f}, p {paper.p:.3g}"


def overview_rows(
    table: StudyTable, show: Callable[[Difference], str] = difference_text
) -> list[tuple[str, ...]]:
    """Return the short table, head first: one line per row, one column per difference."""
    columns = {arm: arm for arm in table.arms if arm != table.base}
    if table.best is not None and table.open_loop is not None:
        columns[GAIN] = f"{table.best} - {table.open_loop}"
    papers = any(row.paper is not None for row in table.rows)
    head = ("circuit", "opponent", *(["paper: GT"] if papers else []), table.base)
    lines: list[tuple[str, ...]] = [(*head, *columns.values())]
    for row in table.rows:
        cells = {arm: show(difference) for arm, difference in row.questions}
        paper = "" if row.paper is None else f"{row.paper.difference:+.3f}"
        lines.append(
            (
                f"{row.track} ({'train' if row.train else 'test'})",
                row.opponent,
                *([paper] if papers else []),
                f"{row.arms[0].score:.3f}",
                *(cells.get(arm, "") for arm in columns),
            )
        )
    return lines


def paper_rows(table: StudyTable, arm: str) -> list[tuple[str, ...]]:
    """Return the rows of the paper's table, with the paper's columns and figures, head first."""
    head = ("circuit", "opponent", table.base, arm, "difference", "p")
    lines: list[tuple[str, ...]] = [(*head, "paper: non-GT", "GT", "difference", "p")]
    for row in table.rows:
        paper, differences = row.paper, dict(row.questions)
        if paper is not None and arm in differences:
            own = differences[arm].result
            scores = {result.arm: _plus_minus(result.score, result.sd) for result in row.arms}
            ours = (scores[table.base], scores[arm], f"{own.difference:+.3f}")
            theirs = (
                _plus_minus(paper.non_gt, paper.non_gt_sd),
                _plus_minus(paper.gt, paper.gt_sd),
                f"{paper.difference:+.3f}",
                p_text(paper.p),
            )
            lines.append((row.track, row.opponent, *ours, p_text(own.p_paired_t), *theirs))
    return lines


def _plus_minus(mean: float, sd: float) -> str:
    return f"{mean:.3f} ± {sd:.3f}"


def detail_rows(row: TableRow) -> Iterator[tuple[str, ...]]:
    """Yield the lines of a row in the columns :data:`DETAILS`: agents, then the adaptivity gain."""
    differences = dict(row.questions)
    for arm in row.arms:
        shares = (f"{arm.score:.3f}", f"{arm.sd:.3f}", f"{arm.crash:.1%}", f"{arm.own_crash:.1%}")
        compared = _columns(differences[arm.arm]) if arm.arm in differences else ("",) * 5
        yield (arm.arm, *shares, *compared)
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


CSV_COLUMNS = (
    "kind",
    "track",
    "train",
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
        for arm, difference in row.questions:
            lines.append(_csv_row(GAIN if arm == GAIN else "difference", row, difference))
    return write_csv(lines, path)


def _csv_row(kind: str, row: TableRow, difference: Difference) -> list[object]:
    # Six digits: further digits depend on the processor, and files are compared byte by byte.
    arm = next(arm for arm in row.arms if arm.arm == difference.arm)
    result, paper = difference.result, row.paper
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
        result.p_paired_t,
        result.cohen_d,
    )
    paper_cells = (
        ("",) * 4 if paper is None else (paper.non_gt, paper.gt, paper.difference, paper.p)
    )
    counts = (result.units, result.egos, result.opponents, row.lines)
    names = (kind, row.track, int(row.train), row.opponent, difference.arm, difference.base)
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
    more = sum(result.low > 0.0 for result in results)
    less = sum(result.high < 0.0 for result in results)
    differences = sorted(result.difference for result in results)
    ends = [differences[0], differences[-1]] if len(results) > 1 else differences
    spread = " to ".join(f"{end:+.3f}" for end in ends)
    rows = f"{len(results)} row{'s' * (len(results) != 1)}"
    if not more and not less:
        return (
            f"no difference between {arm} and {base} is certain: in all of {rows} ({spread})"
            " the 95 % interval contains 0."
        )
    verdicts = [f"{word} in {count}" for word, count in (("more", more), ("less", less)) if count]
    open_rows = len(results) - more - less
    rest = f"; in {open_rows} the 95 % interval contains 0" if open_rows else ""
    return f"{arm} scores {' and '.join(verdicts)} of {rows} than {base} ({spread}){rest}."
