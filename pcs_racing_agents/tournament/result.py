"""Result of a tournament: scores with intervals, ratings, equilibrium; as text and as a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.base.style import COLOURS, EDGE, INK, new_figure, picture, short, tidy
from pcs_racing_agents.base.tables import Column, aligned, table_rows
from pcs_racing_agents.tournament.pairings import Pairing, Recording, play_pairings, repeat_race
from pcs_racing_agents.tournament.plan import (
    Circuit,
    Entrant,
    Rules,
    TournamentPlan,
    plan_tournament,
)
from pcs_racing_agents.tournament.races import (
    RaceRow,
    RaceTable,
    closeness_text,
    concatenate_races,
    series_of,
)
from pcs_racing_agents.tournament.ratings import RoundRobin, round_robin
from pcs_racing_agents.tournament.scores import SCORE_COLUMNS, Score, score_races


class Standing(NamedTuple):
    """Results of a competitor."""

    name: str
    score: Score
    #: ``rating``, ``rating_low``, ``rating_high``: Bradley-Terry strength on the scale of chess
    #: ratings, mean 0, and its 95 % interval; NaN if it can't be estimated.
    rating: float
    rating_low: float
    rating_high: float
    equilibrium: float  #: Probability in the equilibrium of the meta-game; NaN if unknown.

    @property
    def rating_interval(self) -> str:
        """Interval of the rating as text."""
        low, high = self.rating_low, self.rating_high
        return "-" if np.isnan(low) else f"[{low:+.0f}, {high:+.0f}]"


@dataclass(frozen=True, eq=False)
class Tournament:
    """Played tournament; ``print`` shows its table, :meth:`plot` draws it."""

    plan: TournamentPlan
    races: RaceTable

    @cached_property
    def series(self) -> RaceTable:
        """Scored units: the races, or series of races."""
        return series_of(self.races, self.plan.rules)

    @cached_property
    def summary(self) -> RoundRobin:
        """Scores against each other, ratings and equilibrium, in the plan's order."""
        return round_robin(self.plan.names, self.series, seed=self.plan.seed)

    @property
    def scores(self) -> NDArray[np.float64]:
        """Score of the row's competitor against the column's, shape (N, N); NaN on the diagonal."""
        return self.summary.scores

    @property
    def pairings(self) -> tuple[Pairing, ...]:
        """Races of all pairs on the first track, then of all pairs on the next track, etc."""
        return self.plan.pairings

    @cached_property
    def standings(self) -> tuple[Standing, ...]:
        """Results of the competitors, highest score first."""
        found, summary = [], self.summary
        for k, name in enumerate(self.plan.names):
            score = score_races(self.races.seen_by(name), self.series.seen_by(name))
            chance = np.nan if summary.equilibrium is None else float(summary.equilibrium[k])
            found.append(Standing(name, score, *summary.rating(name), chance))
        return tuple(sorted(found, key=lambda one: -one.score.mean))

    def record(self, row: RaceRow, *, candidates: bool = True) -> Recording:
        """Repeat one of the races, and record it; with the candidate paths of the planners."""
        for pairing in self.pairings:
            if (pairing.game.track.name, *pairing.names) == (row.track, row.ego, row.opponent):
                return repeat_race(pairing, row.race, candidates=candidates)
        raise InputError(
            f"race {row.race} of {row.ego!r} against {row.opponent!r} on {row.track!r} was not"
            " raced here"
        )

    def __str__(self) -> str:
        """Show the standings and the scores against each other."""
        config, races = self.plan.rules, self.races
        length = f"{config.seconds:g} s"
        if config.laps is not None:
            length = f"{config.laps} laps (at most {length})"
        tracks = ", ".join(track.name for track in self.plan.tracks)
        series = f" in {len(self.series)} series" if config.heats > 1 else ""
        passed = races.overtakes.any(axis=1).mean()
        head = (
            f"{tracks}, rules {config.name}, seed {self.plan.seed}: {len(races)} races of"
            f" {length}{series},"
            f" {1.0 - races.crashed.mean():.0%} without a crash, {passed:.0%} with an overtake"
        )
        numbers = [f"({k + 1})" for k in range(len(self.standings))]
        order = [self.plan.names.index(one.name) for one in self.standings]
        matrix = [("score against", *numbers)]
        for number, i in zip(numbers, order, strict=True):
            cells = ("-" if i == j else f"{self.scores[i, j]:.3f}" for j in order)
            matrix.append((f"{number} {self.plan.names[i]}", *cells))
        paid = "the car not to blame" if config.crash_rule == "fault-loses" else "no car"
        won = "races" if config.heats == 1 else f"best of {config.heats}"
        notes = [f"score: {won} won, a tie counting half; a crash is won by {paid}"]
        if config.legs == 2:
            notes = [
                "score: series won by the sum of both legs, a tie counting half; a fault costs"
                f" {config.fault_penalty:g} m"
            ]
        columns = [Column("name", "agent"), Column("score.races", "races"), *SCORE_COLUMNS]
        if self.summary.ratings is not None:
            columns += [Column("rating", format="+.0f"), Column("rating_interval", "95 %")]
            notes.append("rating: Bradley-Terry, 400 are odds of 10")
        if self.summary.equilibrium is not None:
            columns.append(Column("equilibrium", format=".2f"))
            notes.append("equilibrium: probability of each agent in the game of choosing an agent")
        table = aligned(table_rows(columns, self.standings), left=1)
        notes.append(closeness_text(races))
        return "\n".join([head, *table, "", *aligned(matrix, left=1), "", *notes])

    def plot(self) -> Any:
        """Return a matplotlib figure of the scores, with intervals and against each other."""
        return tournament_picture(self)


@picture
def tournament_picture(result: Tournament) -> Any:
    """Draw scores with their intervals, and the score matrix: purple above one half, orange below.

    The best competitor is on top.
    """
    standings = result.standings
    count, size = len(standings), 0.58 * len(standings)
    order = [result.plan.names.index(one.name) for one in standings]
    scores = result.scores[np.ix_(order, order)]
    labels = [short(one.name) for one in standings]
    figure = new_figure(size + 5.4, size + 1.4)
    means, matrix = figure.subplots(1, 2, width_ratios=(3.0, max(size, 1.2)))
    means.axvline(0.5, color=EDGE, lw=1.0)
    for k, one in enumerate(standings):
        means.plot([one.score.low, one.score.high], [k, k], color=COLOURS[0], lw=2.0)
        means.plot(one.score.mean, k, "o", color=COLOURS[0], ms=6)
    means.set_yticks(range(count), labels)
    means.set_ylim(count - 0.5, -0.5)
    means.set_xlabel("score, 95 % intervals")
    tidy(means, "x")
    image = matrix.imshow(scores, cmap="PuOr", vmin=-0.15, vmax=1.15)
    for (i, j), value in np.ndenumerate(scores):
        if not np.isnan(value):
            # Perceived lightness of the cell (ITU-R BT.601): white digits on dark cells.
            dark = image.cmap(image.norm(value))[:3] @ np.array([0.299, 0.587, 0.114]) < 0.5
            place = {"ha": "center", "va": "center", "fontsize": 8}
            matrix.text(j, i, f"{value:.2f}", color="white" if dark else INK, **place)
    matrix.set_xticks(range(count), labels, rotation=40, ha="left", rotation_mode="anchor")
    matrix.xaxis.tick_top()
    matrix.set_yticks([])
    matrix.tick_params(length=0)
    matrix.spines[:].set_visible(False)
    matrix.set_xlabel("score of the row's agent against the column's")
    return figure


def play_tournament(
    tracks: Circuit | Sequence[Circuit],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    rules: Rules | str | Path = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    like: Any = None,
    **run: Unpack[Run],
) -> Tournament:
    """Play every pair of competitors against each other; ``print`` shows the table of the result.

    All pairs drive the same races (common random numbers): the same start lines, spread over the
    track, each from both sides, with the same start policies and the same noise.

    Parameters
    ----------
    tracks : Track, name or path, or a sequence of them
    entrants : sequence, or mapping by name
        At least two texts or objects (:func:`pcs_racing.racer`), with different names.
    rules : Rules, str or path
        Rules; their ``start_lines`` is not used, since every two races draw their own line.
    races_per_pair : int
        Number of races of each pair on each track; even, from 2 to 2000.
    seed : int
        Seed of start lines, start policies and noise, and of the draws of agents given by name.
    like : str, mapping or environment, optional
        Training environment of models that do not hold its arguments (:func:`pcs_racing.racer`).
    **run
        ``job``, ``executor``, ``progress`` as for
        :func:`pcs_racing_agents.tournament.play_pairings`; open a job with
        :func:`tournament_settings`.
    """
    plan = plan_tournament(
        tracks,
        entrants,
        rules,
        archive=archive,
        races_per_pair=races_per_pair,
        seed=seed,
        like=like,
    )
    return play_plan(plan, **run)


def play_plan(plan: TournamentPlan, **run: Unpack[Run]) -> Tournament:
    """Play a planned tournament; see :func:`play_tournament`."""
    return Tournament(plan, concatenate_races(play_pairings(plan.pairings, **run)))
