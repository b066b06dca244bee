"""Roots of trees: diverse starting policies, start lines, sides and noise seeds."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed, check_whole
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.start_grid import Starts

Indices = NDArray[np.int64]

ATTEMPTS = 20  # as many as RaceGame.reset makes
NOISY_SEEDS = 4


class Root(NamedTuple):
    """The root of a tree: policies, start and noise."""

    policies: Indices  #: shape (2,)
    start_s: float  #: Arc length of the start line, m.
    side: int  #: 0 when car 0 starts on the left or in front.
    seeds: NDArray[np.uint64]  #: shape (S,): Keys of the games.


def choose_pairs(archive: PolicyArchive, count: int, seed: int = 0) -> Indices:
    """Choose pairs of starting policies, shape (count, 2).

    The policies are a diverse choice of about ``2 sqrt(count)`` of the archive's (:func:`select_diverse`); no pair
    comes twice before all of them have come once, whichever way round.

    Parameters
    ----------
    count : int
        1 to 100,000.
    seed : int
        Of the choice.
    """
    from pcs_racing_agents.synthesis.diverse import select_diverse

    check_whole("pairs", count, 1, 100_000)
    check_seed(seed, most=2**64)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    size = min(len(archive), int(np.ceil(2.0 * np.sqrt(count))))
    pool = select_diverse(archive, size, rng=rng)
    every = np.stack(np.triu_indices(size), axis=1)
    rounds = [rng.permutation(every) for _ in range(-(-count // len(every)))]
    return pool[rng.permuted(np.concatenate(rounds)[:count], axis=1)]


def default_seeds(game: RaceGame) -> int:
    """Noise seeds of a root: one where there is no noise, four where there is."""
    return NOISY_SEEDS if game.config.race.steering_noise > 0.0 else 1


def draw_root(game: RaceGame, policies: Indices, seeds: int, rng: np.random.Generator) -> Root:
    """Draw start line, side and noise for a pair of policies, so that neither car crashes before the first move.

    The games of a root, one for each of the ``seeds``, differ in their noise alone.
    """
    # Like `RaceGame.reset`, it draws again where a car crashes, and gives up after some attempts: a pair that always
    # crashes has a tree of nothing but crashes.
    noisy = game.config.race.steering_noise > 0.0
    start_s, side, kept = 0.0, 0, np.zeros(0, np.uint64)
    for _ in range(ATTEMPTS):
        start_s, side = float(rng.choice(game.start_lines)), int(rng.integers(2))
        kept = np.zeros(0, np.uint64)
        for _ in range(ATTEMPTS if noisy else 1):
            keys = rng.integers(2**64, size=seeds - len(kept), dtype=np.uint64)
            starts = Starts(np.full(len(keys), start_s), np.full(len(keys), side))
            crashed = game.reset(keys, policies=policies, starts=starts).race.crashed
            kept = np.concatenate([kept, keys[~crashed]])
            if len(kept) == seeds:
                return Root(policies, start_s, side, kept)
    missing = rng.integers(2**64, size=seeds - len(kept), dtype=np.uint64)
    return Root(policies, start_s, side, np.concatenate([kept, missing]))
