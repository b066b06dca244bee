"""Training rows: an observation of a player, and a target for each of its moves.

Rows come from game trees (:mod:`pcs_racing_agents.networks.targets`), but the trainer accepts rows
of any source.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError


@dataclass(frozen=True, eq=False)
class Rows:
    """R decisions, each of one player."""

    #: shape (R, D): Observations of the player
    #: (:attr:`pcs_racing.game.rules.RaceGame.observation_elements`).
    observations: NDArray[np.float32]
    #: shape (R, A): Value of each move, never clipped.
    targets: NDArray[np.float32]
    weights: NDArray[np.float64]  #: shape (R,): Weight of each row, 0 or more; not all 0.
    #: shape (R,): Starting pair of each row: all rows of a pair are used either for training or for
    #: validation.
    pair: NDArray[np.int64]
    step: NDArray[np.int64]  #: shape (R,): Number of moves made so far.

    def __post_init__(self) -> None:
        shape = np.shape(self.targets)
        if len(shape) != 2 or 0 in shape:
            raise InputError(
                f"targets have shape {shape}; they must have (rows, moves), at least one of each"
            )
        for key, dtype, wanted in (
            ("observations", np.float32, (shape[0], *np.shape(self.observations)[1:2])),
            ("targets", np.float32, shape),
            ("weights", np.float64, shape[:1]),
            ("pair", np.int64, shape[:1]),
            ("step", np.int64, shape[:1]),
        ):
            array = np.asarray(getattr(self, key))
            if array.shape != wanted or not np.can_cast(array.dtype, dtype, "same_kind"):
                raise InputError(
                    f"{key} have shape {array.shape} and type {array.dtype}; they must have"
                    f" {wanted} and {np.dtype(dtype)}"
                )
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                raise InputError(f"{key} are not finite in row {row}")
            object.__setattr__(self, key, array.astype(dtype, copy=False))
        if (self.weights < 0.0).any() or not self.weights.any():
            raise InputError(
                f"weights lie in {self.weights.min():g} to {self.weights.max():g}; some must be"
                " above 0"
            )

    def __len__(self) -> int:
        return len(self.targets)

    def take(self, indices: ArrayLike) -> "Rows":
        """Return some of the rows, by index or by a mask over rows."""
        array = np.asarray(indices)
        return Rows(**{field.name: getattr(self, field.name)[array] for field in fields(self)})


def join_rows(sources: Sequence[Rows]) -> Rows:
    """Return the rows of several sources of one game."""
    if len(sources) == 0:
        raise InputError("there are no rows to join; give at least one")
    return Rows(
        **{
            field.name: np.concatenate([getattr(p, field.name) for p in sources])
            for field in fields(Rows)
        }
    )


def pair_number(policies: ArrayLike) -> NDArray[np.int64]:
    """Return the number of an unordered starting pair, shape (...) for policies (..., 2)."""
    # The pairs (3, 7) and (7, 3) get the same number: their trees are nearly mirror images, and a
    # network trained on one pair should not be evaluated on the other.
    both = np.sort(np.asarray(policies, np.int64), axis=-1)
    return both[..., 1] * (both[..., 1] + 1) // 2 + both[..., 0]


def draw_pairs(
    pairs: NDArray[np.int64], share: float, seed: np.random.SeedSequence
) -> NDArray[np.int64]:
    """Draw a share of the different pairs, sorted; at least one is drawn, at least one is left."""
    different = np.unique(pairs)
    if len(different) < 2:
        raise InputError(
            "all rows come from one starting pair; validation needs rows of at least 2"
        )
    count = min(max(round(share * len(different)), 1), len(different) - 1)
    return np.sort(np.random.default_rng(seed).permutation(different)[:count])


def split_by_pair(
    rows: Rows, share: float, seed: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Choose a share of the starting pairs for validation.

    Return the mask of their rows, shape (R,), and the pairs, sorted.
    """
    validation_pairs = draw_pairs(rows.pair, share, np.random.SeedSequence(seed, spawn_key=(0,)))
    held_out = np.isin(rows.pair, validation_pairs)
    for side in (held_out, ~held_out):
        if not rows.weights[side].any():
            raise InputError(
                "after the split by starting pair one side has weights of 0 only; give more pairs"
            )
    return held_out, validation_pairs
