"""Targets of networks, and training rows of game trees.

For every node of a solved tree and every player a target is a number for each move. The targets differ in what they
assume of the opponent and in how they compare nodes:

- cumulative regrets are the paper's target; they shrink with the opponent's probability of coming to a node, so that
  nodes which it avoids hardly count;
- normalised regrets have the same size at every node;
- equilibrium advantages ask the exact solution instead of CFR;
- "static" values play best against an opponent that does not look at the race: it makes a sequence of moves that was
  drawn uniformly beforehand, of which only the past is seen;
- and "nash" is no value but the equilibrium strategy itself.
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
"""What :func:`solve_for` returns."""


class Target(NamedTuple):
    """A kind of target."""

    meaning: str
    clipped: bool  #: Whether values below 0 are learned and shown as 0.
    solver: str  #: What it is made from: "cfr" or "exact".


TARGETS = {
    "regret": Target("cumulative counterfactual regret, clipped at 0 (the paper)", True, "cfr"),
    "normalised": Target("cumulative regret, divided by its largest magnitude at the node: -1 to 1", False, "cfr"),
    "advantage": Target("gain or loss of a move against the equilibrium, if both follow it afterwards", False, "exact"),
    "static-q": Target("utility of a move followed by best play, against a static opponent", False, "exact"),
    "nash": Target("probability of the move in an equilibrium, from which the agent draws", False, "exact"),
}
"""Kinds of targets that trees give."""

ROW_WEIGHTS = {
    "uniform": "every node counts the same, so that the last step makes up nearly everything",
    "random": "as often as random moves lead there: every step counts the same",
}
"""How much the nodes of a tree count."""


def get_target(name: str) -> Target:
    """Return a kind of target by name."""
    if name not in TARGETS:
        raise UnknownNameError(f"unknown target {name!r}; trees give {', '.join(TARGETS)}")
    return TARGETS[name]


def best_moves(targets: NDArray[np.floating], mask: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Which moves have the highest target of their row, shape (R, A); equal up to rounding counts as highest."""
    values = np.asarray(targets, np.float64)
    if mask is not None:
        values = np.where(mask, values, -np.inf)
    highest = values.max(axis=-1, keepdims=True)
    return values >= highest - 1e-6 * np.maximum(np.abs(highest), 1.0)


def solve_for(tree: GameTree, target: str, *, iterations: int = 1000, variant: str = "vanilla") -> Solution:
    """Solve a tree with the solver of a target.

    Parameters
    ----------
    iterations, variant
        Of CFR, if the target is made of regrets.
    """
    if get_target(target).solver == "cfr":
        return cfr(tree, iterations, variant=variant)
    return solve_exact(tree)


def node_targets(tree: GameTree, solution: Solution, target: str) -> list[tuple[Floats, Floats]]:
    """Return the targets of all infosets.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        What :func:`solve_for` returned for the tree and target.

    Returns
    -------
    list of (ndarray, ndarray)
        For each level those of car 0, shape (rows, A), and car 1, shape (rows, B), each from its own point of view and
        never clipped; NaN in rows about which the solution says nothing (CFR that never came there).
    """
    kind = get_target(target)
    wanted = CFRResult if kind.solver == "cfr" else ExactResult
    if not isinstance(solution, wanted):
        raise InputError(f"target {target!r} needs a {wanted.__name__}; the solution is a {type(solution).__name__}")
    if isinstance(solution, CFRResult):
        if target == "regret":
            return list(solution.regrets)
        return [
            (_normalised(r0, reach0), _normalised(r1, reach1))
            for (r0, r1), (reach0, reach1) in zip(solution.regrets, solution.opponent_reach, strict=True)
        ]
    if target == "advantage":
        return list(solution.advantages)
    if target == "nash":
        return list(solution.profile)
    q = [best_response(tree, uniform_profile(tree), player).q for player in (0, 1)]
    return list(zip(*q, strict=True))


def _normalised(regrets: Floats, reach: Floats) -> Floats:
    """Return rows divided by their largest magnitude: 0 where all regrets are, NaN where the opponent never came."""
    size = np.abs(regrets).max(axis=1, keepdims=True)
    return np.where(reach[:, None] > 0.0, regrets / np.where(size > 0.0, size, 1.0), np.nan)


# Rows


class PlayedTree(Protocol):
    """The protocol of a tree of races with S noise seeds and ``N_k`` nodes at level k.

    :class:`pcs_racing_agents.trees.RaceTree` is one.
    """

    @property
    def policies(self) -> Any:
        """Starting policies of the two cars, shape (2,)."""

    @property
    def payoffs(self) -> Any:
        """Payoff of each leaf to car 0, shape (S, leaves)."""

    @property
    def over(self) -> Any:
        """For each level whether the race was over before its decision, shape (S, N_k)."""

    def game_tree(self) -> GameTree:
        """Return the tree with payoffs averaged over the seeds, which no player sees."""

    def observations(self, level: int) -> NDArray[np.float32]:
        """Return both players' observations at the nodes of a level, shape (S, N_k, 2, D)."""


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

    Both players' decisions at all nodes are rows, for each seed its own: the observations differ, the targets come from
    the mean over the seeds, since no driver knows the noise. Nodes where the race is over are left out.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        What :func:`solve_for` returns for ``race_tree.game_tree()``.
    target, row_weights : str
        One of :data:`TARGETS`, and one of :data:`ROW_WEIGHTS`.
    rows_per_step : int
        Most nodes of each step that are taken, drawn at random; 0 for all. The weights make up for it.
    seed : int
        Of that draw.
    """
    if row_weights not in ROW_WEIGHTS:
        raise UnknownNameError(f"unknown row weights {row_weights!r}; there are {', '.join(ROW_WEIGHTS)}")
    targets = node_targets(race_tree.game_tree(), solution, target)
    payoffs = np.asarray(race_tree.payoffs, np.float64)
    seeds = len(payoffs)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(int(p) for p in race_tree.policies)))
    blocks: list[tuple[Any, ...]] = []
    for k, (first, second) in enumerate(targets):
        over = race_tree.over[k]
        observed = race_tree.observations(k)
        nodes = over.shape[1]
        sample = np.arange(nodes)
        if 0 < rows_per_step < nodes:
            sample = np.sort(rng.permutation(nodes)[:rows_per_step])
        # Every node counts 1 or 1 / nodes; those that are taken also stand for those that are not.
        weight = (nodes if row_weights == "uniform" else 1.0) / len(sample) / seeds
        running = ~over[:, sample]
        # Where some seeds have crashed, differences between moves are those of the seeds that go on: a driver who has
        # to decide knows that it has not crashed. The solution's values are means over all seeds: what the crashed ones
        # pay, whatever is played, is taken off (advantages hold nothing of it), and the rest spread over the others.
        ended_payoffs = np.where(over, payoffs.reshape(seeds, nodes, -1)[..., 0], 0.0).sum(axis=0)[sample]
        for player, values in enumerate((first, second)):
            goals = values[sample]
            if target in ("advantage", "static-q"):
                offset = ended_payoffs[:, None] * (1 - 2 * player) if target == "static-q" else 0.0
                goals = (goals * seeds - offset) / np.maximum(running.sum(axis=0), 1)[:, None]
            at = np.nonzero(running & np.isfinite(goals).all(axis=1))
            count = len(at[0])
            blocks.append((observed[:, sample, player][at], goals[at[1]], np.full(count, weight), np.full(count, k)))
    observations, targets_of_rows, weights, steps = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    if len(weights) == 0:
        raise InputError(f"a tree of policies {list(race_tree.policies)} has no node where the race goes on")
    pair = np.full(len(weights), pair_number(race_tree.policies))
    return Rows(observations, targets_of_rows, weights, pair, steps)
