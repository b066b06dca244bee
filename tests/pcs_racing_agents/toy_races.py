"""Races of a study whose truth is known: drawn, not driven."""

import numpy as np

from pcs_racing_agents.results.races import Categorical, RaceTable, concatenate_races

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
    grid = np.meshgrid(np.arange(egos), np.arange(variants), np.arange(lines), np.arange(2), indexing="ij")
    ego, opponent, line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    for track in tracks:
        for rival in opponents:
            luck = rng.normal(size=len(ego)) + 0.5 * rng.normal(size=egos)[ego]
            for arm, strength in strengths.items():
                lead = luck + strength + 0.5 * rng.normal(size=len(ego))
                crash = rng.random(len(ego)) < 0.1
                own = crash & (rng.random(len(ego)) < 0.5)
                tables.append(_table(track, arm, rival, lead, crash, own, np.stack([ego, opponent], 1), line, side))
    return concatenate_races(tables)


def of(races: RaceTable, track: str, opponent: str, arm: str) -> RaceTable:
    """The races of one arm in one row."""
    return races.take(races.pairs[track, arm, opponent, "0"])


def _table(track, arm, rival, lead, crash, own, variants, line, side) -> RaceTable:
    count = len(lead)
    nothing = np.full((count, 2, 0), -1, np.int8)
    return RaceTable(
        preset=Categorical.constant("paper", count),
        agents=Categorical.concatenate([Categorical.constant(name, count) for name in (arm, rival)], axis=1),
        track=Categorical.constant(track, count), race=np.arange(count), start_s=line.astype(float), side=side,
        seed=Categorical.constant("0", count), lead=lead,
        winner=np.where(crash, -1, np.where(lead > 0.0, 0, 1)), crash=2 * crash,
        fault=np.stack([own, crash & ~own], axis=1).astype(np.int8), overtakes=np.zeros((count, 2), np.int8),
        duration=np.full(count, 40.0), variants=variants, path=nothing, moves=Categorical((), nothing),
    )  # fmt: skip
