"""Tables of the study: scores with intervals, differences between racers, payoffs, a picture.

Intervals are clustered by start place, and by the start policies of the racer and of the opponent
where they vary. They apply to these circuits and opponents: races are compared with the mean of
their circuit and opponent.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.typing import Floats
from pcs_racing.race.config import load_rules
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.style import COLOURS, INK, new_figure, picture, save_picture, tidy
from pcs_racing_agents.base.tables import with_interval
from pcs_racing_agents.tournament.races import RaceTable, series_winner
from studies.ppo_against_cfr.races import CIRCUITS, CROSS_PLAY, LEVELS, OPPONENTS, Key, racers

Labels = NDArray[np.str_]
BASES = ("best-fixed", "cfr-argmax", "lattice")
"""Open loop, counterfactual regret and planner, for the differences."""
WHAT = ("score", "own crashes")
MARKS = "os", ("full", "none"), (-0.14, 0.14)
COLUMNS = (
    *("rules", "circuits", "level", "racer", "opponent", "races"),
    *("score", "low", "high", "own_crash", "own_low", "own_high"),
)
"""Columns of ``scores.csv``."""


class Cell(NamedTuple):
    """Races of a racer against an opponent on the circuits of one kind."""

    score: Floats  #: shape (N,): 1 for a win, 0.5 for a tie, else 0.
    own_crash: Floats  #: shape (N,): 1 for a crash by the racer's own fault.
    strata: Labels  #: shape (N,): Circuit and opponent.
    clusters: tuple[Labels, ...]  #: shape (N,) each: Start place; start policies of both.


Cells = dict[Key, Cell]


class Share(NamedTuple):
    """Mean over races with its 95 % interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} [{max(self.low, 0.0):.3f}, {min(self.high, 1.0):.3f}]"


def cell_of(races: Sequence[RaceTable], names: tuple[str, str], car: int = 0) -> Cell:
    """Return the cell of a car from the races of a pair, a table for each circuit."""
    tracks = np.repeat([one.track.words[0] for one in races], [len(one) for one in races])
    places = np.concatenate([one.places for one in races])
    policies = np.concatenate([one.variants for one in races])
    labels = [labelled(name, policies[:, k]) for k, name in enumerate(names)]
    winner = np.concatenate([one.winner for one in races])
    tie = np.concatenate([one.tie for one in races])
    fault = np.concatenate([one.fault[:, car] for one in races])
    return Cell(
        (winner == car) + 0.5 * tie,
        (fault == 1).astype(np.float64),
        labelled(names[1 - car], tracks),
        (labelled(tracks, places), labels[car], labels[1 - car]),
    )


def labelled(first: str | Labels, second: NDArray[Any]) -> Labels:
    """Return labels of two parts."""
    return np.char.add(np.char.add(first, " "), second.astype(str))


def joined(cells: Sequence[Cell]) -> Cell:
    """Return the races of several cells as one."""
    return Cell(
        np.concatenate([cell.score for cell in cells]),
        np.concatenate([cell.own_crash for cell in cells]),
        np.concatenate([cell.strata for cell in cells]),
        tuple(np.concatenate([cell.clusters[k] for cell in cells]) for k in range(3)),
    )


def make_cells(raced: Mapping[Key, Sequence[RaceTable]]) -> Cells:
    """Return the cells of all pairs, by the keys of the races, and of the opponents not raced as
    egos.
    """
    raced = {key: [_scored(key[0], one) for one in races] for key, races in raced.items()}
    cells = {key: cell_of(races, key[2:]) for key, races in raced.items()}
    for (rules, circuits, ego, opponent), races in raced.items():
        if (rules, circuits, opponent, ego) not in cells:
            cells[rules, circuits, opponent, ego] = cell_of(races, (ego, opponent), car=1)
    return cells


def _scored(rules: str, races: RaceTable) -> RaceTable:
    """Return races with the winners of their series."""
    config = load_rules(rules)
    if config.heats == 1:
        return races
    return replace(races, winner=series_winner(races, config)[0], crash=np.zeros_like(races.crash))


def over_opponents(cells: Cells, rules: str, circuits: str, racer: str) -> Cell:
    """Return a racer's races against all opponents."""
    return joined([cells[rules, circuits, racer, opponent] for opponent in OPPONENTS])


def share(values: Floats, strata: Labels, clusters: Sequence[Labels]) -> Share:
    """Return a mean over races with its interval; kinds with one label are no clusters."""
    codes = np.unique(strata, return_inverse=True)[1]
    means = np.bincount(codes, values) / np.bincount(codes)
    centred = values - means[codes] + values.mean()
    found = clustered_mean(centred, *(each for each in clusters if len(np.unique(each)) > 1))
    return Share(found.mean, found.low, found.high)


def score_of(cell: Cell) -> Share:
    """Return the mean score of a cell."""
    return share(cell.score, cell.strata, cell.clusters)


def own_crashes_of(cell: Cell) -> Share:
    """Return the share of the races that end in a crash by the racer's own fault."""
    return share(cell.own_crash, cell.strata, cell.clusters)


def difference(ego: Cell, other: Cell) -> Share:
    """Return the difference of two racers' scores in equal races."""
    return share(ego.score - other.score, ego.strata, (*ego.clusters, other.clusters[1]))


def score_rows(cells: Cells) -> list[tuple[object, ...]]:
    """Return a line for each racer, opponent (and all), kind of circuits and rules."""
    rows: list[tuple[object, ...]] = [COLUMNS]
    for rules, circuits in dict.fromkeys(key[:2] for key in cells):
        for racer, level in racers().items():
            parts = {name: cells[rules, circuits, racer, name] for name in OPPONENTS}
            for name, cell in {"all": joined(list(parts.values())), **parts}.items():
                figures = (
                    f"{x:.4f}" for one in (score_of(cell), own_crashes_of(cell)) for x in one
                )
                rows.append((rules, circuits, level, racer, name, len(cell.score), *figures))
    return rows


def table(
    names: Iterable[str], columns: Sequence[str], text: Callable[[str, str], str]
) -> list[tuple[str, ...]]:
    """Return a table of racers against others, empty where a racer meets itself."""
    rows = (
        (f"`{name}`", *("" if name == one else text(name, one) for one in columns))
        for name in names
    )
    return [("racer", *(f"`{one}`" for one in columns)), *rows]


def page(cells: Cells, rules: str) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Return the titles and tables of the report for one set of rules."""
    names, held_out = racers(), CIRCUITS[1]
    keys = [(kind, name) for kind in CIRCUITS for name in names]
    whole = {key: over_opponents(cells, rules, *key) for key in keys}
    shown = {key: (str(score_of(one)), str(own_crashes_of(one))) for key, one in whole.items()}

    def gain(name: str, base: str) -> str:
        return with_interval(*difference(whole[held_out, name], whole[held_out, base]))

    def against(name: str, opponent: str) -> str:
        found = score_of(cells[rules, held_out, name, opponent])
        return f"{found.mean:.3f} ± {0.5 * (found.high - found.low):.3f}"

    def payoff(name: str, opponent: str) -> str:
        return str(score_of(joined([cells[rules, kind, name, opponent] for kind in CIRCUITS])))

    head = ("level", "racer", *(f"{one}: {what}" for one in CIRCUITS for what in WHAT))
    main = [
        (level, f"`{name}`", *(text for kind in CIRCUITS for text in shown[kind, name]))
        for name, level in names.items()
    ]
    cross = [name for name in CROSS_PLAY if name in names]
    return [
        ("Score against the six opponents, and own crashes", [head, *main]),
        ("Score minus the score of others, held-out circuits", table(names, BASES, gain)),
        ("Score by opponent, held-out circuits", table(names, OPPONENTS, against)),
        ("Score of all against all, all circuits", table(cross, cross, payoff)),
    ]


@picture
def draw_scores(cells: Cells, file: Path) -> Path:
    """Draw each racer's mean score with its interval, a panel for each set of rules."""
    rules, names, levels = list(dict.fromkeys(key[0] for key in cells)), racers(), list(LEVELS)
    figure = new_figure(4.6 * len(rules), 3.4)
    panels = figure.subplots(1, len(rules), squeeze=False, sharey=True)[0]
    for panel, one in zip(panels, rules, strict=True):
        for circuits, marker, fill, shift in zip(CIRCUITS, *MARKS, strict=True):
            style = {"marker": marker, "fillstyle": fill}
            for k, (name, level) in enumerate(names.items()):
                found = score_of(over_opponents(cells, one, circuits, name))
                colour = COLOURS[levels.index(level)]
                panel.plot([found.low, found.high], [k + shift] * 2, color=colour, linewidth=1.6)
                panel.plot(found.mean, k + shift, color=colour, **style)
            label = f"{circuits} circuits"
            panel.plot([], [], color=INK, linestyle="", label=label, **style)
        panel.set(title=f"rules {one}", xlabel="score against the six opponents", xlim=(0.0, 1.0))
        panel.set_yticks(range(len(names)), [f"{name} ({names[name]})" for name in names])
        tidy(panel, "x")
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=2)
    return save_picture(figure, file)
