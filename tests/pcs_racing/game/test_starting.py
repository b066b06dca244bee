"""How games begin: their random numbers."""

import numpy as np

from pcs_racing.game.starting import random_bits

MASK = 2**64 - 1


def splitmix64(x: int) -> int:
    """The finaliser of Steele and others (2014), in whole numbers of any size."""
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 & MASK
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB & MASK
    return x ^ (x >> 31)


def test_the_bits_of_a_game_are_a_hash_of_its_key_and_of_the_attempt():
    keys = [0, 1, 2**63 + 5]
    for attempt in (0, 3):
        expected = [
            [splitmix64((splitmix64(key) + (5 * attempt + 1 + i) * 0x9E3779B97F4A7C15) & MASK) for i in range(5)]
            for key in keys
        ]
        assert random_bits(np.array(keys, np.uint64), attempt).tolist() == expected
