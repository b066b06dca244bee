"""A tournament as text and as files: the table of the competitors, the payoff matrix, and a line for every race."""

import csv
import io
import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.errors import InputError
from pcs_racing.files import write_atomically
from pcs_racing_agents.tournament.play import Tournament
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.rows import RaceRow

__all__ = ["Standing", "payoff_matrix", "payoff_picture", "standings", "tournament_text", "write_results", "write_rows"]

COLUMNS = ("agent", "races", "score", "rating", "win", "tie", "loss", "crash: own", "other's", "overtakes")


class Standing(NamedTuple):
    """How one competitor did, as shares of its races; the five shares from ``win`` on sum up to 1.

    Attributes
    ----------
    name : str
    races : int
    score : float
        Share of races that the rules count as won, plus half of the ties. After a crash nobody wins under the crash
        rule ``nobody``; under ``fault-loses`` the car that is not to blame does.
    rating : float
        Bradley-Terry strength on the scale of chess ratings, mean 0; NaN where the races do not tell.
    win, tie, loss : float
        Races without a crash.
    own_crash, other_crash : float
        Races that ended in a crash that this one is (also) to blame for, or the other alone.
    overtakes : float
        Mean number of times that it passed the other car.
    """

    name: str
    races: int
    score: float
    rating: float
    win: float
    tie: float
    loss: float
    own_crash: float
    other_crash: float
    overtakes: float


def standings(tournament: Tournament) -> list[Standing]:
    """Return the table of a tournament, highest score first."""
    table = []
    ratings = _ratings(tournament)
    for name in tournament.plan.names:
        own = [(row, row.ego == name) for row in tournament.rows if name in (row.ego, row.opponent)]
        share = 1.0 / len(own)
        won = [row.winner == ("ego" if ego else "opponent") for row, ego in own]
        crashed = [row.crash != "" for row, _ in own]
        blamed = [row.fault in ("ego" if ego else "opponent", "both") for row, ego in own]
        tied = [not crash and row.winner == "" for (row, _), crash in zip(own, crashed, strict=True)]
        clean = [win and not crash for win, crash in zip(won, crashed, strict=True)]
        table.append(
            Standing(
                name=name,
                races=len(own),
                score=share * (sum(won) + 0.5 * sum(tied)),
                rating=ratings.get(name, np.nan),
                win=share * sum(clean),
                tie=share * sum(tied),
                loss=share * (len(own) - sum(clean) - sum(tied) - sum(crashed)),
                own_crash=share * sum(blamed),
                other_crash=share * (sum(crashed) - sum(blamed)),
                overtakes=share * sum(row.ego_overtakes if ego else row.opponent_overtakes for row, ego in own),
            )
        )
    return sorted(table, key=lambda standing: -standing.score)


def _ratings(tournament: Tournament) -> dict[str, float]:
    rows = tournament.rows
    crashed_for_nobody = [row.winner == "" and row.crash != "" for row in rows]
    result = [{"ego": 1.0, "opponent": -1.0, "": 0.0}[row.winner] for row in rows]
    try:
        found = rate([row.ego for row in rows], [row.opponent for row in rows], result, nobody=crashed_for_nobody)
    except InputError:  # too few races that somebody won: there is nothing to rate
        return {}
    return dict(zip(found.names, found.elo.tolist(), strict=True))


def payoff_matrix(tournament: Tournament) -> NDArray[np.float64]:
    """Return each competitor's score against each other one, shape (N, N), in the order of the plan; else NaN."""
    place = {name: i for i, name in enumerate(tournament.plan.names)}
    total = np.zeros((len(place), len(place)))
    races = np.zeros_like(total)
    for row in tournament.rows:
        i, j = place[row.ego], place[row.opponent]
        tie = 0.5 if row.winner == "" and row.crash == "" else 0.0
        total[i, j] += (row.winner == "ego") + tie
        total[j, i] += (row.winner == "opponent") + tie
        races[i, j] += 1.0
        races[j, i] += 1.0
    return np.divide(total, races, out=np.full_like(total, np.nan), where=races > 0.0)


def tournament_text(tournament: Tournament) -> str:
    """Return the table and the payoff matrix for people."""
    table = standings(tournament)
    crashes = sum(row.crash != "" for row in tournament.rows)
    passed = sum(row.ego_overtakes + row.opponent_overtakes > 0 for row in tournament.rows)
    races = len(tournament.rows)
    plan = tournament.plan
    head = (
        f"{races} races of {plan.config.duration:g} s, preset {plan.config.name}, on "
        f"{', '.join(track.name for track in plan.tracks)}; seed {plan.seed}\n"
        f"{1.0 - crashes / races:.0%} finished, {passed / races:.0%} with an overtake\n"
    )
    rows: list[tuple[str, ...]] = [COLUMNS]
    for s in table:
        shares = (f"{share:.1%}" for share in (s.win, s.tie, s.loss, s.own_crash, s.other_crash))
        rating = "-" if np.isnan(s.rating) else f"{s.rating:+.0f}"
        rows.append((s.name, str(s.races), f"{s.score:.3f}", rating, *shares, f"{s.overtakes:.2f}"))
    payoffs = payoff_matrix(tournament)
    order = [plan.names.index(standing.name) for standing in table]
    matrix: list[tuple[str, ...]] = [("score against", *(f"({k + 1})" for k in range(len(order))))]
    matrix += [
        (f"({k + 1}) {plan.names[i]}", *("-" if i == j else f"{payoffs[i, j]:.3f}" for j in order))
        for k, i in enumerate(order)
    ]
    paid = "the car not to blame" if plan.config.crash_rule == "fault-loses" else "nobody"
    note = f"score: races won, a tie counting half; a crash is won by {paid}; rating: Bradley-Terry, 400 are odds of 10"
    return "\n".join([head, *_aligned(rows), "", *_aligned(matrix), "", note])


def payoff_picture(tournament: Tournament, path: str | os.PathLike[str]) -> Path:
    """Draw the payoff matrix; the ending of the path says the format.

    Raises
    ------
    InputError
        If the folder does not exist.
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError('a picture needs matplotlib: pip install "pcs-racing[plots]"') from None
    names = [standing.name for standing in standings(tournament)]
    order = [tournament.plan.names.index(name) for name in names]
    payoffs = payoff_matrix(tournament)[np.ix_(order, order)]
    size = 2.2 + 0.55 * len(names)
    figure = Figure(figsize=(size + 0.8, size), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(payoffs, cmap="RdYlGn", vmin=0.0, vmax=1.0)
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(payoffs):
        if not np.isnan(value):
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=8)
    figure.colorbar(image, label="score of the row against the column", shrink=0.8)
    content = io.BytesIO()
    figure.savefig(content, format=Path(path).suffix.lstrip(".") or "png", dpi=120)
    write_atomically(Path(path), lambda file: file.write(content.getvalue()))
    return Path(path)


def write_results(tournament: Tournament, path: str | os.PathLike[str]) -> Path:
    """Write one line for every race as CSV; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    return write_rows(tournament.rows, tournament.plan.config.name, path)


def write_rows(rows: Iterable[RaceRow], preset: str, path: str | os.PathLike[str]) -> Path:
    """Write races of one preset as CSV; see :func:`write_results`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("preset", *RaceRow._fields))
    writer.writerows((preset, *map(_plain, row)) for row in rows)
    write_atomically(Path(path), lambda file: file.write(text.getvalue().encode()))
    return Path(path)


def _plain(value: object) -> object:
    """Floats to a tenth of a millimetre or millisecond: the file is the same on every machine. Lists as text."""
    if isinstance(value, float):
        return f"{value:.4f}"
    if isinstance(value, tuple):
        return "; ".join(str(item) for item in value)
    return value


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows as lines, the first column to the left, the others to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))]
        lines.append("  ".join(cells))
    return lines
