"""Games and strategies that the tests of the solvers share."""

import numpy as np

from pcs_racing_agents.solvers import GameTree


def kuhn_poker() -> GameTree:
    """Kuhn poker: six deals, then car 0 checks or bets, car 1 answers, and after check and bet car
    0 answers.

    Moves after the end are played on without effect, and so are moves of the player whose turn it
    is not.
    """
    deals = [(mine, other) for mine in range(3) for other in range(3) if mine != other]
    payoffs = np.zeros((6, 2, 1, 1, 2, 2, 1))
    for deal, (mine, other) in enumerate(deals):
        higher = 1.0 if mine > other else -1.0
        payoffs[deal, 0, 0, 0, 0] = higher  # check, check
        payoffs[deal, 0, 0, 0, 1, 0] = -1.0  # check, bet, fold
        payoffs[deal, 0, 0, 0, 1, 1] = 2.0 * higher  # check, bet, call
        payoffs[deal, 1, 0, 0, 0] = 1.0  # bet, fold
        payoffs[deal, 1, 0, 0, 1] = 2.0 * higher  # bet, call
    tree = GameTree.from_payoffs(payoffs, np.full(6, 1.0 / 6.0))
    labels = []
    for k in range(3):
        histories = np.arange(tree.nodes(k) // 6)
        labels.append(
            tuple(np.concatenate([100 * deal[car] + histories for deal in deals]) for car in (0, 1))
        )
    return tree.with_infosets(labels)


PENNIES = GameTree.from_payoffs([[1.0, -1.0], [-1.0, 1.0]])
"""Matching pennies: car 0 wins 1 if the coins match."""


def random_tree(seed: int, *shape: int, chance: int = 0, blur: int = 0) -> GameTree:
    """A tree of normal payoffs; with ``blur``, each player sees one of so many random signs of
    every node.
    """
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(chance)) if chance else None
    tree = GameTree.from_payoffs(rng.normal(size=(chance, *shape) if chance else shape), weights)
    if not blur:
        return tree
    seen = [
        tuple(rng.integers(0, blur, tree.nodes(k)) for _ in range(2)) for k in range(tree.depth)
    ]
    return tree.with_infosets(remembered(tree, seen))


def remembered(tree: GameTree, seen: list) -> list:
    """Labels of the nodes for players that remember their observations and moves."""
    labels = []
    for k, pair in enumerate(seen):
        both = []
        for car in (0, 1):
            key = np.asarray(pair[car])
            if k:
                moves = tree.moves[k - 1]
                own, parent = np.arange(len(key)), np.arange(len(key)) // (moves[0] * moves[1])
                own = own // moves[1] % moves[0] if car == 0 else own % moves[1]
                key = np.stack([labels[k - 1][car][parent], own, key], axis=1)
            both.append(np.unique(key, axis=0, return_inverse=True)[1].reshape(-1))
        labels.append(tuple(both))
    return labels


def random_profile(tree: GameTree, seed: int = 0, sharp: float = 1.0):
    """Any profile of a tree; with a small ``sharp``, nearly pure strategies."""
    rng = np.random.default_rng(seed)
    return [
        tuple(
            rng.dirichlet(np.full(tree.moves[k][car], sharp), tree.rows(k, car)) for car in (0, 1)
        )
        for k in range(tree.depth)
    ]
