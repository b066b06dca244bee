"""Cells of a study whose truth is known: drawn, not driven."""

import numpy as np
from pcs_racing_agents.study.cell_races import CellRaces, Key

STRENGTHS = {"never-switch": 0.0, "best-fixed": 0.5, "cfr-argmax": 0.6, "our-best": 1.1}


def toy_cells(
    tracks=("Tarnfjord", "Brackwater"),
    opponents=("never-switch", "random-policy", "somebody"),
    strengths=STRENGTHS,
    egos=12,
    variants=10,
    lines=5,
    seed=0,
) -> dict[Key, CellRaces]:
    """All arms in the same races; some of them end in a crash that pays nobody."""
    rng = np.random.default_rng(seed)
    cells = {}
    grid = np.meshgrid(np.arange(egos), np.arange(variants), np.arange(lines), np.arange(2), indexing="ij")
    ego, opponent, line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    for track in tracks:
        for rival in opponents:
            luck = rng.normal(size=len(ego)) + 0.5 * rng.normal(size=egos)[ego]
            for arm, strength in strengths.items():
                lead = luck + strength + 0.5 * rng.normal(size=len(ego))
                crash = rng.random(len(ego)) < 0.1
                own = crash & (rng.random(len(ego)) < 0.5)
                score = np.where(crash, 0.0, (lead > 0.0) * 1.0)
                cells[track, rival, arm] = CellRaces(score, crash, own, ego, opponent, line, side)
    return cells
