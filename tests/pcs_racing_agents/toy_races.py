"""Races of a study whose truth is known: drawn, not driven; and a table of round numbers."""

import numpy as np

from pcs_racing_agents.base.statistics import Comparison
from pcs_racing_agents.study.table import NO_FIGURES, PAPER_TABLE, TableLine
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
        rules=Categorical.constant("paper", count),
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


def toy_line(
    kind, track, train, opponent, arm, base, scores=(0.5, 0.5), reach=0.0, p=1.0, p_holm=1.0, sd=0.0
) -> TableLine:
    """Return a line of round numbers; ``reach``: half the length of the interval."""
    difference = scores[0] - scores[1]
    ends = (difference - reach, difference + reach)
    result = Comparison(
        *scores, difference, *ends, reach / 2.0, 3, p, p / 10.0, 8 * difference, 8, 2, 4
    )
    paper = PAPER_TABLE.get((opponent, train), NO_FIGURES)
    return TableLine(
        kind, track, train, opponent, arm, base, 5, sd, 0.25, 0.125, result, p_holm, paper
    )


def toy_table() -> list[TableLine]:
    """Two rows: three agents with the paper's figures, and two agents without."""
    first, other = ("Tarnfjord", True, "never-switch"), ("Hut", False, "somebody")
    return [
        toy_line("score", *first, "still", "still", sd=0.125),
        toy_line("difference", *first, "ours", "still", (0.75, 0.5), 0.125, 0.0025, 0.005),
        toy_line("difference", *first, "cfr-argmax", "still", (0.625, 0.5), 0.25, 0.5, 0.5),
        toy_line("adaptivity gain", *first, "ours", "cfr-argmax", (0.75, 0.625), 0.25, 0.125, 0.05),
        toy_line("score", *other, "still", "still"),
        toy_line("difference", *other, "ours", "still", (0.25, 0.5), 0.0625, 1e-120, 1e-6),
    ]
