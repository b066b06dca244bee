"""A tournament as text and as files: the table of the competitors, the payoff matrix, and a line for every race."""

import csv
import io
import os
from array import array
from collections.abc import Iterable
from functools import lru_cache
from itertools import compress
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.tournament.play import Tournament
from pcs_racing_agents.tournament.round_robin import RoundRobin, round_robin
from pcs_racing_agents.tournament.rows import RaceRow, start_label

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
    together, races = sum_up(tournament), _counted(tournament)
    clean, tied = ~races.crashed & (races.winner >= 0), ~races.crashed & (races.winner < 0)
    for k, name in enumerate(tournament.plan.names):
        own = [races.cars[car] == k for car in range(2)]  # the races in which it drove that car

        def count(*where: NDArray[np.bool_], own: list[NDArray[np.bool_]] = own) -> int:
            """In how many of its races something holds: of its own car, or of the race."""
            return sum(int(np.count_nonzero(own[car] & where[car % len(where)])) for car in range(2))

        total, won, ties = count(own[0] | own[1]), count(*(races.winner == car for car in range(2))), count(tied)
        wins = count(*(clean & (races.winner == car) for car in range(2)))
        crashes, blamed = count(races.crashed), count(*(races.fault >> car & 1 > 0 for car in range(2)))
        passes = sum(int(races.overtakes[car][own[car]].sum()) for car in range(2))
        share = 1.0 / total
        rating, low, high = together.rating(name)
        table.append(
            Standing(
                name=name,
                races=total,
                score=share * (won + 0.5 * ties),
                rating=rating,
                win=share * wins,
                tie=share * ties,
                loss=share * (total - wins - ties - crashes),
                own_crash=share * blamed,
                other_crash=share * (crashes - blamed),
                overtakes=share * passes,
                rating_low=low,
                rating_high=high,
                equilibrium=np.nan if together.equilibrium is None else float(together.equilibrium[k]),
                alpha_rank=np.nan if together.alpha_rank is None else float(together.alpha_rank[k]),
            )
        )
    return sorted(table, key=lambda standing: -standing.score)


class _Counted(NamedTuple):
    """What the tables count in N races.

    Attributes
    ----------
    cars : ndarray, shape (2, N)
        Places in the plan of the competitors in car 0 and car 1.
    winner : ndarray, shape (N,)
        The car that won; -1 where none did.
    crashed : ndarray, shape (N,)
    fault : ndarray, shape (N,)
        Bit ``k`` is set where car ``k`` is to blame.
    overtakes : ndarray, shape (2, N)
    line : list of str, length N
        Labels of the start lines, each kept once.
    """

    cars: NDArray[np.int64]
    winner: NDArray[np.int64]
    crashed: NDArray[np.bool_]
    fault: NDArray[np.int64]
    overtakes: NDArray[np.int64]
    line: list[str]


@lru_cache(maxsize=8)
def _counted(tournament: Tournament) -> _Counted:
    """Go through the races once: there may be many of them, and each line is made anew."""
    place = {name: k for k, name in enumerate(tournament.plan.names)}
    winners, faults = {"ego": 0, "opponent": 1, "": -1}, {"": 0, "ego": 1, "opponent": 2, "both": 3}
    numbers, line = array("q"), []
    labels: dict[str, str] = {}
    for row in tournament.rows:
        if row.ego not in place or row.opponent not in place:
            stranger = row.opponent if row.ego in place else row.ego
            raise InputError(f"{stranger!r} raced, but is not one of {', '.join(place)}")
        numbers.extend((place[row.ego], place[row.opponent], winners[row.winner], row.crash != "", faults[row.fault]))
        numbers.extend((row.ego_overtakes, row.opponent_overtakes))
        label = start_label(row.track, row.start_s)
        line.append(labels.setdefault(label, label))
    found = np.frombuffer(numbers, np.int64).reshape(-1, 7).T
    return _Counted(found[:2], found[2], found[3] > 0, found[4], found[5:7], line)


@lru_cache(maxsize=8)
def sum_up(tournament: Tournament) -> RoundRobin:
    """Return scores against each other, ratings, and what the game of choosing an agent says, in the plan's order."""
    names, races = tournament.plan.names, _counted(tournament)
    return round_robin(
        names,
        [names[k] for k in races.cars[0].tolist()],
        [names[k] for k in races.cars[1].tolist()],
        [("ego", "opponent", "")[k] for k in races.winner.tolist()],
        races.crashed.tolist(),
        races.line,
        seed=tournament.plan.seed,
    )


def payoff_matrix(tournament: Tournament) -> NDArray[np.float64]:
    """Return each competitor's score against each other one, shape (N, N), in the order of the plan; else NaN."""
    return sum_up(tournament).scores


def tournament_text(tournament: Tournament) -> str:
    """Return the table and the payoff matrix for people."""
    table = standings(tournament)
    races, counted = len(tournament.rows), _counted(tournament)
    crashes, passed = int(counted.crashed.sum()), int(counted.overtakes.any(axis=0).sum())
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
    from pcs_racing_agents.pictures.style import save_picture
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

    def write(file: IO[bytes]) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("preset", *RaceRow._fields))
        writer.writerows((preset, *map(_plain, row)) for row in rows)
        text.detach()

    write_atomically(Path(path), write)
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
