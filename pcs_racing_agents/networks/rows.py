"""Training rows: an observation of a player, and a target for each of its moves.

Rows come from game trees (:func:`tree_rows`), but the trainer accepts rows of any source.

A target is a number for each move of a player at a node of a solved tree. Targets differ in their
assumption about the opponent and in their comparison of nodes:

- cumulative regrets are the paper's target; they shrink with the opponent's probability of reaching
  a node, so that nodes avoided by the opponent hardly count;
- normalised regrets have the same size at every node;
- equilibrium advantages come from the exact solution instead of CFR;
- "nash" is the equilibrium strategy itself instead of a value.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.typing import Floats
from pcs_racing_agents.solvers import CFRResult, ExactResult, GameTree, cfr, solve_exact


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


if TYPE_CHECKING:
    from pcs_racing_agents.trees import RaceTree

Solution = CFRResult | ExactResult
"""Result of :func:`solve_for`."""


class Target(NamedTuple):
    """Kind of target."""

    meaning: str
    solver: type[CFRResult] | type[ExactResult]  #: Kind of solution of the trees.
    #: ``clipped``, ``relative``: Way of learning (:mod:`pcs_racing_agents.networks.goals`).
    clipped: bool = False
    relative: bool = True


TARGETS = {
    "regret": Target(
        "cumulative counterfactual regret, clipped at 0 (the paper)",
        CFRResult,
        clipped=True,
        relative=False,
    ),
    "normalised": Target(
        "cumulative regret, divided by its max magnitude at the node: -1 to 1", CFRResult
    ),
    "advantage": Target(
        "gain or loss of a move against the equilibrium, if both follow it afterwards", ExactResult
    ),
    "nash": Target(
        "probability of the move in an equilibrium; the agent draws from it",
        ExactResult,
        relative=False,
    ),
}
"""Kinds of targets from trees."""


def get_target(name: str) -> Target:
    """Return a kind of target by name."""
    if name not in TARGETS:
        raise UnknownNameError(f"unknown target {name!r}; trees give {', '.join(TARGETS)}")
    return TARGETS[name]


def best_moves(targets: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return a mask of the highest targets of each row, shape (R, A), up to rounding."""
    values = np.asarray(targets, np.float64)
    highest = values.max(axis=-1, keepdims=True)
    return values >= highest - 1e-6 * np.maximum(np.abs(highest), 1.0)


def solve_for(tree: GameTree, target: str, *, iterations: int = 1000) -> Solution:
    """Solve a tree with the solver of a target; ``iterations``: iterations of CFR."""
    if get_target(target).solver is CFRResult:
        return cfr(tree, iterations, variant="vanilla")
    return solve_exact(tree)


def node_targets(solution: Solution, target: str) -> list[tuple[Floats, Floats]]:
    """Return the targets of all infosets.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        Result of :func:`solve_for` for the target.

    Returns
    -------
    list of (ndarray, ndarray)
        For each level the targets of car 0, shape (rows, A), and of car 1, shape (rows, B), each
        from its own point of view and never clipped; NaN in rows without information in the
        solution (never reached by CFR).
    """
    if isinstance(solution, CFRResult):
        if target == "regret":
            return list(solution.regrets)
        return [
            (_normalised(r0, reach0), _normalised(r1, reach1))
            for (r0, r1), (reach0, reach1) in zip(
                solution.regrets, solution.opponent_reach, strict=True
            )
        ]
    return list(solution.advantages if target == "advantage" else solution.profile)


def _normalised(regrets: Floats, reach: Floats) -> Floats:
    """Return rows divided by their maximum magnitude.

    Rows are 0 where all regrets are 0, and NaN where the opponent never came.
    """
    size = np.abs(regrets).max(axis=1, keepdims=True)
    return np.where(reach[:, None] > 0.0, regrets / np.where(size > 0.0, size, 1.0), np.nan)


# Rows


def tree_rows(
    race_tree: "RaceTree",
    solution: Solution,
    target: str,
    *,
    rows_per_step: int = 0,
    seed: int = 0,
) -> Rows:
    """Make training rows of a tree of races and its solution, all of one starting pair.

    The decisions of both players at all nodes are rows, separate for each seed. Observations differ
    by seed; targets come from the mean over the seeds, since no policy knows the noise. Nodes after
    the end of the race are left out.

    94 % of the nodes of a tree of four moves belong to the last move, but a race visits each step
    once: the nodes of every step share a weight of 1. For "regret" every node counts 1, because at
    a tree's root cumulative regrets are a hundred times as large as at its leaves.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        Result of :func:`solve_for` for ``race_tree.game_tree()``.
    target : str
        One of :data:`TARGETS`.
    rows_per_step : int
        Maximum number of nodes per step, drawn at random; 0 for all. The weights compensate for the
        omitted nodes.
    seed : int
        Seed of the draw of nodes.
    """
    targets = node_targets(solution, target)
    seeds = len(race_tree.payoffs)
    rng = np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=tuple(int(p) for p in race_tree.policies))
    )
    blocks: list[tuple[Any, ...]] = []
    for k, (first, second) in enumerate(targets):
        over = race_tree.over[k]
        observed = race_tree.observations(k)
        nodes = over.shape[1]
        sample = np.arange(nodes)
        if 0 < rows_per_step < nodes:
            sample = np.sort(rng.permutation(nodes)[:rows_per_step])
        # Every node counts 1 or 1 / nodes; drawn nodes also carry the weight of omitted nodes.
        weight = (nodes if target == "regret" else 1.0) / len(sample) / seeds
        running = ~over[:, sample]
        for player, values in enumerate((first, second)):
            goals = values[sample]
            if target == "advantage":
                # The solution's values are means over all seeds. If some seeds have crashed,
                # differences between moves belong to the other seeds: a player with a decision
                # knows that it has not crashed.
                goals = goals * seeds / np.maximum(running.sum(axis=0), 1)[:, None]
            at = np.nonzero(running & np.isfinite(goals).all(axis=1))
            count = len(at[0])
            blocks.append(
                (
                    observed[:, sample, player][at],
                    goals[at[1]],
                    np.full(count, weight),
                    np.full(count, k),
                )
            )
    observations, targets_of_rows, weights, steps = (
        np.concatenate(arrays) for arrays in zip(*blocks, strict=True)
    )
    if len(weights) == 0:
        raise InputError(
            f"a tree of policies {list(race_tree.policies)} has no node where the race goes on"
        )
    pair = np.full(len(weights), pair_number(race_tree.policies))
    return Rows(observations, targets_of_rows, weights, pair, steps)
