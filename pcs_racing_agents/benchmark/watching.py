"""Races of a score card that are worth watching."""

from collections.abc import Sequence

import numpy as np

from pcs_racing.race.replay import Replay
from pcs_racing_agents.benchmark.scoring import CellRaces
from pcs_racing_agents.tournament.watching import record_game


def telling_races(own: Sequence[CellRaces], others: Sequence[CellRaces], count: int) -> list[tuple[str, Replay]]:
    """Return recordings, with titles, of the races in which an agent and another one came off most differently.

    Parameters
    ----------
    own, others : sequence of CellRaces
        The same cells in the same order, raced by the agent and by the other one.
    count : int
        Number of races; one of each cell is considered.
    """
    telling: list[tuple[float, CellRaces, int]] = []
    for cell, other in zip(own, others, strict=True):
        # In turn, a race that the agent wins and the other one loses, and the other way round.
        difference = (cell.races.score - other.races.score) * (1.0 if len(telling) % 2 == 0 else -1.0)
        race = int(np.argmax(difference))
        telling.append((float(difference[race]), cell, race))
    telling.sort(key=lambda entry: -entry[0])
    races = []
    for _, cell, race in telling[:count]:
        pairing = cell.pairing
        recording = record_game(
            pairing.game, pairing.ego, pairing.opponent, **pairing.race_arguments(race), candidates=False
        )
        races.append((f"{cell.cell.circuit}, race {race}: {recording.replay.outcome}", recording.replay))
    return races
