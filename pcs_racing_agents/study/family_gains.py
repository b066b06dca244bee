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

from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.results.text_table import interval_text
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


FAMILY_HEAD = ("family", "used for", "opponents", "circuits", "races", "gain", "95 % interval")
COLUMNS = ("family", "use", "opponents", "tracks", "races", "gain", "low", "high", "se", "df")


class FamilyGain(NamedTuple):
    """The gain of one agent over another against a family."""

    family: OpponentFamily
    opponents: tuple[str, ...]  #: ``opponents``, ``tracks``: Those of the table.
    tracks: tuple[str, ...]
    gain: Estimate  #: Mean difference of score over all races; every race counts the same.


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
        gain = _estimate(np.concatenate(differences), np.concatenate(labels))
        gains.append(FamilyGain(family, opponents, tracks, gain))
    return gains


def _estimate(differences: NDArray[np.float64], labels: NDArray[np.float64]) -> Estimate:
    """Cluster by the ego's variant, by the variant of the opponent and by the start line of the circuit."""
    columns = ([0], [2, 1], [3, 4])
    kinds = [np.unique(labels[:, own], axis=0, return_inverse=True)[1].reshape(-1) for own in columns]
    return clustered_mean(differences, *(codes for codes in kinds if codes.max() > 0))


def family_rows(gains: Sequence[FamilyGain]) -> list[tuple[str, ...]]:
    """Return the lines of the table in the columns :data:`FAMILY_HEAD`."""
    return [
        (
            gain.family.name,
            gain.family.use,
            ", ".join(gain.opponents),
            ", ".join(gain.tracks),
            str(gain.gain.units),
            f"{gain.gain.mean:+.3f}",
            interval_text(gain.gain.low, gain.gain.high),
        )
        for gain in gains
    ]


def write_family_gains(gains: Sequence[FamilyGain], path: Path) -> Path:
    """Write a line for each family as CSV."""
    lines: list[tuple[object, ...]] = [COLUMNS]
    for family, opponents, tracks, gain in gains:
        numbers = [f"{value:.6g}" for value in (gain.mean, gain.low, gain.high, gain.se)]
        lines.append((family.name, family.use, "; ".join(opponents), "; ".join(tracks), gain.units, *numbers, gain.df))
    return write_csv(lines, path)
