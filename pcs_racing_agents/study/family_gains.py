"""The adaptivity gain by family of opponents, pooled over opponents and circuits.

An agent that learned against one kind of opponent may lose to another that it never met. So opponents are sorted into
families, and a family is either for training or for testing: never both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.results.csv_files import csv_cell, write_csv
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.results.text_table import Column, interval_text
from pcs_racing_agents.study.table import matched_scores
from pcs_racing_agents.tournament.statistics import Estimate, clustered_mean

TRAINING, TEST = "training", "test"


@dataclass(frozen=True)
class OpponentFamily:
    """Opponents that drive alike."""

    name: str
    use: str  #: "training" or "test"
    members: tuple[str, ...]  #: Names in the zoo.
    what: str  #: What they have in common.


FAMILIES = (
    OpponentFamily("archive", TRAINING, ("never-switch",), "policies of the game's archive, kept for the whole race"),
    OpponentFamily("random moves", TRAINING, ("random-moves",), "policies of the archive, changed at random"),
    OpponentFamily("gap follower", TRAINING, ("gap-follower",), "follows the largest gap in its lidar scan"),
    OpponentFamily(
        "other lattice",
        TEST,
        ("random-policy",),
        "policies of the lattice planner that are not in the archive",
    ),
    OpponentFamily("lane switcher", TEST, ("lane-switcher",), "race line or overtaking lane"),
    OpponentFamily("pure pursuit", TEST, ("pure-pursuit",), "follows the race line and never overtakes"),
    OpponentFamily("trained driver", TEST, ("ppo-drive",), "a network that steers"),
    OpponentFamily(
        "switching agents",
        TEST,
        ("best-schedule", "best-lead-plan", "cfr-argmax", "response", "robust", "psro", "self-play", "ppo"),
        "agents that choose their moves",
    ),
)
"""All families; each opponent belongs to one."""


def family_of(opponent: str) -> OpponentFamily | None:
    """Return the family of an opponent by name, options left out; None if it belongs to none."""
    name = opponent.partition(":")[0]
    return next((family for family in FAMILIES if name in family.members), None)


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


def family_gains(races: RaceTable, best: str, blind: str) -> list[FamilyGain]:
    """Return the gain of an agent over a blind one, a line for each family, in the order of the families.

    Races that share the ego's start policy, the opponent's variant or the start line form clusters.
    """
    pairs = {(track, opponent, ego): numbers for (track, ego, opponent, _), numbers in races.pairs.items()}
    cells = list(dict.fromkeys((track, opponent) for track, opponent, ego in pairs if ego == best))
    gains = []
    for family in FAMILIES:
        own = [
            (track, opponent)
            for track, opponent in cells
            if family_of(opponent) is family and (track, opponent, blind) in pairs and opponent not in (best, blind)
        ]
        if not own:
            continue
        tracks, opponents = (tuple(dict.fromkeys(words)) for words in zip(*own, strict=True))
        differences, labels = [], []
        for track, opponent in own:
            first, second = (races.take(pairs[track, opponent, arm]) for arm in (best, blind))
            differences.append(first.score - matched_scores(first, second, f"{track} against {opponent}"))
            place = (np.full(len(first), opponents.index(opponent)), np.full(len(first), tracks.index(track)))
            labels.append(np.column_stack([first.variants, *place, first.start_s.round(4)]))
        # Races are pooled, not gains of rows: a row with few races must not count as much as one with many.
        gain = _estimate(np.concatenate(differences), np.concatenate(labels))
        numbers = (gain.units, gain.mean, gain.low, gain.high, gain.se, gain.df)
        gains.append(FamilyGain(family.name, family.use, opponents, tracks, *numbers))
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
