"""Score of an agent over its races, with an interval."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.base.statistics import clustered_mean, varied
from pcs_racing_agents.base.tables import Column
from pcs_racing_agents.tournament.races import RaceTable


class Score(NamedTuple):
    """Results of an agent as shares of its races."""

    races: int
    #: Races won plus half of the ties. A crash is a no-contest under the crash rule ``nobody``, and
    #: a win of the car without fault under ``fault-loses``.
    mean: float
    #: ``low``, ``high``: 95 % interval for these opponents and tracks, robust to clusters of start
    #: places and start policies.
    low: float
    high: float
    #: ``own_crash``, ``other_crash``: Races with a crash by own fault (or by both cars' fault), or
    #: only by the opponent's fault.
    own_crash: float
    other_crash: float

    @property
    def interval(self) -> str:
        """Interval as text."""
        return "-" if np.isnan(self.low) else f"[{self.low:.3f}, {self.high:.3f}]"


SCORE_COLUMNS = (
    Column("score.mean", "score", ".3f"),
    Column("score.interval", "95 %"),
    Column("score.own_crash", "own crashes", ".1%"),
    Column("score.other_crash", "others'", ".1%"),
)
"""Columns of a table whose lines have a ``score``."""


def score_races(races: RaceTable, scored: RaceTable | None = None) -> Score:
    """Return the score of the egos of some races.

    ``scored``: units of the score, if other than the races (series under "best of" rules).
    """
    units = races if scored is None else scored
    mean, low, high = clustered_score(units, units.score)
    own = races.fault[:, 0] > 0
    return Score(
        len(races),
        mean,
        max(low, 0.0),
        min(high, 1.0),
        float((races.crashed & own).mean()),
        float((races.crashed & ~own).mean()),
    )


def clustered_score(races: RaceTable, values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the mean of a value of each race, and both ends of its 95 % interval.

    The interval is about these opponents and tracks: differences between their means do not widen
    it. Clusters are start places and start policies. A single race has no interval: NaN.
    """
    if len(races) == 1:
        return float(values[0]), np.nan, np.nan
    met = np.stack([races.agents.codes[:, 1], races.track.codes])
    against = np.unique(met, axis=1, return_inverse=True)[1].reshape(-1)
    means = np.bincount(against, values) / np.bincount(against)
    variants = np.stack([races.agents.codes[:, 1], races.variants[:, 1]])
    rivals = np.unique(variants, axis=1, return_inverse=True)[1].reshape(-1)
    clusters = varied(races.places, races.variants[:, 0], rivals)
    mean = float(values.mean())
    return mean, *clustered_mean(values - means[against] + mean, *clusters)[1:3]
