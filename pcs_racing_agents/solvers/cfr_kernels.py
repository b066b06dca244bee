"""Compiled part of counterfactual regret minimisation: passes over the levels of a tree.

The layout serves vector instructions. Within a level, nodes are numbered with the *last* move
slowest, so the children of one pair of moves are neighbours, in the order of their parents.
Strategies and regrets hold the numbers of one move together. Then all loops run over neighbouring
nodes.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import compiled, kernel
from pcs_racing_agents.solvers.game_tree import Floats, GameTree, Integers

BLOCK = 256
"""Number of nodes processed at a time: their sums stay in the fastest cache."""


class Layout(NamedTuple):
    """A tree as arrays for the kernels; the first axis of a (2, m) array is the player."""

    moves: Integers  #: shape (2, m): Moves (``moves``) and infosets (``rows``) of each level.
    rows: Integers
    nodes: Integers  #: shape (m,): Number of nodes of each level.
    #: shape (m + 1,): First index of each level in an array with a number per node.
    node_at: Integers
    #: shape (2, m): First index of each level in arrays with a number per node and move
    #: (``sigma_at``), or per infoset and move (``regret_at``).
    sigma_at: Integers
    regret_at: Integers
    #: shape (2, m): First index of each level in ``labels`` (``label_at``), and in ``first`` and
    #: all arrays with a number per infoset (``row_at``).
    label_at: Integers
    row_at: Integers
    labels: Integers  #: Row of every node.
    first: Integers  #: One node of every row.
    #: shape (2, m): True if rows are nodes.
    single: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]"
    chance: Floats  #: shape (nodes of all levels,): Probability of the root above each node.


class State(NamedTuple):
    """Arrays that the iterations change."""

    #: shape (nodes of all levels and leaves,): Value of a node to car 0 under the current
    #: strategies.
    values: Floats
    sigma: Floats  #: Current strategies per node and move.
    #: shape (2, nodes of all levels): Probability that each player's own moves lead to a node.
    reach: Floats
    #: Cumulative regrets (``regrets``) and summed strategies (``sums``), per infoset and move.
    regrets: Floats
    sums: Floats
    #: Summed probability that chance and the other player lead to an infoset.
    opponent_reach: Floats


def node_order(tree: GameTree, level: int) -> Integers:
    """Return the node of the tree at each place of the kernels' order, shape (nodes,)."""
    shape = [tree.roots, *(a * b for a, b in tree.moves[:level])]
    return np.arange(tree.nodes(level)).reshape(shape).transpose().reshape(-1)


def tree_layout(tree: GameTree) -> Layout:
    """Return the layout of a tree for the kernels."""
    m = tree.depth
    nodes = np.array([tree.nodes(k) for k in range(m)])
    moves = np.array(tree.moves, dtype=np.int64).T.copy()
    rows = np.array([[tree.rows(k, player) for k in range(m)] for player in (0, 1)])
    labels, first = [], []
    for player in (0, 1):
        for k in range(m):
            places = tree.infosets[k][player][node_order(tree, k)]
            if rows[player, k] == nodes[k]:
                # Rows are in the kernels' order, too.
                places = np.arange(nodes[k])
            labels.append(places)
            first.append(np.unique(places, return_index=True)[1])

    def starts(sizes: Integers) -> Integers:
        return (np.cumsum(sizes) - sizes.reshape(-1)).reshape(sizes.shape)

    return Layout(
        moves=moves,
        rows=rows,
        nodes=nodes,
        node_at=np.concatenate([[0], np.cumsum(nodes)]),
        sigma_at=starts(moves * nodes),
        regret_at=starts(moves * rows),
        label_at=starts(np.stack([nodes, nodes])),
        row_at=starts(rows),
        labels=np.concatenate(labels),
        first=np.concatenate(first),
        single=rows == nodes,
        chance=np.concatenate([np.tile(tree.chance, count // tree.roots) for count in nodes]),
    )


def initial_state(tree: GameTree, layout: Layout) -> State:
    """Return the state before the first iteration: no regrets."""
    leaves = tree.payoffs.reshape(-1)[node_order(tree, tree.depth)]
    inner = int(layout.node_at[-1])
    entries = int((layout.moves * layout.rows).sum())
    return State(
        values=np.concatenate([np.zeros(inner), leaves]),
        sigma=np.zeros(int((layout.moves * layout.nodes).sum())),
        reach=np.ones((2, inner)),
        regrets=np.zeros(entries),
        sums=np.zeros(entries),
        opponent_reach=np.zeros(int(layout.rows.sum())),
    )


@compiled
def iterate(layout, state, begin, end, alternating, alpha, beta, gamma):
    """Run iterations ``begin`` (from 1) to ``end - 1``, from strategies of the current regrets."""
    widest = max(layout.moves.max(), 1)
    work = np.empty((widest + 1) * BLOCK)
    table = np.empty(max(1, (layout.moves * layout.rows).max()))
    for player in range(2):
        _match_regrets(layout, state, player, work, table)
        _push_reach(layout, state, player)
    for t in range(begin, end):
        keep_gains = _discount_factor(t, alpha)
        keep_losses = _discount_factor(t, beta)
        weight = float(t) ** gamma
        for player in range(2):
            _add_regrets(layout, state, player, work)
            _add_strategy(layout, state, player, weight)
            if alternating:
                _discount(layout, state, player, keep_gains, keep_losses)
                _match_regrets(layout, state, player, work, table)
                _push_reach(layout, state, player)
        if not alternating:
            for player in range(2):
                _discount(layout, state, player, keep_gains, keep_losses)
                _match_regrets(layout, state, player, work, table)
                _push_reach(layout, state, player)


@kernel
def _discount_factor(t, exponent):
    """Return t^e / (t^e + 1): 1 for an infinite exponent, 0 for minus infinity."""
    if exponent == np.inf:
        return 1.0
    if exponent == -np.inf:
        return 0.0
    power = float(t) ** exponent
    return power / (power + 1.0)


@kernel
def _match_regrets(layout, state, player, work, table):
    """Write strategies in proportion to positive regrets, then copy them to every node.

    Strategies are uniform if no regret is positive.
    """
    for k in range(layout.nodes.size):
        moves, rows, nodes = layout.moves[player, k], layout.rows[player, k], layout.nodes[k]
        regrets = state.regrets[layout.regret_at[player, k] :]
        sigma = state.sigma[layout.sigma_at[player, k] :]
        single = layout.single[player, k]
        target = sigma if single else table
        even = 1.0 / moves
        for low in range(0, rows, BLOCK):
            n = min(BLOCK, rows - low)
            total = work[:n]
            for j in range(n):
                total[j] = 0.0
            for a in range(moves):
                r = regrets[a * rows + low : a * rows + low + n]
                for j in range(n):
                    total[j] += max(r[j], 0.0)
            for a in range(moves):
                r = regrets[a * rows + low : a * rows + low + n]
                s = target[a * rows + low : a * rows + low + n]
                for j in range(n):
                    # Divided without a branch, so that the loop becomes vector instructions; 0 / 0
                    # is replaced below.
                    share = max(r[j], 0.0) / total[j]
                    s[j] = share if total[j] > 0.0 else even
        if not single:
            labels = layout.labels[layout.label_at[player, k] :]
            for a in range(moves):
                for j in range(nodes):
                    sigma[a * nodes + j] = table[a * rows + labels[j]]


@kernel
def _push_reach(layout, state, player):
    """Write the probability of a player's own moves, from the root down."""
    for k in range(layout.nodes.size - 1):
        nodes, first, second = layout.nodes[k], layout.moves[0, k], layout.moves[1, k]
        sigma = state.sigma[layout.sigma_at[player, k] :]
        own_reach = state.reach[player, layout.node_at[k] : layout.node_at[k] + nodes]
        below = state.reach[player, layout.node_at[k + 1] :]
        for a in range(first):
            for b in range(second):
                own = a if player == 0 else b
                s = sigma[own * nodes : (own + 1) * nodes]
                target = below[(a * second + b) * nodes : (a * second + b + 1) * nodes]
                for j in range(nodes):
                    target[j] = own_reach[j] * s[j]


@kernel
def _add_regrets(layout, state, player, work):
    """Write the values of all nodes, from the last level up, and add a player's regrets."""
    other = 1 - player
    sign = 1.0 if player == 0 else -1.0
    for k in range(layout.nodes.size - 1, -1, -1):
        nodes, rows, single = layout.nodes[k], layout.rows[player, k], layout.single[player, k]
        own_moves, other_moves = layout.moves[player, k], layout.moves[other, k]
        own_step = layout.moves[1, k] if player == 0 else 1
        other_step = 1 if player == 0 else layout.moves[1, k]
        own_sigma = state.sigma[layout.sigma_at[player, k] :]
        other_sigma = state.sigma[layout.sigma_at[other, k] :]
        children = state.values[layout.node_at[k + 1] :]
        regrets = state.regrets[layout.regret_at[player, k] :]
        reached = state.opponent_reach[layout.row_at[player, k] :]
        labels = layout.labels[layout.label_at[player, k] :]
        for low in range(0, nodes, BLOCK):
            n = min(BLOCK, nodes - low)
            at = layout.node_at[k] + low
            value = state.values[at : at + n]
            for j in range(n):
                value[j] = 0.0
            for a in range(own_moves):
                q = work[(a + 1) * BLOCK : (a + 1) * BLOCK + n]
                for j in range(n):
                    q[j] = 0.0
                for b in range(other_moves):
                    place = (a * own_step + b * other_step) * nodes + low
                    child = children[place : place + n]
                    s = other_sigma[b * nodes + low : b * nodes + low + n]
                    for j in range(n):
                        q[j] += child[j] * s[j]
                s = own_sigma[a * nodes + low : a * nodes + low + n]
                for j in range(n):
                    value[j] += q[j] * s[j]
            weight = work[:n]
            reach = state.reach[other, at : at + n]
            chance = layout.chance[at : at + n]
            for j in range(n):
                # Regrets are counterfactual: weighted by all probabilities but the player's own
                # moves.
                weight[j] = reach[j] * chance[j]
            if single:
                infoset_reach = reached[low : low + n]
                for j in range(n):
                    infoset_reach[j] += weight[j]
                for a in range(own_moves):
                    q = work[(a + 1) * BLOCK : (a + 1) * BLOCK + n]
                    r = regrets[a * rows + low : a * rows + low + n]
                    for j in range(n):
                        r[j] += sign * weight[j] * (q[j] - value[j])
            else:
                for j in range(n):
                    reached[labels[low + j]] += weight[j]
                for a in range(own_moves):
                    for j in range(n):
                        gain = sign * weight[j] * (work[(a + 1) * BLOCK + j] - value[j])
                        regrets[a * rows + labels[low + j]] += gain


@kernel
def _add_strategy(layout, state, player, weight):
    """Sum the current strategies, weighted by the probability of the player's own moves."""
    for k in range(layout.nodes.size):
        moves, rows, nodes = layout.moves[player, k], layout.rows[player, k], layout.nodes[k]
        sigma = state.sigma[layout.sigma_at[player, k] :]
        sums = state.sums[layout.regret_at[player, k] :]
        reach = state.reach[player, layout.node_at[k] : layout.node_at[k] + nodes]
        # Most trees of races show all past moves: no labels to look up, and straight loops.
        if layout.single[player, k]:
            for a in range(moves):
                s = sigma[a * nodes : (a + 1) * nodes]
                total = sums[a * nodes : (a + 1) * nodes]
                for j in range(nodes):
                    total[j] += weight * reach[j] * s[j]
        else:
            first = layout.first[layout.row_at[player, k] :]
            for a in range(moves):
                for row in range(rows):
                    j = first[row]
                    sums[a * rows + row] += weight * reach[j] * sigma[a * nodes + j]


@kernel
def _discount(layout, state, player, keep_gains, keep_losses):
    """Shrink positive and negative cumulative regrets."""
    # Vanilla CFR discounts nothing; a multiplication with 1 would cost a pass over all regrets.
    if keep_gains == 1.0 and keep_losses == 1.0:
        return
    last = layout.nodes.size - 1
    begin = layout.regret_at[player, 0]
    end = layout.regret_at[player, last] + layout.moves[player, last] * layout.rows[player, last]
    regrets = state.regrets[begin:end]
    for j in range(regrets.size):
        r = regrets[j]
        regrets[j] = r * keep_gains if r > 0.0 else r * keep_losses
    # Regrets per visit are divided by this sum, so both are discounted alike.
    if keep_gains != 1.0:
        rows = layout.rows[player, last]
        reached = state.opponent_reach[
            layout.row_at[player, 0] : layout.row_at[player, last] + rows
        ]
        for j in range(reached.size):
            reached[j] *= keep_gains
