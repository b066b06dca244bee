"""A tournament as text and as a file: the table of the policies, the payoff matrix, and a line for every race."""

import csv
import io
import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.files import write_atomically
from pcs_racing_agents.tournament.play import RaceRow, Tournament

__all__ = ["Standing", "payoff_matrix", "standings", "tournament_text", "write_results"]

COLUMNS = ("policy", "races", "score", "win", "tie", "loss", "crash: own", "other's", "overtakes")


class Standing(NamedTuple):
    """How one policy did, as shares of its races; the five shares from ``win`` on sum up to 1.

    Attributes
    ----------
    name : str
    races : int
    score : float
        Share of races that the rules count as won, plus half of the ties. After a crash nobody wins under the crash
        rule ``nobody``; under ``fault-loses`` the car that is not to blame does.
    win, tie, loss : float
        Races without a crash.
    own_crash, other_crash : float
        Races that ended in a crash that this policy is (also) to blame for, or the other alone.
    overtakes : float
        Mean number of times that it passed the other car.
    """

    name: str
    races: int
    score: float
    win: float
    tie: float
    loss: float
    own_crash: float
    other_crash: float
    overtakes: float


def standings(tournament: Tournament) -> list[Standing]:
    """Return the table of a tournament, highest score first."""
    table = []
    for name in tournament.policies:
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
                win=share * sum(clean),
                tie=share * sum(tied),
                loss=share * (len(own) - sum(clean) - sum(tied) - sum(crashed)),
                own_crash=share * sum(blamed),
                other_crash=share * (sum(crashed) - sum(blamed)),
                overtakes=share * sum(row.ego_overtakes if ego else row.opponent_overtakes for row, ego in own),
            )
        )
    return sorted(table, key=lambda standing: -standing.score)


def payoff_matrix(tournament: Tournament) -> NDArray[np.float64]:
    """Return each policy's score against each other one, shape (N, N), in the order of ``policies``; else NaN."""
    place = {name: i for i, name in enumerate(tournament.policies)}
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
    head = (
        f"{races} races of {tournament.config.duration:g} s, preset {tournament.config.name}, on "
        f"{', '.join(tournament.tracks)}; seed {tournament.seed}\n"
        f"{1.0 - crashes / races:.0%} finished, {passed / races:.0%} with an overtake\n"
    )
    rows: list[tuple[str, ...]] = [COLUMNS]
    for s in table:
        shares = (f"{share:.1%}" for share in (s.win, s.tie, s.loss, s.own_crash, s.other_crash))
        rows.append((s.name, str(s.races), f"{s.score:.3f}", *shares, f"{s.overtakes:.2f}"))
    payoffs = payoff_matrix(tournament)
    order = [tournament.policies.index(standing.name) for standing in table]
    matrix: list[tuple[str, ...]] = [("score against", *(f"({k + 1})" for k in range(len(order))))]
    matrix += [
        (f"({k + 1}) {tournament.policies[i]}", *("-" if i == j else f"{payoffs[i, j]:.3f}" for j in order))
        for k, i in enumerate(order)
    ]
    paid = "the car not to blame" if tournament.config.crash_rule == "fault-loses" else "nobody"
    note = f"score: races won, a tie counting half; a crash is won by {paid}"
    return "\n".join([head, *_aligned(rows), "", *_aligned(matrix), "", note])


def write_results(tournament: Tournament, path: str | os.PathLike[str]) -> Path:
    """Write one line for every race as CSV; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("preset", *RaceRow._fields))
    writer.writerows((tournament.config.name, *_plain(row)) for row in tournament.rows)
    write_atomically(Path(path), lambda file: file.write(text.getvalue().encode()))
    return Path(path)


def _plain(row: RaceRow) -> Iterable[object]:
    """Floats to a tenth of a millimetre or millisecond, so that the file is the same on every machine."""
    return (f"{value:.4f}" if isinstance(value, float) else value for value in row)


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows as lines, the first column to the left, the others to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))]
        lines.append("  ".join(cells))
    return lines
