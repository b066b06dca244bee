"""Schedules: starts, variants and noise of races that are the same for all pairs, and fair to both sides."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import is_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import draw_starts
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track

MOST_RACES = 2000


class RaceSchedule(NamedTuple):
    """Races of one pair on one track; the same for all pairs (common random numbers)."""

    starts: Starts  #: N of them; races 2j and 2j + 1 start on the same line, from either side.
    #: shape (N, 2): Random numbers that select the variants of ego and opponent. Races 2j and 2j + 1 swap them with the
    #: sides, so that the advantage of a side is equal for both competitors.
    draws: NDArray[np.uint64]
    seeds: NDArray[np.uint64]  #: shape (N,): Keys of the noise.

    def variants(self, ego: int, opponent: int) -> NDArray[np.int64]:
        """Return the variants in each race, shape (N, 2), from the numbers of variants of ego and opponent."""
        return (self.draws % np.array([ego, opponent], np.uint64)).astype(np.int64)


def draw_schedule(track: Track, config: RaceConfig, races: int, seed: int) -> RaceSchedule:
    """Draw the races of each pair on a track.

    Parameters
    ----------
    config : RaceConfig
        Its ``start_lines`` is not used: every two races draw a line of their own.
    races : int
        Even, from 2 to 2000.
    """
    if not is_whole(races) or races % 2 or not 2 <= races <= MOST_RACES:
        raise InputError(
            f"races_per_pair is {races!r}; it must be an even number from 2 to {MOST_RACES}, since every start line is "
            "driven from both sides"
        )
    starts = draw_starts(track, replace(config, start_lines=races // 2), races, seed)
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    draws = generator.integers(2**63, size=(races // 2, 2), dtype=np.uint64)
    swapped = np.stack([draws, draws[:, ::-1]], axis=1).reshape(races, 2)
    return RaceSchedule(starts, swapped, race_seeds(seed, races))
