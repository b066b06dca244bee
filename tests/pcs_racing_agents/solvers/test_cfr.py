import math

import numpy as np
import pytest
from refusal import refused
from small_games import PENNIES, kuhn_poker, random_tree

from pcs_racing_agents.solvers import VARIANTS, cfr, exploitability


def same(one, other, tolerance=0.0) -> bool:
    pairs = [
        arrays for levels in zip(one, other, strict=True) for arrays in zip(*levels, strict=True)
    ]
    return all(np.allclose(a, b, rtol=0.0, atol=tolerance) for a, b in pairs)


class SlowCFR:
    """The definition (Zinkevich et al. 2007; Brown and Sandholm 2019) in loops over the nodes of a
    tree.
    """

    def __init__(self, tree, variant):
        self.tree, self.variant = tree, variant
        shapes = [
            [(tree.rows(k, player), tree.moves[k][player]) for player in (0, 1)]
            for k in range(tree.depth)
        ]
        self.regrets, self.sums = (
            [[np.zeros(shape) for shape in pair] for pair in shapes] for _ in range(2)
        )
        self.reached = [[np.zeros(shape[0]) for shape in pair] for pair in shapes]
        self.strategy = [[np.full(shape, 1.0 / shape[1]) for shape in pair] for pair in shapes]

    def visit(self, level, node, player, own, others):
        """Value of a node for a player; adds the gain of each of its moves."""
        sign = 1.0 if player == 0 else -1.0
        if level == self.tree.depth:
            return sign * self.tree.payoffs.reshape(-1)[node]
        moves = self.tree.moves[level]
        rows = [int(self.tree.infosets[level][who][node]) for who in (0, 1)]
        mine, theirs = (self.strategy[level][who][rows[who]] for who in (player, 1 - player))
        gains = np.zeros(moves[player])
        for a in range(moves[player]):
            for b in range(moves[1 - player]):
                pair = (a, b) if player == 0 else (b, a)
                child = (node * moves[0] + pair[0]) * moves[1] + pair[1]
                gains[a] += theirs[b] * self.visit(
                    level + 1, child, player, own * mine[a], others * theirs[b]
                )
        value = mine @ gains
        row = rows[player]
        self.regrets[level][player][row] += others * (gains - value)
        self.reached[level][player][row] += others
        self.own_reach[level][row] = own
        return value

    def iterate(self, t):
        """Iteration t, counted from 1: gains of the strategies, then the next strategies."""
        variant = self.variant
        for player in (0, 1):
            self.own_reach = [np.zeros(self.tree.rows(k, player)) for k in range(self.tree.depth)]
            for root, chance in enumerate(self.tree.chance):
                self.visit(0, root, player, 1.0, chance)
            for level, reach in enumerate(self.own_reach):
                self.sums[level][player] += (
                    t**variant.gamma * reach[:, None] * self.strategy[level][player]
                )
            if variant.alternating:
                self.follow(t, player)
        if not variant.alternating:
            for player in (0, 1):
                self.follow(t, player)

    def follow(self, t, player):
        """Discount a player's regrets, and play in proportion to the rest."""
        kept = [
            0.0 if e == -math.inf else 1.0 if e == math.inf else t**e / (t**e + 1.0)
            for e in (self.variant.alpha, self.variant.beta)
        ]
        for level in range(self.tree.depth):
            regrets = self.regrets[level][player]
            regrets *= np.where(regrets > 0.0, *kept)
            self.reached[level][player] *= kept[0]
            positive = np.maximum(regrets, 0.0)
            total = positive.sum(axis=1, keepdims=True)
            even = np.full_like(positive, 1.0 / positive.shape[1])
            self.strategy[level][player] = np.where(
                total > 0.0, positive / np.where(total > 0.0, total, 1.0), even
            )


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    "tree",
    [
        random_tree(7, 2, 3, 3, 2),
        random_tree(8, 3, 2, 2, 3, chance=3, blur=2),
        kuhn_poker(),
        # more nodes in a level than the kernels work on at a time
        random_tree(9, 4, 5, 4, 4, 1, 2),
    ],
    ids=["open", "hidden", "kuhn", "wide"],
)
def test_every_iteration_is_that_of_the_definition(tree, variant):
    slow = SlowCFR(tree.averaged, VARIANTS[variant])
    for t in range(1, 4 if len(tree.infosets[-1][0]) > 256 else 8):
        slow.iterate(t)
        result = cfr(tree, t, variant)
        assert same(result.regrets, slow.regrets, 1e-9)
        assert same(result.opponent_reach, slow.reached, 1e-9)
        played = [[sums / sums.sum(axis=1, keepdims=True) for sums in pair] for pair in slow.sums]
        assert same(result.average, played, 1e-9)


@pytest.mark.parametrize("variant", VARIANTS)
def test_all_variants_solve_kuhn_poker(variant):
    tree = kuhn_poker()
    result = cfr(tree, 2000, variant)
    judged = exploitability(tree, result.average)
    assert judged.nash_conv < 0.02
    assert judged.value == pytest.approx(-1.0 / 18.0, abs=0.01)


def test_impossible_runs():
    for arguments, named in [
        ((PENNIES, 0), "iterations is 0"),
        ((PENNIES, 2.5), "2.5"),
        ((PENNIES, True), "True"),
        ((PENNIES, 10**9), "1 to"),
        ((PENNIES, 1, "cfr2"), "'cfr2'"),
    ]:
        refused(named, cfr, *arguments)
