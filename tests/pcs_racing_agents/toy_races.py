"""Races of a study whose truth is known: drawn, not driven; and a table of round numbers."""

import numpy as np

from pcs_racing_agents.base.statistics import Comparison
from pcs_racing_agents.study.table import PAPER_TABLE, ArmResult, Difference, StudyTable, TableRow
from pcs_racing_agents.tournament.races import Categorical, RaceTable, concatenate_races

STRENGTHS = {"never-switch": 0.0, "best-fixed": 0.5, "cfr-argmax": 0.6, "our-best": 1.1}


def toy_races(
    tracks=("Tarnfjord", "Brackwater"),
    opponents=("never-switch", "random-policy", "somebody"),
    strengths=STRENGTHS,
    egos=12,
    variants=10,
    lines=5,
    seed=0,
) -> RaceTable:
    """All arms in the same races; some of them end in a crash that pays neither."""
    rng = np.random.default_rng(seed)
    tables = []
    grid = np.meshgrid(
        np.arange(egos), np.arange(variants), np.arange(lines), np.arange(2), indexing="ij"
    )
    ego, opponent, line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    for track in tracks:
        for rival in opponents:
            luck = rng.normal(size=len(ego)) + 0.5 * rng.normal(size=egos)[ego]
            for arm, strength in strengths.items():
                lead = luck + strength + 0.5 * rng.normal(size=len(ego))
                crash = rng.random(len(ego)) < 0.1
                own = crash & (rng.random(len(ego)) < 0.5)
                tables.append(
                    _table(
                        track,
                        arm,
                        rival,
                        lead,
                        crash,
                        own,
                        np.stack([ego, opponent], 1),
                        line,
                        side,
                    )
                )
    return concatenate_races(tables)


def of(races: RaceTable, track: str, opponent: str, arm: str) -> RaceTable:
    """The races of one arm in one row."""
    return races.take(races.pairs[track, arm, opponent, "0"])


def _table(track, arm, rival, lead, crash, own, variants, line, side) -> RaceTable:
    count = len(lead)
    nothing = np.full((count, 2, 0), -1, np.int8)
    return RaceTable(
        preset=Categorical.constant("paper", count),
        agents=Categorical.concatenate(
            [Categorical.constant(name, count) for name in (arm, rival)], axis=1
        ),
        track=Categorical.constant(track, count),
        race=np.arange(count),
        start_s=line.astype(float),
        side=side,
        seed=Categorical.constant("0", count),
        lead=lead,
        winner=np.where(crash, -1, np.where(lead > 0.0, 0, 1)),
        crash=2 * crash,
        fault=np.stack([own, crash & ~own], axis=1).astype(np.int8),
        overtakes=np.zeros((count, 2), np.int8),
        duration=np.full(count, 40.0),
        variants=variants,
        path=nothing,
        moves=Categorical((), nothing),
        best_laps=np.full((count, 2), -1.0),
    )


def toy_difference(arm, base, a, b, reach, p, p_holm) -> Difference:
    """Return the difference of two arms, with half the length of its interval and its p-values."""
    difference = a - b
    ends = (difference - reach, difference + reach)
    counts = {"units": 8, "egos": 2, "opponents": 4}
    result = Comparison(
        a, b, difference, *ends, reach / 2.0, 3, p, p / 10.0, 8 * difference, **counts
    )
    return Difference(arm, base, result, p_holm)


def toy_table() -> StudyTable:
    """Two rows: all three arms with the paper's figures, and two arms without, with other numbers
    of races.
    """
    still = ArmResult("still", 8, 0.5, 0.25, 0.75, 0.125, 0.25, 0.125)
    ours = ArmResult("ours", 8, 0.75, 0.5, 1.0, 0.0625, 0.5, 0.0)
    plan = ArmResult("cfr-argmax", 8, 0.625, 0.5, 0.75, 0.0, 0.0, 0.0)
    differences = (
        toy_difference("ours", "still", 0.75, 0.5, 0.125, 0.0025, 0.005),
        toy_difference("cfr-argmax", "still", 0.625, 0.5, 0.25, 0.5, 0.5),
    )
    gain = toy_difference("ours", "cfr-argmax", 0.75, 0.625, 0.25, 0.125, 0.05)
    less = toy_difference("ours", "still", 0.25, 0.5, 0.0625, 1e-120, 1e-6)
    rows = (
        TableRow(
            "Tarnfjord",
            "never-switch",
            True,
            PAPER_TABLE["never-switch", True],
            5,
            True,
            (still, ours, plan),
            differences,
            gain,
        ),
        TableRow(
            "Hut",
            "somebody",
            False,
            None,
            2,
            False,
            (still, ours._replace(races=16)),
            (less,),
            None,
        ),
    )
    return StudyTable(rows, "still", "ours", "cfr-argmax")
