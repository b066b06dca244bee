"""Rows from game trees: every decision of both players, with targets from the solution."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.networks.rows import Rows, pair_number
from pcs_racing_agents.networks.targets import ROW_WEIGHTS, Solution, node_targets
from pcs_racing_agents.solvers import CFRResult, GameTree, reach_probabilities

Floats = NDArray[np.float64]


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
    opponent: str = "fixed-sequence",
    stay: int | None = None,
    row_weights: str = "uniform",
    rows_per_step: int = 0,
    seed: int = 0,
) -> Rows:
    """Make training rows of a tree of races and its solution.

    Both players' decisions at all nodes are rows, for each seed its own: the observations differ, the targets come from
    the mean over the seeds, since no driver knows the noise. Nodes where the race is over are left out. Where some
    seeds have crashed, differences between moves are those of the seeds that go on: a driver who has to decide knows
    that it has not crashed.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        What :func:`pcs_racing_agents.networks.targets.solve_for` returns for ``race_tree.game_tree()``.
    target : str
        One of :data:`pcs_racing_agents.networks.targets.TARGETS`.
    opponent, stay
        See :func:`pcs_racing_agents.networks.targets.node_targets`.
    row_weights : str
        One of :data:`pcs_racing_agents.networks.targets.ROW_WEIGHTS`.
    rows_per_step : int
        Most nodes of each step that are taken, drawn at random; 0 for all. The weights make up for it.
    seed : int
        Of that draw.

    Returns
    -------
    Rows
        All of one starting pair, :func:`pcs_racing_agents.networks.rows.pair_number`.
    """
    tree = race_tree.game_tree()
    targets = node_targets(tree, solution, target, opponent=opponent, stay=stay)
    weights = _node_weights(tree, solution, row_weights)
    payoffs = np.asarray(race_tree.payoffs, np.float64)
    seeds = len(payoffs)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(int(p) for p in race_tree.policies)))
    blocks: list[tuple[Any, ...]] = []
    for k, ((first, second), weight) in enumerate(zip(targets, weights, strict=True)):
        nodes = len(weight)
        over = np.asarray(race_tree.over[k], np.bool_)
        observed = np.asarray(race_tree.observations(k), np.float32)
        if over.shape != (seeds, nodes) or observed.shape[:3] != (seeds, nodes, 2):
            raise InputError(
                f"level {k} has observations of shape {observed.shape} and over of shape {over.shape}; {seeds} seeds "
                f"and {nodes} nodes need ({seeds}, {nodes}, 2, any) and ({seeds}, {nodes})"
            )
        if first.shape != second.shape:
            raise InputError(f"level {k}: the cars have {first.shape[1]} and {second.shape[1]} moves; rows need equal")
        sample = np.arange(nodes)
        if 0 < rows_per_step < nodes:
            sample = np.sort(rng.permutation(nodes)[:rows_per_step])
        share = weight[sample] * nodes / len(sample) / seeds
        running = ~over[:, sample]
        ended_payoffs = np.where(over, payoffs.reshape(seeds, nodes, -1)[..., 0], 0.0).sum(axis=0)[sample]
        for player, values in enumerate((first, second)):
            goals_of_player = values[sample]
            if target in ("advantage", "static-q"):
                offset = ended_payoffs[:, None] * (1 - 2 * player) if target == "static-q" else 0.0
                goals_of_player = (goals_of_player * seeds - offset) / np.maximum(running.sum(axis=0), 1)[:, None]
            usable = running & np.isfinite(goals_of_player).all(axis=1)
            at = np.nonzero(usable)
            blocks.append(
                (
                    observed[:, sample, player][at],
                    goals_of_player[at[1]],
                    share[at[1]],
                    np.full(len(at[0]), k, np.int64),
                )
            )
    observations, goals, shares, steps = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    if len(goals) == 0:
        raise InputError(f"a tree of policies {list(race_tree.policies)} has no node where the race goes on")
    pair = np.full(len(goals), pair_number(race_tree.policies))
    return Rows(observations, goals, shares, pair, steps)


def _node_weights(tree: GameTree, solution: Solution, row_weights: str) -> list[Floats]:
    """Return the weights of the nodes of each level, shape (N_k,) each."""
    if row_weights not in ROW_WEIGHTS:
        raise UnknownNameError(f"unknown row weights {row_weights!r}; there are {', '.join(ROW_WEIGHTS)}")
    if row_weights == "uniform":
        return [np.ones(tree.nodes(k)) for k in range(tree.depth)]
    if row_weights == "random":
        return [np.full(tree.nodes(k), 1.0 / tree.nodes(k)) for k in range(tree.depth)]
    profile = solution.average if isinstance(solution, CFRResult) else solution.profile
    mixed = [(0.5 * first + 0.5 / first.shape[1], 0.5 * second + 0.5 / second.shape[1]) for first, second in profile]
    return [first * second for first, second in reach_probabilities(tree, mixed)]
