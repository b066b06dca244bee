"""The adaptivity gain by opponent, pooled over circuits, and over all drivers that were met or held out.

An agent that learned against one kind of opponent may lose to another that it never met.
"""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.planners.registry import planner_names
from pcs_racing_agents.base.tables import Column, csv_cell, interval_text, write_csv
from pcs_racing_agents.study.table import matched_scores
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.statistics import Estimate, clustered_mean

TRAINING, TEST = "training", "test"


def families(opponents: Sequence[str], trained: Collection[str]) -> Iterator[tuple[str, str, list[str]]]:
    """Yield a name, a use and the members of each family: every opponent, then all drivers of each use together."""
    drives = planner_names()
    used = {name: TRAINING if name in trained else TEST for name in opponents}
    yield from ((name, use, [name]) for name, use in used.items())
    for use, name in ((TRAINING, "drivers that were met"), (TEST, "drivers held out")):
        drivers = [one for one in opponents if used[one] == use and one.partition(":")[0] in drives]
        if len(drivers) > 1:
            yield name, use, drivers


class FamilyGain(NamedTuple):
    """The gain of one agent over another against a family: mean difference of score over all races."""

    family: str
    use: str
    opponents: tuple[str, ...]  #: ``opponents``, ``tracks``: Those of the table.
    tracks: tuple[str, ...]
    races: int
    gain: float  #: Every race counts the same.
    low: float
    high: float
    se: float
    df: int

    @property
    def interval(self) -> str:
        """Interval of the gain as text."""
        return interval_text(self.low, self.high)


COLUMNS = (
    Column("family"),
    Column("use", "used for"),
    Column("opponents"),
    Column("tracks", "circuits"),
    Column("races"),
    Column("gain", format="+.3f"),
    Column("interval", "95 % interval"),
)


def family_gains(races: RaceTable, best: str, open_loop: str, trained: Collection[str] = ()) -> list[FamilyGain]:
    """Return the gain of an agent over a baseline, a line for each of :func:`families`.

    ``trained`` are the opponents that were met in training.

    Races that share the ego's start policy, the opponent's variant or the start line form clusters.
    """
    pairs = {(track, opponent, ego): numbers for (track, ego, opponent, _), numbers in races.pairs.items()}
    cells = list(dict.fromkeys((track, opponent) for track, opponent, ego in pairs if ego == best))
    gains = []
    against = list(dict.fromkeys(opponent for _, opponent in cells if opponent not in (best, open_loop)))
    for name, use, members in families(against, trained):
        own = [
            (track, opponent)
            for track, opponent in cells
            if opponent in members and (track, opponent, open_loop) in pairs
        ]
        if not own:
            continue
        tracks, opponents = (tuple(dict.fromkeys(words)) for words in zip(*own, strict=True))
        differences, labels = [], []
        for track, opponent in own:
            first, second = (races.take(pairs[track, opponent, arm]) for arm in (best, open_loop))
            differences.append(first.score - matched_scores(first, second, f"{track} against {opponent}"))
            place = (np.full(len(first), opponents.index(opponent)), np.full(len(first), tracks.index(track)))
            labels.append(np.column_stack([first.variants, *place, first.start_s.round(4)]))
        # Races are pooled, not gains of rows: a row with few races must not count as much as one with many.
        gain = _estimate(np.concatenate(differences), np.concatenate(labels))
        numbers = (gain.units, gain.mean, gain.low, gain.high, gain.se, gain.df)
        gains.append(FamilyGain(name, use, opponents, tracks, *numbers))
    return gains


def _estimate(differences: NDArray[np.float64], labels: NDArray[np.float64]) -> Estimate:
    """Cluster by the ego's variant, by the variant of the opponent and by the start line of the circuit."""
    # A variant is one of its opponent's and a line one of its circuit's: equal numbers of two are different clusters.
    columns = ([0], [2, 1], [3, 4])
    kinds = [np.unique(labels[:, own], axis=0, return_inverse=True)[1].reshape(-1) for own in columns]
    return clustered_mean(differences, *(codes for codes in kinds if codes.max() > 0))


def write_family_gains(gains: Sequence[FamilyGain], path: Path) -> Path:
    """Write a line for each family as CSV."""
    return write_csv([FamilyGain._fields, *(map(csv_cell, gain) for gain in gains)], path)
