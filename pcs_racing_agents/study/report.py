"""The report of a study: one self-contained page with tables, pictures and replays."""

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from pcs_racing.base.files import write_atomically
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.race.replay import replay_page
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.tables import is_number
from pcs_racing_agents.study.report_inputs import ExplainedRace
from pcs_racing_agents.study.table import StudyTable
from pcs_racing_agents.study.table_text import DETAILS, detail_rows, notes, p_text, paper_text
from pcs_racing_agents.tournament.round_robin import RoundRobin
from pcs_racing_agents.tournament.table import rating_interval
from pcs_racing_agents.watch.situations import Situations, situations_text


class TitledTable(NamedTuple):
    """A table with a title."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]  #: Rows of as many cells as the head; numbers align right.
    note: str = ""


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Content of a report; everything but the title is optional."""

    title: str
    about: str = ""  #: Subject of the study, in a few sentences.
    findings: Sequence[str] = ()  #: Results, one sentence each; the first is the headline.
    caution: str = ""  #: Reason to distrust the results.
    table: StudyTable | None = None
    archive: PolicyArchive | None = None  #: Archive to draw, with moves of length ``epsilon``.
    epsilon: float | tuple[float, ...] = 0.5
    curves: Mapping[str, Sequence[Curve]] = field(default_factory=dict)  #: Losses per network.
    #: Learning curves of reinforcement learning by step (in millions), one panel per figure.
    reward_curves: Mapping[str, Sequence[Curve]] = field(default_factory=dict)
    round_robin: RoundRobin | None = None
    situations: Sequence[Situations] = ()  #: Moves by situation, for each agent.
    sheets: Sequence[TitledTable] = ()  #: Other tables.
    races: Sequence[ExplainedRace] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)
    seeds: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)  #: Time of each stage, s.


def write_page(content: ReportContent, path: str | os.PathLike[str]) -> Path:
    """Write the report atomically; without matplotlib it has no pictures of its own."""
    page = report_page(content)
    write_atomically(Path(path), lambda file: file.write(page.encode("utf-8")))
    return Path(path)


def page_environment(package: str) -> Environment:
    """Return a package's template environment: text is escaped, and ``page`` embeds a replay."""
    environment = Environment(
        loader=PackageLoader(package, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["page"] = replay_page
    return environment


def report_page(content: ReportContent) -> str:
    """Return the report as HTML from the template ``report.html``; all text is escaped."""
    # Names of agents and tracks come from files: all text is escaped.
    environment = page_environment("pcs_racing_agents.study")
    environment.filters |= {"p_value": p_text, "plain": _plain, "data": _data}
    environment.tests["number"] = is_number
    return environment.get_template("report.html").render(
        content=content,
        table=content.table,
        can_draw=find_spec("matplotlib") is not None,
        draw=_draw,
        details=detail_rows,
        detail_columns=DETAILS,
        notes=notes,
        paper_text=paper_text,
        situations_text=situations_text,
        ratings=_ratings(content),
    )


def _draw(name: str, *arguments: Any, **options: Any) -> bytes:
    """Draw one of the report's pictures."""
    from pcs_racing_agents.base import curves
    from pcs_racing_agents.base.style import picture_bytes
    from pcs_racing_agents.study import figures
    from pcs_racing_agents.tournament import table
    from pcs_racing_agents.watch import pcs_picture, situations

    # The template names a picture; the modules imported here, only for reports, draw it.
    home = next(
        module
        for module in (figures, curves, table, pcs_picture, situations)
        if hasattr(module, name)
    )
    return picture_bytes(getattr(home, name)(*arguments, **options))


def _data(picture: bytes) -> str:
    """Return an SVG picture as a data URL."""
    return f"data:image/svg+xml;base64,{base64.b64encode(picture).decode('ascii')}"


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _ratings(content: ReportContent) -> list[tuple[str, ...]]:
    """Return the ratings as a table, best first; empty without ratings."""
    round_robin = content.round_robin
    if round_robin is None or round_robin.ratings is None:
        return []
    table: list[tuple[str, ...]] = [
        (
            "agent",
            "rating",
            "95 % interval",
            "races",
            "races that paid nobody",
            "equilibrium",
            "alpha-rank",
        )
    ]
    for i in np.argsort(-round_robin.ratings.strength, kind="stable"):
        name = round_robin.ratings.names[i]
        rating, low, high = round_robin.rating(name)
        equilibrium, alpha_rank = (
            "" if probabilities is None else f"{probabilities[round_robin.names.index(name)]:.2f}"
            for probabilities in (round_robin.equilibrium, round_robin.alpha_rank)
        )
        counts = (str(round_robin.ratings.races[i]), str(round_robin.ratings.left_out[i]))
        table.append(
            (name, f"{rating:+.0f}", rating_interval(low, high), *counts, equilibrium, alpha_rank)
        )
    return table
