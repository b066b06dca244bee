"""The report of a study: one page that holds everything, tables, pictures and races to watch, and loads nothing."""

import html
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.files import write_atomically
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.race.replay import replay_page
from pcs_racing_agents.explain.situations import Situations, situations_text
from pcs_racing_agents.pictures.curves import Curve
from pcs_racing_agents.study.highlights import Watched
from pcs_racing_agents.study.markup import drawn, facts, image, overview, table_of
from pcs_racing_agents.study.report_inputs import TreeLoss, mean_losses, mean_scores, places_of
from pcs_racing_agents.study.table import StudyTable, TableRow
from pcs_racing_agents.study.table_text import DETAILS, detail_rows, notes, p_text, paper_text
from pcs_racing_agents.tournament.round_robin import RoundRobin

__all__ = ["Picture", "ReportContent", "Sheet", "report_page", "write_page"]


class Sheet(NamedTuple):
    """A table of any kind.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of str
        As many cells as the head; what begins like a number stands to the right.
    note : str
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


class Picture(NamedTuple):
    """A picture that was drawn elsewhere.

    Attributes
    ----------
    title : str
    caption : str
    content : bytes
        SVG or PNG.
    """

    title: str
    caption: str
    content: bytes


@dataclass(frozen=True, eq=False)
class ReportContent:
    """What a report tells; whatever is left out is not in it.

    Attributes
    ----------
    title : str
    about : str
        What was studied, in a few sentences.
    findings : sequence of str
        What came out, a sentence each.
    table : StudyTable, optional
    archive : PolicyArchive, optional
        Drawn with the moves of one policy, of length ``epsilon``.
    epsilon : float or tuple of float
    curves : mapping of str to sequence of Curve
        Loss by epoch of every network, by its name.
    reward_curves : mapping of str to sequence of Curve
        What agents of reinforcement learning reached by step (in millions): a panel for each figure.
    losses : sequence of TreeLoss
        What agents lose on trees that no network has seen.
    loss_unit : str
        What that is counted in.
    judged : StudyTable, optional
        The table whose scores stand beside what the agents lose on trees; by default ``table``.
    rivals : RoundRobin, optional
        Races of all against all.
    situations : sequence of Situations
        Which move in which situation, agent by agent.
    ablations : sequence of Sheet
    sheets : sequence of Sheet
        Other tables.
    pictures : sequence of Picture
        Other pictures.
    races : sequence of Watched
    settings, versions, seeds : mapping
    seconds : mapping of str to float
        How long each stage took, s.
    """

    title: str
    about: str = ""
    findings: Sequence[str] = ()
    table: StudyTable | None = None
    archive: PolicyArchive | None = None
    epsilon: float | tuple[float, ...] = 0.5
    curves: Mapping[str, Sequence[Curve]] = field(default_factory=dict)
    reward_curves: Mapping[str, Sequence[Curve]] = field(default_factory=dict)
    losses: Sequence[TreeLoss] = ()
    loss_unit: str = "utility"
    judged: StudyTable | None = None
    rivals: RoundRobin | None = None
    situations: Sequence[Situations] = ()
    ablations: Sequence[Sheet] = ()
    sheets: Sequence[Sheet] = ()
    pictures: Sequence[Picture] = ()
    races: Sequence[Watched] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)
    seeds: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)


def write_page(content: ReportContent, path: str | os.PathLike[str]) -> Path:
    """Write the report; the file appears whole or not at all. Without matplotlib it has no pictures of its own.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    page = report_page(content)
    write_atomically(Path(path), lambda file: file.write(page.encode("utf-8")))
    return Path(path)


def report_page(content: ReportContent) -> str:
    """Return the report as HTML."""
    sections: list[tuple[str, str]] = []
    for title, make in _SECTIONS:
        body = "\n".join(make(content))
        if body:
            sections.append((title, body))
    contents = "\n".join(f'<a href="#{_anchor(title)}">{html.escape(title)}</a>' for title, _ in sections)
    about = "".join(f"<p>{html.escape(text)}</p>" for text in content.about.split("\n\n") if text)
    body = about + "\n".join(
        f'<section id="{_anchor(title)}">\n<h2>{html.escape(title)}</h2>\n{body}\n</section>'
        for title, body in sections
    )
    template = files("pcs_racing_agents.study").joinpath("report.html").read_text(encoding="utf-8")
    parts = {"<!--title-->": html.escape(content.title), "<!--contents-->": contents, "<!--body-->": body}
    # In one pass: a text that spells a placeholder is not one.
    return re.sub("|".join(parts), lambda match: parts[match.group()], template)


# The sections


def _findings(content: ReportContent) -> Iterator[str]:
    if content.findings:
        yield "<ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in content.findings) + "</ul>"


def _results(content: ReportContent) -> Iterator[str]:
    table = content.table
    if table is None:
        return
    yield overview(table)
    for text in notes(table):
        yield f'<p class="note">{html.escape(text)}</p>'
    yield from drawn("scores_picture", "Scores of all agents against each kind of opponent on each circuit.", table)
    yield from drawn("differences_picture", f"What each agent gains over {table.base}.", table)
    yield "<h3>All columns, row by row</h3>"
    for row in table.rows:
        paper = f' <span class="soft">paper: {html.escape(paper_text(row))}</span>' if row.paper is not None else ""
        yield f"<details><summary>{html.escape(row.name)}{paper}</summary>"
        yield table_of(DETAILS, list(detail_rows(row)))
        yield "</details>"


def _adaptivity(content: ReportContent) -> Iterator[str]:
    table = content.table
    if table is None or not any(row.gain is not None for row in table.rows):
        return
    yield (
        f"<p>Most of what a switching agent gains can be had without looking at the race. The adaptivity gain is what "
        f"is left: the score of {html.escape(str(table.best))} minus that of {html.escape(str(table.blind))}, the "
        "agent that was best in training among those that never look.</p>"
    )
    rows = [(row.name, *_gain(row)) for row in table.rows if row.gain is not None]
    yield table_of(("row", "gain", "95 % interval", "p", "p (Holm)"), rows)
    yield from drawn("adaptivity_picture", "The adaptivity gain, row by row.", table)


def _gain(row: TableRow) -> tuple[str, ...]:
    assert row.gain is not None
    result = row.gain.result
    interval = f"[{result.low:+.3f}, {result.high:+.3f}]"
    return f"{result.difference:+.3f}", interval, p_text(result.p_clustered), p_text(row.gain.p_holm)


def _ablations(content: ReportContent) -> Iterator[str]:
    for sheet in content.ablations:
        yield from _sheet(sheet)


def _races(content: ReportContent) -> Iterator[str]:
    for race in content.races:
        yield f"<h3>{html.escape(race.title)}</h3>"
        yield (
            f'<iframe sandbox="allow-scripts" title="{html.escape(race.title)}" '
            f'srcdoc="{html.escape(replay_page(race.replay))}"></iframe>'
        )
        if race.text:
            yield f"<pre>{html.escape(race.text)}</pre>"
        if race.picture:
            yield image(race.picture, "What was seen and done: numbers are moves, blue is car 0, orange car 1.")


def _archive(content: ReportContent) -> Iterator[str]:
    archive = content.archive
    if archive is None:
        return
    yield (
        f"<p>Archive {html.escape(archive.name)}: {len(archive)} policies of planner {html.escape(archive.planner)}, "
        f"out of {len(archive.explored_parameters)} that were explored; sha256 {archive.content_hash[:16]}.</p>"
    )
    yield from drawn(
        "archive_picture",
        "Where policies lie, and where the moves of one of them lead.",
        archive,
        epsilon=content.epsilon,
    )


def _learning(content: ReportContent) -> Iterator[str]:
    if content.curves:
        yield from drawn("curves_picture", "Loss of the networks by epoch.", content.curves, y_label="loss", log=True)
    if content.reward_curves:
        options = {"x_label": "million steps", "y_label": "", "log": False}
        caption = "Reinforcement learning, by steps: means over the circuits and opponents that it was judged on."
        yield from drawn("curves_picture", caption, content.reward_curves, **options)


def _situations(content: ReportContent) -> Iterator[str]:
    if content.situations:
        yield (
            "<p>Situations are told by step, by thirds of the leads, and by thirds of the opponent's pace as it was "
            "measured in the step before; the thirds are those of what occurred before that move.</p>"
        )
    for found in content.situations:
        yield f"<h3>{html.escape(found.agent)}</h3>"
        races = int(found.counts[0].sum())
        caption = f"Which move in which situation, in % of the races that came there; {races:,} races."
        yield from drawn("situations_picture", caption, found)
        yield f"<details><summary>in words</summary><pre>{html.escape(situations_text(found))}</pre></details>"


def _exploitability(content: ReportContent) -> Iterator[str]:
    if not content.losses:
        return
    yield (
        "<p>What each agent loses on trees that no network has seen, in "
        f"{html.escape(content.loss_unit)}, mean of both roles and of the circuits (standard error over trees): to an "
        "opponent that knows it (half its NashConv), to one that plays its equilibrium; and what it gets from one that "
        "moves at random. Beside it its score in the races of the table, mean over the rows, and its rating.</p>"
    )
    scores = mean_scores(content.judged or content.table)
    columns = ("lost to best response", "lost to equilibrium", "against random")
    yield table_of(
        ("agent", "score", "rating", "trees", *columns),
        [
            (
                agent,
                f"{scores[agent]:.3f}" if agent in scores else "",
                "" if content.rivals is None else _finite(content.rivals.rating(agent)[0], "+.0f"),
                str(loss.trees),
                *_loss_cells(loss),
            )
            for agent, loss in mean_losses(content.losses).items()
        ],
    )
    yield "<details><summary>circuit by circuit</summary>"
    rows = [(loss.agent, loss.track, str(loss.trees), *_loss_cells(loss)) for loss in content.losses]
    yield table_of(("agent", "circuit", "trees", *columns), rows)
    yield "</details>"
    places = places_of(content.judged or content.table, content.losses)
    if places:
        caption = (
            "Strong and safe: the score is the mean over the rows of the table; lines: standard errors over trees."
        )
        yield from drawn("exploitability_picture", caption, places, unit=content.loss_unit)


def _loss_cells(loss: TreeLoss) -> Iterator[str]:
    for mean, error in loss.columns:
        yield "" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(error) else f"{mean:.3f} ({error:.3f})"


def _finite(value: float, form: str) -> str:
    return "" if np.isnan(value) else f"{value:{form}}"


def _ratings(content: ReportContent) -> Iterator[str]:
    rivals = content.rivals
    if rivals is None:
        return
    ratings = rivals.ratings
    if ratings is not None:
        order = np.argsort(-ratings.strength, kind="stable")
        head = ("agent", "rating", "95 % interval", "races", "races that paid nobody", "equilibrium", "alpha-rank")
        rows = []
        for i in order:
            name = ratings.names[i]
            rating, low, high = rivals.rating(name)
            meta = [
                "" if shares is None else f"{shares[rivals.names.index(name)]:.2f}"
                for shares in (rivals.equilibrium, rivals.alpha_rank)
            ]
            interval = "" if np.isnan(low) else f"[{low:+.0f}, {high:+.0f}]"
            rows.append((name, f"{rating:+.0f}", interval, str(ratings.races[i]), str(ratings.left_out[i]), *meta))
        yield table_of(head, rows)
        notes = ["Rating: Bradley-Terry with ties, from all against all; 400 are odds of ten to one."]
        if rivals.equilibrium is not None:
            notes.append("Equilibrium: how often to send whom, if the other side chooses its agent as cleverly.")
        if rivals.alpha_rank is not None:
            notes.append(
                "Alpha-rank: the share of the time that evolution spends at an agent; scores against each other that "
                f"differ by up to {rivals.alike:.3f}, which is within the noise, count as alike."
            )
        yield f'<p class="note">{html.escape(" ".join(notes))}</p>'
        yield from drawn(
            "ratings_picture", "Ratings from races of all against all; lines: bootstrap intervals.", ratings
        )
    yield from drawn("payoffs_picture", "Who scores how much against whom.", rivals.names, rivals.scores)


def _more(content: ReportContent) -> Iterator[str]:
    for sheet in content.sheets:
        yield from _sheet(sheet)
    for picture in content.pictures:
        yield f"<h3>{html.escape(picture.title)}</h3>"
        yield image(picture.content, picture.caption)


def _how(content: ReportContent) -> Iterator[str]:
    blocks = [
        ("Time, s", {name: f"{value:.1f}" for name, value in content.seconds.items()}),
        ("Versions", content.versions),
        ("Seeds", content.seeds),
        ("Settings", content.settings),
    ]
    if content.seconds:
        total = sum(content.seconds.values())
        blocks[0] = ("Time, s", {**blocks[0][1], "all": f"{total:.1f} ({total / 60.0:.1f} min)"})
    shown = [(title, values) for title, values in blocks if values]
    if shown:
        parts = [f"<div><h3>{title}</h3>{facts(values)}</div>" for title, values in shown]
        yield '<div class="columns">' + "\n".join(parts) + "</div>"


_SECTIONS: tuple[tuple[str, Callable[[ReportContent], Iterator[str]]], ...] = (
    ("Findings", _findings),
    ("Results", _results),
    ("Adaptivity gain", _adaptivity),
    ("Ablations", _ablations),
    ("Races to watch", _races),
    ("Which move in which situation", _situations),
    ("Policies", _archive),
    ("Learning", _learning),
    ("Exploitability", _exploitability),
    ("Ratings", _ratings),
    ("More", _more),
    ("How it was made", _how),
)


def _sheet(sheet: Sheet) -> Iterator[str]:
    yield f"<h3>{html.escape(sheet.title)}</h3>"
    yield table_of(sheet.head, sheet.rows)
    if sheet.note:
        yield f'<p class="note">{html.escape(sheet.note)}</p>'


def _anchor(title: str) -> str:
    return re.sub(r"[^a-z]+", "-", title.lower()).strip("-")
