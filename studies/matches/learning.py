"""Behaviours and scores of an archive's policies against each other, from training races: matches
of a single race.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.game.match import MatchGame
from pcs_racing.game.observation import decode_match
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.races import start_lines
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Run, run_races
from studies.matches.behaviours import Behaviours, features
from studies.matches.play import play_matches

RACES_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class LearningRaces:
    """The races from which the behaviours of an archive's policies are learned."""

    spec: GameSpec  #: Archive and rules.
    #: Circuits, or their names or folders, which workers on other machines load themselves.
    tracks: tuple[Track | str, ...]
    #: Races of each two policies on each circuit, even: on each start line both sides take turns.
    races: int = 64
    seed: int = 0  #: Root of start lines and noise.

    def __post_init__(self) -> None:
        if not self.tracks:
            raise InputError("there are no tracks; name at least one")
        check_whole("races", self.races, 4, 100_000)
        if self.races % 2:
            raise InputError(
                f"races is {self.races}; it must be even, since both sides of each start line take"
                " turns"
            )
        check_seed(name="seed", seed=self.seed)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairs of policies, each with itself as well; the lower index first."""
        return list(combinations_with_replacement(range(len(self.spec.archive)), 2))


def learn_behaviours(learning: LearningRaces, **run: Unpack[Run]) -> Behaviours:
    """Race all pairs of an archive's policies, each kept for a whole race, and return what they see
    and win.

    Progress counts blocks of pairs.
    """
    pairs, archive = learning.pairs, learning.spec.archive
    step = max(1, RACES_AT_ONCE // learning.races)
    tasks = [
        (learning, track, pairs[first : first + step])
        for track in range(len(learning.tracks))
        for first in range(0, len(pairs), step)
    ]
    results = run_races("learning", _race_block, tasks, **run)
    blocks = [(block, result) for (_, _, block), result in zip(tasks, results, strict=True)]
    return _table(learning, archive.name, blocks)


def _table(
    learning: LearningRaces, name: str, blocks: Sequence[tuple[list[tuple[int, int]], Arrays]]
) -> Behaviours:
    policies = len(learning.spec.archive)
    width = blocks[0][1]["seen"].shape[-1]
    scores, seen, squares = (
        np.zeros((policies, policies, *more)) for more in ((), (width,), (width, width))
    )
    count = np.zeros((policies, policies))
    for block, result in blocks:
        for row, (i, j) in enumerate(block):
            for car, (own, other) in enumerate(((i, j), (j, i))):
                rows = result["seen"][row, :, car]
                scores[own, other] += result["scores"][row, :, car].sum()
                seen[own, other] += rows.sum(axis=0)
                squares[own, other] += rows.T @ rows
                count[own, other] += len(rows)
    seen /= count[..., None]
    # Within pairs of policies, over circuits and races: what one race may differ from the mean.
    within = squares - count[..., None, None] * seen[..., :, None] * seen[..., None, :]
    covariance = within.sum(axis=(0, 1)) / (count - 1.0).sum()
    # a feature that never varies is no certain sign
    covariance += np.diag(1e-6 + 1e-3 * np.diag(covariance))
    return Behaviours(
        game=learning.spec.identity._replace(elements=(), moves=()),
        opponents=tuple(f"{name}[{i}]" for i in range(policies)),
        scores=scores / count,
        seen=seen,
        covariance=covariance,
        training={
            "tracks": ", ".join(as_track(track).name for track in learning.tracks),
            "races": learning.races,
            "seed": learning.seed,
        },
    )


def _race_block(
    task: tuple[LearningRaces, int, list[tuple[int, int]]], threads: int | None = None
) -> Arrays:
    """Race some pairs on one circuit: scores, shape (pairs, races, 2), and features, shape (pairs,
    races, 2, F).
    """
    learning, number, pairs = task
    spec, races = learning.spec, learning.races
    game = RaceGame(as_track(learning.tracks[number]), spec.archive, spec.config, threads=threads)
    match = MatchGame(game, races=1)
    rules = replace(game.setup.config, start_lines=races // 2)
    lines = start_lines(
        game.track, rules, np.random.SeedSequence(learning.seed, spawn_key=(0, number))
    )
    # A pair's noise depends on its two policies, not on the block that races it.
    keys = np.concatenate(
        [
            np.random.SeedSequence(learning.seed, spawn_key=(1, number, i, j)).generate_state(
                races, np.uint64
            )
            for i, j in pairs
        ]
    ).astype(np.uint64)
    played = play_matches(
        match,
        None,
        None,
        keys=keys,
        policies=np.repeat(np.array(pairs), races, axis=0),
        lines=np.tile(np.repeat(lines, 2), len(pairs))[:, None],
        sides=np.tile([0, 1], len(keys) // 2),
    )
    axes = len(game.characteristics)
    seen = [features(decode_match(played.observations[:, car], 1, axes))[:, 0] for car in range(2)]
    shape = (len(pairs), races, 2)
    found: NDArray[np.float64] = np.stack(seen, axis=1).reshape(*shape, -1)
    return {"scores": played.scores[:, :, 0].reshape(shape), "seen": found}
