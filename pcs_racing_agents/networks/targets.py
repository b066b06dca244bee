"""Targets of networks, and training rows of game trees.

A target is a number for each move of a player at a node of a solved tree. Targets differ in their
assumption about the opponent and in their comparison of nodes:

- cumulative regrets are the paper's target; they shrink with the opponent's probability of reaching
  a node, so that nodes avoided by the opponent hardly count;
- normalised regrets have the same size at every node;
- equilibrium advantages come from the exact solution instead of CFR;
- "static" values are values of best play against an opponent that ignores the race: it makes a
  sequence of moves drawn uniformly in advance, with only the past observed;
- "nash" is the equilibrium strategy itself instead of a value.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.networks.rows import Rows, pair_number
from pcs_racing_agents.solvers import (
    CFRResult,
    ExactResult,
    GameTree,
    best_response,
    cfr,
    solve_exact,
    uniform_profile,
)

Floats = NDArray[np.float64]
Solution = CFRResult | ExactResult
"""Result of :func:`solve_for`."""


class Target(NamedTuple):
    """Kind of target."""

    meaning: str
    clipped: bool  #: True if values below 0 are learned and returned as 0.
    solver: str  #: Solver of the trees: "cfr" or "exact".


TARGETS = {
    "regret": Target("cumulative counterfactual regret, clipped at 0 (the paper)", True, "cfr"),
    "normalised": Target(
        "cumulative regret, divided by its largest magnitude at the node: -1 to 1", False, "cfr"
    ),
    "advantage": Target(
        "gain or loss of a move against the equilibrium, if both follow it afterwards",
        False,
        "exact",
    ),
    "static-q": Target(
        "utility of a move followed by best play, against a static opponent", False, "exact"
    ),
    "nash": Target(
        "probability of the move in an equilibrium, from which the agent draws", False, "exact"
    ),
}
"""Kinds of targets from trees."""

ROW_WEIGHTS = {
    "uniform": "every node counts the same, so that the last step makes up nearly everything",
    "random": "as often as random moves lead there: every step counts the same",
}
"""Rules for the weights of the nodes of a tree."""


def get_target(name: str) -> Target:
    """Return a kind of target by name."""
    if name not in TARGETS:
        raise UnknownNameError(f"unknown target {name!r}; trees give {', '.join(TARGETS)}")
    return TARGETS[name]


def best_moves(
    targets: NDArray[np.floating], mask: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return a mask of the highest targets of each row, shape (R, A), up to rounding."""
    values = np.asarray(targets, np.float64)
    if mask is not None:
        values = np.where(mask, values, -np.inf)
    highest = values.max(axis=-1, keepdims=True)
    return values >= highest - 1e-6 * np.maximum(np.abs(highest), 1.0)


def solve_for(
    tree: GameTree, target: str, *, iterations: int = 1000, variant: str = "vanilla"
) -> Solution:
    """Solve a tree with the solver of a target.

    Parameters
    ----------
    iterations, variant
        Options of CFR, for targets based on regrets.
    """
    if get_target(target).solver == "cfr":
        return cfr(tree, iterations, variant=variant)
    return solve_exact(tree)


def node_targets(tree: GameTree, solution: Solution, target: str) -> list[tuple[Floats, Floats]]:
    """Return the targets of all infosets.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        Result of :func:`solve_for` for the tree and target.

    Returns
    -------
    list of (ndarray, ndarray)
        For each level the targets of car 0, shape (rows, A), and of car 1, shape (rows, B), each
        from its own point of view and never clipped; NaN in rows without information in the
        solution (never reached by CFR).
    """
    kind = get_target(target)
    wanted = CFRResult if kind.solver == "cfr" else ExactResult
    if not isinstance(solution, wanted):
        raise InputError(
            f"target {target!r} needs a {wanted.__name__}; the solution is a"
            f" {type(solution).__name__}"
        )
    if isinstance(solution, CFRResult):
        if target == "regret":
            return list(solution.regrets)
        return [
            (_normalised(r0, reach0), _normalised(r1, reach1))
            for (r0, r1), (reach0, reach1) in zip(
                solution.regrets, solution.opponent_reach, strict=True
            )
        ]
    if target == "advantage":
        return list(solution.advantages)
    if target == "nash":
        return list(solution.profile)
    q = [best_response(tree, uniform_profile(tree), player).q for player in (0, 1)]
    return list(zip(*q, strict=True))


def _normalised(regrets: Floats, reach: Floats) -> Floats:
    """Return rows divided by their maximum magnitude.

    Rows are 0 where all regrets are 0, and NaN where the opponent never came.
    """
    size = np.abs(regrets).max(axis=1, keepdims=True)
    return np.where(reach[:, None] > 0.0, regrets / np.where(size > 0.0, size, 1.0), np.nan)


# Rows


class PlayedTree(Protocol):
    """Protocol of a tree of races with S noise seeds and ``N_k`` nodes at level k.

    :class:`pcs_racing_agents.trees.RaceTree` implements it.
    """

    @property
    def policies(self) -> Any:
        """Starting policies of the two cars, shape (2,)."""

    @property
    def payoffs(self) -> Any:
        """Payoff of each leaf to car 0, shape (S, leaves)."""

    @property
    def over(self) -> Any:
        """True if the race was over before the decision, for each level, shape (S, N_k)."""

    def game_tree(self) -> GameTree:
        """Return the tree with payoffs averaged over the seeds, unobserved by the players."""

    def observations(self, level: int) -> NDArray[np.float32]:
        """Return observations of both players at the nodes of a level, shape (S, N_k, 2, D)."""


def tree_rows(
    race_tree: PlayedTree,
    solution: Solution,
    target: str,
    *,
    row_weights: str = "uniform",
    rows_per_step: int = 0,
    seed: int = 0,
) -> Rows:
    """Make training rows of a tree of races and its solution, all of one starting pair.

    The decisions of both players at all nodes are rows, separate for each seed. Observations differ
    by seed; targets come from the mean over the seeds, since no policy knows the noise. Nodes after
    the end of the race are left out.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        Result of :func:`solve_for` for ``race_tree.game_tree()``.
    target, row_weights : str
        One of :data:`TARGETS`, and one of :data:`ROW_WEIGHTS`.
    rows_per_step : int
        Maximum number of nodes per step, drawn at random; 0 for all. The weights compensate for the
        omitted nodes.
    seed : int
        Seed of the draw of nodes.
    """
    if row_weights not in ROW_WEIGHTS:
        raise UnknownNameError(
            f"unknown row weights {row_weights!r}; there are {', '.join(ROW_WEIGHTS)}"
        )
    targets = node_targets(race_tree.game_tree(), solution, target)
    payoffs = np.asarray(race_tree.payoffs, np.float64)
    seeds = len(payoffs)
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
        weight = (nodes if row_weights == "uniform" else 1.0) / len(sample) / seeds
        running = ~over[:, sample]
        # If some seeds have crashed, differences between moves belong to the other seeds: a player
        # with a decision knows that it has not crashed. The solution's values are means over all
        # seeds: the payoffs of crashed seeds, equal for all moves, are subtracted (advantages do
        # not include them), and the rest is spread over the other seeds.
        ended_payoffs = np.where(over, payoffs.reshape(seeds, nodes, -1)[..., 0], 0.0).sum(axis=0)[
            sample
        ]
        for player, values in enumerate((first, second)):
            goals = values[sample]
            if target in ("advantage", "static-q"):
                offset = ended_payoffs[:, None] * (1 - 2 * player) if target == "static-q" else 0.0
                goals = (goals * seeds - offset) / np.maximum(running.sum(axis=0), 1)[:, None]
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
