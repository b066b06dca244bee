"""Tables of the study: scores with intervals, differences between racers, payoffs, a picture.

Intervals are clustered by start place, and by the start policies of the racer and of the opponent
where they vary. They apply to these circuits and opponents: races are compared with the mean of
their circuit and opponent.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.style import COLOURS, INK, new_figure, picture, save_picture, tidy
from pcs_racing_agents.base.tables import with_interval
from pcs_racing_agents.tournament.races import RaceTable
from studies.ppo_against_cfr.races import CIRCUITS, CROSS_PLAY, LEVELS, OPPONENTS, racers

Floats = NDArray[np.float64]
Labels = NDArray[np.str_]

ALL = "all"


class Cell(NamedTuple):
    """Races of a racer against an opponent on the circuits of one kind."""

    score: Floats  #: shape (N,): 1 for a win, 0.5 for a tie, else 0.
    own_crash: Floats  #: shape (N,): 1 for a crash by the racer's own fault.
    strata: Labels  #: shape (N,): Circuit and opponent.
    clusters: tuple[Labels, ...]  #: shape (N,) each: Start place; start policies of both.


Cells = dict[tuple[str, str, str, str], Cell]
"""Cells by rules, kind of circuits, racer and opponent."""


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


def make_cells(raced: Mapping[tuple[str, str, str, str], Sequence[RaceTable]]) -> Cells:
    """Return the cells of all pairs, by the keys of the races, and of the opponents not raced as
    egos.
    """
    cells = {key: cell_of(races, key[2:]) for key, races in raced.items()}
    for (rules, circuits, ego, opponent), races in raced.items():
        if (rules, circuits, opponent, ego) not in cells:
            cells[rules, circuits, opponent, ego] = cell_of(races, (ego, opponent), car=1)
    return cells


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


COLUMNS = (
    *("rules", "circuits", "level", "racer", "opponent", "races"),
    *("score", "low", "high", "own_crash", "own_low", "own_high"),
)


def score_rows(cells: Cells) -> list[tuple[object, ...]]:
    """Return a line for each racer, opponent (and all), kind of circuits and rules."""
    rows: list[tuple[object, ...]] = [COLUMNS]
    for rules, circuits in kinds(cells):
        for racer, level in racers().items():
            whole = over_opponents(cells, rules, circuits, racer)
            parts = [(name, cells[rules, circuits, racer, name]) for name in OPPONENTS]
            for name, cell in [(ALL, whole), *parts]:
                shares = score_of(cell), own_crashes_of(cell)
                figures = (f"{value:.4f}" for one in shares for value in one)
                rows.append((rules, circuits, level, racer, name, len(cell.score), *figures))
    return rows


def kinds(cells: Cells) -> list[tuple[str, str]]:
    """Return rules and kinds of circuits in order."""
    return list(dict.fromkeys((rules, circuits) for rules, circuits, *_ in cells))


def main_table(cells: Cells, rules: str) -> list[tuple[str, ...]]:
    """Return level, racer, score and own crashes of each racer on both kinds of circuits."""
    rows = [("level", "racer", *(f"{one}: {what}" for one in CIRCUITS for what in WHAT))]
    for racer, level in racers().items():
        texts = []
        for circuits in CIRCUITS:
            cell = over_opponents(cells, rules, circuits, racer)
            texts += [str(score_of(cell)), str(own_crashes_of(cell))]
        rows.append((level, f"`{racer}`", *texts))
    return rows


WHAT = ("score", "own crashes")
BASES = ("best-fixed", "cfr-argmax", "lattice")


def difference_table(cells: Cells, rules: str, circuits: str) -> list[tuple[str, ...]]:
    """Return the differences of each racer's score to open loop, CFR and planner."""
    rows = [("racer", *(f"minus `{base}`" for base in BASES))]
    whole = {name: over_opponents(cells, rules, circuits, name) for name in racers()}
    for racer in racers():
        texts = (
            "" if racer == base else with_interval(*difference(whole[racer], whole[base]))
            for base in BASES
        )
        rows.append((f"`{racer}`", *texts))
    return rows


def opponent_table(cells: Cells, rules: str, circuits: str) -> list[tuple[str, ...]]:
    """Return the score of each racer against each opponent, and half of its interval."""
    rows = [("racer", *(f"`{name}`" for name in OPPONENTS))]
    for racer in racers():
        found = [score_of(cells[rules, circuits, racer, name]) for name in OPPONENTS]
        texts = (f"{one.mean:.3f} ± {0.5 * (one.high - one.low):.3f}" for one in found)
        rows.append((f"`{racer}`", *texts))
    return rows


def payoff_table(cells: Cells, rules: str) -> list[tuple[str, ...]]:
    """Return the payoffs of the cross-play, all against all."""
    names = [name for name in CROSS_PLAY if name in racers()]

    def payoff(racer: str, opponent: str) -> str:
        both = joined([cells[rules, circuits, racer, opponent] for circuits in CIRCUITS])
        return str(score_of(both))

    rows = [("row against column", *(f"`{name}`" for name in names))]
    for racer in names:
        texts = ("" if racer == other else payoff(racer, other) for other in names)
        rows.append((f"`{racer}`", *texts))
    return rows


@picture
def draw_scores(cells: Cells, file: Path) -> Path:
    """Draw each racer's mean score with its interval, a panel for each set of rules."""
    rules = list(dict.fromkeys(one for one, _ in kinds(cells)))
    figure = new_figure(4.6 * len(rules), 3.4)
    panels = figure.subplots(1, len(rules), squeeze=False, sharey=True)[0]
    names, levels = list(racers()), list(LEVELS)
    for panel, one in zip(panels, rules, strict=True):
        for circuits, marker, shift in zip(CIRCUITS, "os", (-0.14, 0.14), strict=True):
            for k, name in enumerate(names):
                cell = over_opponents(cells, one, circuits, name)
                found = score_of(cell)
                colour = COLOURS[levels.index(racers()[name])]
                panel.plot([found.low, found.high], [k + shift] * 2, color=colour, linewidth=1.6)
                panel.plot(
                    found.mean,
                    k + shift,
                    marker,
                    color=colour,
                    markerfacecolor=colour if marker == "o" else "white",
                )
            panel.plot(
                [],
                [],
                marker,
                color=INK,
                label=f"{circuits} circuits",
                markerfacecolor=INK if marker == "o" else "white",
            )
        panel.set(title=f"rules {one}", xlabel="score against the six opponents", xlim=(0.0, 1.0))
        panel.set_yticks(range(len(names)), [f"{name} ({racers()[name]})" for name in names])
        tidy(panel, "x")
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=2)
    return save_picture(figure, file)


def page(cells: Cells, rules: str) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Return the titles and tables of the report for one set of rules."""
    held_out = CIRCUITS[1]
    return [
        ("Score against the six opponents, and own crashes", main_table(cells, rules)),
        (
            "Differences of the score in equal races, held-out circuits",
            difference_table(cells, rules, held_out),
        ),
        ("Score by opponent, held-out circuits", opponent_table(cells, rules, held_out)),
        ("Cross-play, all circuits: score of the row", payoff_table(cells, rules)),
    ]
