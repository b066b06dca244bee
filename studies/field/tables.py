"""Tables of the study: scores and own crashes with intervals, the best planner, a picture.

Intervals (95 %) are clustered by circuit and start line. They apply to these circuits and
opponents: races are compared with the mean of their circuit and opponent.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError
from pcs_racing.race.config import Rules
from pcs_racing_agents.base.style import COLOURS, INK, new_figure, picture, save_picture, tidy
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.tournament.races import RaceTable, series_of
from studies.field.entrants import KINDS, Entrant
from studies.field.races import CIRCUITS, Raced
from studies.ppo_against_cfr.tables import Cell, Share, cell_of, joined, share

TITLE = "best planner"
"""Opponent of the agents' additional races."""
ALL = "all"
WHAT = ("score", "own_crash")
COLUMNS = (
    *("rules", "circuits", "name", "kind", "opponent", "against", "races"),
    *(f"{what}{end}" for what in WHAT for end in ("", "_low", "_high")),
)
"""Columns of ``scores.csv``."""
Table = tuple[str, list[tuple[str, ...]]]
"""Title and rows of a table, column names first."""


class Line(NamedTuple):
    """Line of ``scores.csv``."""

    rules: str
    circuits: str
    name: str
    kind: str
    opponent: str  #: Label of the opponent, :data:`ALL` or :data:`TITLE`.
    against: str  #: Labels of the opponents.
    races: int
    score: Share  #: Share of races, or of series, won; a tie is a half.
    own_crash: Share  #: Share of races ended by a crash of the entrant's fault.

    @property
    def label(self) -> str:
        """Name of the entrant in tables."""
        return f"{self.name}, tuned" if self.kind == "tuned" else self.name


def clustered(values: Cell, what: str) -> Share:
    """Return the score or the own crashes of some races, clustered by circuit and start line."""
    return share(getattr(values, what), values.strata, values.clusters[:1])


def cells_of(races: Sequence[RaceTable], names: tuple[str, str], rules: Rules) -> tuple[Cell, Cell]:
    """Return the scored series and the races of a pair, a table for each circuit."""
    return cell_of([series_of(one, rules) for one in races], names), cell_of(races, names)


def lines_of(
    rules: Rules, raced: Raced, entrants: Sequence[Entrant], opponents: Sequence[str]
) -> list[Line]:
    """Return the lines of all entrants: against each opponent, and against all of them."""
    lines = []
    for kind in CIRCUITS:
        for one in entrants:
            pairs = {
                opponent: cells_of(raced[kind, one.label, opponent], (one.label, opponent), rules)
                for opponent in opponents
            }
            every = tuple(joined(cells) for cells in zip(*pairs.values(), strict=True))
            for name, (series, races) in {ALL: every, **pairs}.items():
                against = ", ".join(opponents) if name == ALL else name
                figures = clustered(series, "score"), clustered(races, "own_crash")
                count = len(races.score)
                about = rules.name, kind, one.name, one.kind, name, against, count
                lines.append(Line(*about, *figures))
    return lines


def title_lines(raced: Raced, agents: Sequence[Entrant], best: str, rules: Rules) -> list[Line]:
    """Return the lines of the agents' races against the best planner."""
    lines = lines_of(rules, raced, agents, [best])
    return [one._replace(opponent=TITLE) for one in lines if one.opponent != ALL]


def best_planner(lines: Sequence[Line], entrants: Sequence[Entrant]) -> Entrant:
    """Return the planner with the max score on the training circuits.

    An agent can't be the best planner.
    """
    able = {one.label: one for one in entrants if one.kind != "agent"}
    scores = {
        one.label: one.score.mean
        for one in lines
        if one.opponent == ALL and one.circuits == CIRCUITS[0] and one.label in able
    }
    return able[max(scores, key=lambda label: scores[label])]


def csv_rows(lines: Sequence[Line]) -> list[tuple[object, ...]]:
    """Return the rows of ``scores.csv``, column names first."""
    return [COLUMNS] + [
        (*one[:7], *(f"{x:.4f}" for part in (one.score, one.own_crash) for x in part))
        for one in lines
    ]


def read_lines(file: Path) -> list[Line]:
    """Return the lines of a table of scores."""
    if not file.is_file():
        raise InputError(f"{file} does not exist; run this part of the races first")
    found = []
    for row in read_csv(file).rows():
        parts = [Share(*(float(row[f"{w}{e}"]) for e in ("", "_low", "_high"))) for w in WHAT]
        rules, circuits, name, kind, opponent, against = (row[column] for column in COLUMNS[:6])
        count = int(row["races"])
        found.append(Line(rules, circuits, name, kind, opponent, against, count, *parts))
    return found


def score_table(lines: Sequence[Line]) -> Table:
    """Return the title and the table of one set of rules, a row for each planner and agent."""
    held_out = [one for one in lines if one.opponent == ALL and one.circuits == "held-out"]
    best: dict[str, float] = {}
    for one in held_out:
        best[one.name] = max(best.get(one.name, 0.0), one.score.mean)
    found = {(one.name, one.kind == "tuned"): one for one in held_out}
    rows: list[tuple[str, ...]] = [
        (f"`{name}`", *_figures(found.get((name, False))), *_figures(found.get((name, True))))
        for name in sorted(best, key=lambda name: -best[name])
    ]
    title = f"{held_out[0].rules}, held out, against {held_out[0].against}"
    return title, [("entrant", "score", "own crashes", "tuned", "own crashes"), *rows]


def _figures(line: Line | None) -> tuple[str, str]:
    if line is None:
        return "", ""
    return f"{line.score.mean:.3f}", f"{line.own_crash.mean:.3f}"


def title_table(lines: Sequence[Line]) -> Table:
    """Return the title and the table of the agents against the best planner, held out."""
    title = [one for one in lines if one.opponent == TITLE and one.circuits == "held-out"]
    rows: list[tuple[str, ...]] = [
        (f"`{one.name}`", f"{one.races:,}", str(one.score), str(one.own_crash)) for one in title
    ]
    name = f"{title[0].rules}, held out, agents against {title[0].against}" if title else ""
    return name, [("agent", "races", "score", "own crashes"), *rows]


def pages(lines: Sequence[Line], costs: Mapping[str, float]) -> list[Table]:
    """Return the titles and tables of the report."""
    found = []
    for rules in dict.fromkeys(one.rules for one in lines):
        own = [one for one in lines if one.rules == rules]
        found += [score_table(own), title_table(own)]
    rows: list[tuple[str, ...]] = [(f"`{name}`", f"{cost:.1f}") for name, cost in costs.items()]
    found.append(("Processor time", [("planner", "ms for a 40 s race of two"), *rows]))
    return [(title, rows) for title, rows in found if len(rows) > 1]


@picture
def draw_scores(lines: Sequence[Line], file: Path) -> Path:
    """Draw the held-out scores with intervals, a panel for each set of rules.

    Defaults are hollow, tuned planners are filled, agents have another colour.
    """
    shown = [one for one in lines if one.opponent == ALL and one.circuits == CIRCUITS[1]]
    rules = list(dict.fromkeys(one.rules for one in shown))
    best: dict[str, float] = {}
    for one in (one for one in shown if one.rules == rules[0]):
        best[one.name] = max(best.get(one.name, 0.0), one.score.mean)
    names = sorted(best, key=lambda name: -best[name])
    figure = new_figure(3.6 * len(rules) + 1.2, 0.19 * len(names) + 1.0)
    panels = figure.subplots(1, len(rules), squeeze=False, sharey=True)[0]
    for panel, own in zip(panels, rules, strict=True):
        for one in (one for one in shown if one.rules == own):
            _draw_line(panel, one, names.index(one.name))
        for kind in KINDS:
            panel.plot([], [], linestyle="", label=kind, **_style(kind))
        panel.axvline(0.5, color=INK, linewidth=0.6)
        panel.set(title=f"rules {own}", xlabel="score, circuits held out", xlim=(0.0, 1.0))
        panel.set_yticks(range(len(names)), names)
        tidy(panel, "x")
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=3)
    return save_picture(figure, file)


def _draw_line(panel: Any, line: Line, place: int) -> None:
    """Draw a score with its interval; a tuned planner is a little below its defaults."""
    at = place + (0.22 if line.kind == "tuned" else -0.1)
    style = _style(line.kind)
    panel.plot([line.score.low, line.score.high], [at, at], color=style["color"], linewidth=1.3)
    panel.plot(line.score.mean, at, **style)


def _style(kind: str) -> dict[str, Any]:
    colour = COLOURS[1] if kind == "agent" else COLOURS[0]
    fill = "white" if kind == "default" else colour
    return {"color": colour, "marker": "o", "markersize": 4.5, "markerfacecolor": fill}
