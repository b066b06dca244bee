"""The report of a study: one self-contained page with tables, pictures and replays."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.race.replay import Replay
from pcs_racing_agents.base.curves import Curve, curves_picture
from pcs_racing_agents.base.style import picture_bytes
from pcs_racing_agents.study.figures import differences_picture
from pcs_racing_agents.study.table import StudyTable
from pcs_racing_agents.study.table_output import DETAILS, detail_rows, notes, p_text, paper_text
from pcs_racing_agents.tournament import RoundRobin
from pcs_racing_agents.tournament.table import payoffs_picture, rating_interval, ratings_picture
from pcs_racing_agents.watch.pages import Standing, rendered
from pcs_racing_agents.watch.pcs_picture import archive_picture


class TitledTable(NamedTuple):
    """A table with a title."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]  #: Rows of as many cells as the head; numbers align right.
    note: str = ""


class ExplainedRace(NamedTuple):
    """A race with explanation and replay for a report."""

    title: str
    text: str  #: Explanation; may be empty.
    replay: Replay
    #: Moves as an SVG picture; may be empty.
    #: Drawn by :func:`pcs_racing_agents.watch.pictures.explanation_picture`.
    picture: bytes = b""


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Content of a report; everything but the title is optional."""

    title: str
    facts: str = ""  #: Number and kind of the races, in a line.
    about: str = ""  #: Subject of the study, in a few sentences.
    findings: Sequence[str] = ()  #: Results, one sentence each; the first is the headline.
    caution: str = ""  #: Reason to distrust the results.
    table: StudyTable | None = None
    standings: Sequence[Standing] = ()  #: Scores over all races of the table, best first.
    archive: PolicyArchive | None = None  #: Archive to draw, with moves of length ``epsilon``.
    epsilon: float | tuple[float, ...] = 0.5
    curves: Mapping[str, Sequence[Curve]] = field(default_factory=dict)  #: Losses per network.
    round_robin: RoundRobin | None = None
    sheets: Sequence[TitledTable] = ()  #: Other tables.
    races: Sequence[ExplainedRace] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)


def report_page(content: ReportContent) -> str:
    """Return the report as HTML from the template ``report.html``; all text is escaped."""
    # Names of agents and tracks come from files: all text is escaped.
    return rendered(
        "pcs_racing_agents.study",
        "report.html",
        {"p_value": p_text, "plain": _plain, "data": _data},
        title=content.title,
        result=next(iter(content.findings), ""),
        facts=content.facts,
        content=content,
        table=content.table,
        can_draw=find_spec("matplotlib") is not None,
        draw=_draw,
        details=detail_rows,
        detail_columns=DETAILS,
        notes=notes,
        paper_text=paper_text,
        ratings=_ratings(content),
        archive_picture=archive_picture,
        curves_picture=curves_picture,
        differences_picture=differences_picture,
        payoffs_picture=payoffs_picture,
        ratings_picture=ratings_picture,
    )


def _draw(draw: Callable[..., Any], *arguments: Any, **options: Any) -> bytes:
    """Draw one of the report's pictures."""
    return picture_bytes(draw(*arguments, **options))


def _data(picture: bytes) -> str:
    """Return an SVG picture as a data URL."""
    return f"data:image/svg+xml;base64,{base64.b64encode(picture).decode('ascii')}"


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_plain(one)}" for name, one in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _ratings(content: ReportContent) -> list[tuple[str, ...]]:
    """Return the ratings as a table, best first; empty without ratings."""
    round_robin = content.round_robin
    if round_robin is None or round_robin.ratings is None:
        return []
    table: list[tuple[str, ...]] = [
        ("agent", "rating", "95 % interval", "races", "no-contests", "equilibrium")
    ]
    ratings, chances = round_robin.ratings, round_robin.equilibrium
    for i in np.argsort(-ratings.strength, kind="stable"):
        name = ratings.names[i]
        rating, low, high = round_robin.rating(name)
        counts = (str(ratings.races[i]), str(ratings.left_out[i]))
        chance = "" if chances is None else f"{chances[round_robin.names.index(name)]:.2f}"
        table.append((name, f"{rating:+.0f}", rating_interval(low, high), *counts, chance))
    return table
