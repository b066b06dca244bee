"""Evaluations of a learner: race scores, their means, and the learning curve as a CSV file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.state import RaceState
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.tables import aligned, write_csv


class Matchup(NamedTuple):
    """Races of an evaluation with the same track, rules and opponent."""

    track: str  #: ``track``, ``race``, ``opponent``: Names of track, rules and opponent.
    race: str
    opponent: str


class MatchupScore(NamedTuple):
    """Result of the races of a matchup.

    The shares add up to 1 together with ties and crashes without a winner.
    """

    races: int
    #: Mean payoff. In duels: the utility of a game. In drives: 1 for a win, -1 for a loss or a
    #: crash by own fault.
    worth: float  # the name in the files of shipped networks
    error: float  #: Standard error of ``worth``.
    won: float  #: ``won``, ``lost``: Shares of the races.
    lost: float
    crashed: float  #: Share of races with a crash.
    fault: float  #: Share of races with a crash caused by the learner.
    lead: float  #: Mean lead at the end, m.


def score_races(
    payoffs: NDArray[np.float64], winner: NDArray[np.int8], race: RaceState
) -> MatchupScore:
    """Return the score of races.

    ``payoffs``, ``winner``: shape (B,), winner 0 is the learner. ``race``: final states.
    """
    count = len(payoffs)
    return MatchupScore(
        races=count,
        worth=float(np.mean(payoffs)),
        error=float(np.std(payoffs, ddof=1) / np.sqrt(count)) if count > 1 else float("nan"),
        won=float(np.mean(winner == 0)),
        lost=float(np.mean(winner == 1)),
        crashed=float(np.mean(race.crashed)),
        fault=float(np.mean(race.fault[:, 0] == 1)),
        lead=float(np.mean(race.lead)),
    )


def mean_score(scores: Mapping[Matchup, MatchupScore], weights: Mapping[str, int]) -> MatchupScore:
    """Return the mean over matchups, weighted by the frequency of each opponent."""
    shares = np.array([weights[matchup.opponent] for matchup in scores], np.float64)
    shares /= shares.sum()
    rows = np.array([score[1:] for score in scores.values()])
    means = dict(zip(MatchupScore._fields[1:], (shares @ rows).tolist(), strict=True))
    # Races of different matchups are independent: their variances add up.
    means["error"] = float(
        np.sqrt(np.sum((shares * rows[:, MatchupScore._fields.index("error") - 1]) ** 2))
    )
    return MatchupScore(sum(score.races for score in scores.values()), **means)


def score_table(scores: Mapping[Matchup, MatchupScore], weights: Mapping[str, int]) -> str:
    """Return a text table: a line for each track and rules (mean over opponents), and a total."""
    table = [["", "payoff", "+-", "won", "lost", "crashed", "at fault", "lead"]]
    groups = list(dict.fromkeys((matchup.track, matchup.race) for matchup in scores))
    for group in [*groups, None]:
        mean = mean_score(
            {matchup: score for matchup, score in scores.items() if group in (None, matchup[:2])},
            weights,
        )
        shares = [f"{share:.1%}" for share in (mean.won, mean.lost, mean.crashed, mean.fault)]
        name = " ".join(group) if group else "all"
        table.append(
            [name, f"{mean.worth:.3f}", f"{mean.error:.3f}", *shares, f"{mean.lead:.1f} m"]
        )
    return "\n".join(aligned(table, left=1))


# Learning curves


EVALUATION_COLUMNS = ("seed", "steps", *Matchup._fields, *MatchupScore._fields)


class EvaluationCurve(NamedTuple):
    """Learning curve: all evaluations of a learner with one seed."""

    seed: int
    steps: tuple[int, ...]  #: Training steps before each evaluation.
    scores: tuple[Mapping[Matchup, MatchupScore], ...]  #: Result of each evaluation.


def write_evaluations(curves: Sequence[EvaluationCurve], file: Path) -> Path:
    """Write a line for each seed, evaluation, track, rules and opponent."""
    rows: list[tuple[object, ...]] = [EVALUATION_COLUMNS]
    for curve in curves:
        for steps, scores in zip(curve.steps, curve.scores, strict=True):
            for matchup, score in scores.items():
                figures = (score.races, *(f"{value:.6g}" for value in score[1:]))
                rows.append((curve.seed, steps, *matchup, *figures))
    return write_csv(rows, file)


def evaluation_curves(
    curves: Sequence[EvaluationCurve], weights: Mapping[str, int]
) -> dict[str, list[Curve]]:
    """Return panels of payoffs, wins and own crashes over millions of steps, one line per seed."""
    panels: dict[str, list[Curve]] = {}
    for key, title in (
        ("worth", "payoff of a race"),
        ("won", "races won"),
        ("fault", "crashes by own fault"),
    ):
        for curve in curves:
            means = [mean_score(scores, weights) for scores in curve.scores]
            error = np.array([mean.error for mean in means]) if key == "worth" else None
            steps, values = (
                np.array(curve.steps) / 1e6,
                np.array([getattr(mean, key) for mean in means]),
            )
            panels.setdefault(title, []).append(Curve(steps, values, f"seed {curve.seed}", error))
    return panels
