"""A tournament as text and as files: the table of the competitors, the payoff matrix, and a line for every race."""

import csv
import io
import os
from collections.abc import Iterable
from functools import lru_cache
from itertools import compress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.files import write_atomically
from pcs_racing_agents.tournament.play import Tournament
from pcs_racing_agents.tournament.round_robin import RoundRobin, round_robin
from pcs_racing_agents.tournament.rows import RaceRow

__all__ = [
    "Standing",
    "payoff_matrix",
    "payoff_picture",
    "standings",
    "sum_up",
    "tournament_text",
    "write_results",
    "write_rows",
]

COLUMNS = ("agent", "races", "score", "rating", "95 %", "win", "tie", "loss", "crash: own", "other's", "overtakes")
META = ("equilibrium", "alpha-rank")


class Standing(NamedTuple):
    """How one competitor did, as shares of its races; the five shares from ``win`` on sum up to 1.

    Attributes
    ----------
    name : str
    races : int
    score : float
        Share of races that the rules count as won, plus half of the ties. After a crash nobody wins under the crash
        rule ``nobody``; under ``fault-loses`` the car that is not to blame does.
    rating, rating_low, rating_high : float
        Bradley-Terry strength on the scale of chess ratings, mean 0, and its 95 % interval; NaN where the races do not
        tell.
    win, tie, loss : float
        Races without a crash.
    own_crash, other_crash : float
        Races that ended in a crash that this one is (also) to blame for, or the other alone.
    overtakes : float
        Mean number of times that it passed the other car.
    equilibrium, alpha_rank : float
        How often it is sent in an equilibrium of choosing an agent, and the share of the time that evolution spends at
        it (:class:`pcs_racing_agents.tournament.round_robin.RoundRobin`); NaN where that is not known.
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
    rating_low: float = np.nan
    rating_high: float = np.nan
    equilibrium: float = np.nan
    alpha_rank: float = np.nan


def standings(tournament: Tournament) -> list[Standing]:
    """Return the table of a tournament, highest score first."""
    table = []
    together = sum_up(tournament)
    for k, name in enumerate(tournament.plan.names):
        own = [(row, row.ego == name) for row in tournament.rows if name in (row.ego, row.opponent)]
        share = 1.0 / len(own)
        won = [row.winner == ("ego" if ego else "opponent") for row, ego in own]
        crashed = [row.crash != "" for row, _ in own]
        blamed = [row.fault in ("ego" if ego else "opponent", "both") for row, ego in own]
        tied = [not crash and row.winner == "" for (row, _), crash in zip(own, crashed, strict=True)]
        clean = [win and not crash for win, crash in zip(won, crashed, strict=True)]
        rating, low, high = together.rating(name)
        table.append(
            Standing(
                name=name,
                races=len(own),
                score=share * (sum(won) + 0.5 * sum(tied)),
                rating=rating,
                win=share * sum(clean),
                tie=share * sum(tied),
                loss=share * (len(own) - sum(clean) - sum(tied) - sum(crashed)),
                own_crash=share * sum(blamed),
                other_crash=share * (sum(crashed) - sum(blamed)),
                overtakes=share * sum(row.ego_overtakes if ego else row.opponent_overtakes for row, ego in own),
                rating_low=low,
                rating_high=high,
                equilibrium=np.nan if together.equilibrium is None else float(together.equilibrium[k]),
                alpha_rank=np.nan if together.alpha_rank is None else float(together.alpha_rank[k]),
            )
        )
    return sorted(table, key=lambda standing: -standing.score)


@lru_cache(maxsize=8)
def sum_up(tournament: Tournament) -> RoundRobin:
    """Return scores against each other, ratings, and what the game of choosing an agent says, in the plan's order."""
    rows = tournament.rows
    return round_robin(
        tournament.plan.names,
        [row.ego for row in rows],
        [row.opponent for row in rows],
        [row.winner for row in rows],
        [row.crash != "" for row in rows],
        [f"{row.track} {row.race // 2}" for row in rows],  # races 2j and 2j + 1 have the same line
        seed=tournament.plan.seed,
    )


def payoff_matrix(tournament: Tournament) -> NDArray[np.float64]:
    """Return each competitor's score against each other one, shape (N, N), in the order of the plan; else NaN."""
    return sum_up(tournament).scores


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
    known = [not all(np.isnan(getattr(s, name)) for s in table) for name in ("equilibrium", "alpha_rank")]
    rows: list[tuple[str, ...]] = [(*COLUMNS, *compress(META, known))]
    for s in table:
        shares = (f"{share:.1%}" for share in (s.win, s.tie, s.loss, s.own_crash, s.other_crash))
        meta = compress((f"{s.equilibrium:.2f}", f"{s.alpha_rank:.2f}"), known)
        rating = "-" if np.isnan(s.rating) else f"{s.rating:+.0f}"
        interval = "-" if np.isnan(s.rating_low) else f"[{s.rating_low:+.0f}, {s.rating_high:+.0f}]"
        rows.append((s.name, str(s.races), f"{s.score:.3f}", rating, interval, *shares, f"{s.overtakes:.2f}", *meta))
    payoffs = payoff_matrix(tournament)
    order = [plan.names.index(standing.name) for standing in table]
    matrix: list[tuple[str, ...]] = [("score against", *(f"({k + 1})" for k in range(len(order))))]
    matrix += [
        (f"({k + 1}) {plan.names[i]}", *("-" if i == j else f"{payoffs[i, j]:.3f}" for j in order))
        for k, i in enumerate(order)
    ]
    paid = "the car not to blame" if plan.config.crash_rule == "fault-loses" else "nobody"
    note = (
        f"score: races won, a tie counting half; a crash is won by {paid}; rating: Bradley-Terry, 400 are odds of 10, "
        "start lines drawn again for the interval"
    )
    if known[0]:
        note += "\nequilibrium: how often to send whom, if the other side chooses as cleverly"
    if known[1]:
        note += (
            "\nalpha-rank: share of the time that evolution spends at it; scores against each other that differ by up "
            f"to {sum_up(tournament).alike:.3f} count as alike"
        )
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
    from pcs_racing_agents.picture_style import save_picture
    from pcs_racing_agents.tournament.pictures import payoffs_picture

    names = [standing.name for standing in standings(tournament)]
    order = [tournament.plan.names.index(name) for name in names]
    return save_picture(payoffs_picture(names, payoff_matrix(tournament)[np.ix_(order, order)]), path)


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
