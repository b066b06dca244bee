"""Tables of a tournament: standings and payoff matrix, as values and text."""

from typing import NamedTuple

import numpy as np

from pcs_racing.race.config import RaceConfig
from pcs_racing_agents.base.tables import Column, aligned, table_rows
from pcs_racing_agents.tournament.play import Tournament
from pcs_racing_agents.tournament.races import closeness_text
from pcs_racing_agents.tournament.ratings import agents_of

COLUMNS = (
    Column("name", "agent"),
    Column("races"),
    Column("score", format=".3f"),
    Column("rating", format="+.0f"),
    Column("interval", "95 %"),
    Column("win", format=".1%"),
    Column("tie", format=".1%"),
    Column("loss", format=".1%"),
    Column("own_crash", "crash: own", ".1%"),
    Column("other_crash", "other's", ".1%"),
    Column("overtakes", format=".2f"),
)
EQUILIBRIUM = Column("equilibrium", format=".2f")


class Standing(NamedTuple):
    """Results of a competitor as shares of its races; the five shares from ``win`` on sum to 1."""

    name: str
    races: int
    #: Share of races won plus half of the ties. A crash is a no-contest under the crash rule
    #: ``nobody``, and a win of the car without fault under ``fault-loses``.
    score: float
    #: ``rating``, ``rating_low``, ``rating_high``: Bradley-Terry strength on the scale of chess
    #: ratings, mean 0, and its 95 % interval; NaN if it can't be estimated.
    rating: float
    win: float  #: ``win``, ``tie``, ``loss``: Races without a crash.
    tie: float
    loss: float
    #: ``own_crash``, ``other_crash``: Races with a crash by own fault (or by both cars' fault), or
    #: only by the opponent's fault.
    own_crash: float
    other_crash: float
    overtakes: float  #: Mean number of own overtakes per race.
    rating_low: float
    rating_high: float
    #: Probability of the competitor in an equilibrium of the meta-game
    #: (:class:`pcs_racing_agents.tournament.ratings.RoundRobin`); NaN if unknown.
    equilibrium: float

    @property
    def interval(self) -> str:
        """Interval of the rating as text."""
        return rating_interval(self.rating_low, self.rating_high)


def rating_interval(low: float, high: float) -> str:
    """Return the interval of a rating as text."""
    return "-" if np.isnan(low) else f"[{low:+.0f}, {high:+.0f}]"


def standings(tournament: Tournament) -> list[Standing]:
    """Return the standings of a tournament, highest score first."""
    table = []
    together, races = tournament.summary, tournament.races
    drove = agents_of(tournament.plan.names, races)
    series = agents_of(tournament.plan.names, tournament.series)
    scored = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])[tournament.series.winner]
    # A no-contest is no tie.
    scored[tournament.series.crashed & (tournament.series.winner < 0)] = 0.0
    # Conditions on a car have shape (N, 2), conditions on a race (N, 1).
    winner, crashed = races.winner[:, None] == np.arange(2), races.crashed[:, None]
    clean, blamed = ~crashed, races.fault > 0
    shares = {
        "win": clean & winner,
        "tie": races.tie[:, None],
        "loss": clean & winner[:, ::-1],
        "own_crash": blamed,
        "other_crash": crashed & ~blamed,
    }
    for k, name in enumerate(tournament.plan.names):
        own = drove == k
        rating, low, high = together.rating(name)
        standing = Standing(
            name=name,
            races=int(np.count_nonzero(own)),
            score=float(scored[series == k].mean()),
            rating=rating,
            rating_low=low,
            rating_high=high,
            overtakes=float(races.overtakes[own].mean()),
            equilibrium=np.nan if together.equilibrium is None else together.equilibrium[k],
            **{
                share: float(np.broadcast_to(condition, own.shape)[own].mean())
                for share, condition in shares.items()
            },
        )
        table.append(standing)
    return sorted(table, key=lambda standing: -standing.score)


def race_length(config: RaceConfig) -> str:
    """Return the length of a race as text."""
    seconds = f"{config.seconds:g} s"
    return seconds if config.laps is None else f"{config.laps} laps (at most {seconds})"


def tournament_text(tournament: Tournament) -> str:
    """Return the standings and the payoff matrix as text."""
    table = standings(tournament)
    races = len(tournament.races)
    crashes = int(tournament.races.crashed.sum())
    passed = int(tournament.races.overtakes.any(axis=1).sum())
    plan = tournament.plan
    head = (
        f"{races} races of {race_length(plan.config)}, preset {plan.config.name}, on "
        f"{', '.join(track.name for track in plan.tracks)}; seed {plan.seed}\n"
        f"{1.0 - crashes / races:.0%} finished, {passed / races:.0%} with an overtake\n"
        f"{closeness_text(tournament.races)}\n"
    )
    has_equilibrium = tournament.summary.equilibrium is not None
    columns = (*COLUMNS, EQUILIBRIUM) if has_equilibrium else COLUMNS
    payoffs = tournament.summary.scores
    order = [plan.names.index(standing.name) for standing in table]
    matrix: list[tuple[str, ...]] = [("score against", *(f"({k + 1})" for k in range(len(order))))]
    matrix += [
        (f"({k + 1}) {plan.names[i]}", *("-" if i == j else f"{payoffs[i, j]:.3f}" for j in order))
        for k, i in enumerate(order)
    ]
    paid = "the car not to blame" if plan.config.crash_rule == "fault-loses" else "no car"
    note = (
        f"score: {'races' if plan.config.heats == 1 else f'best of {plan.config.heats}'} won, a tie"
        f" counting half; a crash is won by {paid}; rating: Bradley-Terry, 400 are odds of 10,"
        " start lines drawn again for the interval"
    )
    if has_equilibrium:
        note += "\nequilibrium: probability of each agent in the game of choosing an agent"
    return "\n".join(
        [
            head,
            *aligned(table_rows(columns, table), left=1),
            "",
            *aligned(matrix, left=1),
            "",
            note,
        ]
    )
