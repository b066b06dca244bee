"""Evaluation of behaviour profiles: values, reach, action values, best responses and exploitability.

Plain array code for every tree, whatever the players see. It shares nothing with the solvers, so it judges them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.game_tree import Floats, GameTree, Integers

Profile = list[tuple[Floats, Floats]]
"""For each level the strategies of car 0, shape (rows, A_k), and car 1, shape (rows, B_k): a distribution per row."""

SUM_TOLERANCE = 1e-5  # networks answer in float32


class BestResponse(NamedTuple):
    """A best response to the other player's strategy of a profile."""

    value: float  #: What it then gets.
    strategy: list[Floats]  #: One pure best response for each level, shape (rows, M_k).
    #: Value of each move to it in expectation, if it goes on with best responses, shape (rows, M_k).
    q: list[Floats]


class Exploitability(NamedTuple):
    """The exploitability of a profile, by player and in total."""

    nash_conv: float  #: Sum of what both players would gain by a best response; 0 in an equilibrium.
    exploitability: float  #: Half of that.
    gains: Floats  #: shape (2,): What each player would gain.
    value: float  #: What the profile pays to car 0.
    best_responses: Floats  #: shape (2,): What each player gets at best against the other's half.


def uniform_profile(tree: GameTree) -> Profile:
    """Return the profile that plays every move with the same probability."""

    def strategy(k: int, player: int) -> Floats:
        count = tree.moves[k][player]
        return np.full((tree.rows(k, player), count), 1.0 / count)

    return [(strategy(k, 0), strategy(k, 1)) for k in range(tree.depth)]


def check_profile(tree: GameTree, profile: list[tuple[ArrayLike, ArrayLike]] | Profile) -> Profile:
    """Return a profile as float64 whose rows sum up to 1."""
    if len(profile) != tree.depth or any(len(pair) != 2 for pair in profile):
        raise InputError(f"a profile of this tree has {tree.depth} pairs of strategies, one for each level")
    checked = []
    for k, pair in enumerate(profile):
        both = []
        for player in (0, 1):
            strategy = np.asarray(pair[player], dtype=np.float64)
            wanted = (tree.rows(k, player), tree.moves[k][player])
            if strategy.shape != wanted:
                raise InputError(f"level {k}, car {player}: a strategy has shape {strategy.shape}; it must be {wanted}")
            total = strategy.sum(axis=1)
            wrong = np.flatnonzero(~((strategy >= 0.0).all(axis=1) & (np.abs(total - 1.0) <= SUM_TOLERANCE)))
            if len(wrong):
                raise InputError(
                    f"level {k}, car {player}, row {int(wrong[0])}: {strategy[wrong[0]].tolist()} is no distribution; "
                    "probabilities are at least 0 and sum up to 1"
                )
            both.append(strategy / total[:, None])
        checked.append((both[0], both[1]))
    return checked


def reach_probabilities(tree: GameTree, profile: Profile) -> list[tuple[Floats, Floats]]:
    """For each level, the probability with which each player's own moves lead to each node, shape (nodes,) each.

    A node is reached with the product of both and of its root's chance.
    """
    sigma = _at_nodes(tree, check_profile(tree, profile))
    reach = [(np.ones(tree.roots), np.ones(tree.roots))]
    for k in range(tree.depth - 1):
        (own, other), (first, second) = reach[k], sigma[k]
        shape = (*first.shape, second.shape[1])
        down = np.broadcast_to((own[:, None] * first)[:, :, None], shape)
        across = np.broadcast_to((other[:, None] * second)[:, None, :], shape)
        reach.append((down.reshape(-1), across.reshape(-1)))
    return reach


def node_values(tree: GameTree, profile: Profile) -> list[Floats]:
    """Expected payoff to car 0 at every node of levels 0 to m if both follow the profile, shape (nodes,) each."""
    sigma = _at_nodes(tree, check_profile(tree, profile))
    values = [tree.payoffs.reshape(-1)]
    for first, second in reversed(sigma):
        across = np.einsum("nab,nb->na", _children(values[-1], first, second), second)
        values.append((across * first).sum(axis=1))
    return values[::-1]


def play_value(tree: GameTree, profile: Profile) -> float:
    """Expected payoff to car 0 if both follow the profile."""
    tree = tree.averaged
    return float((tree.chance * node_values(tree, profile)[0]).sum())


def q_values(tree: GameTree, profile: Profile) -> list[tuple[Floats, Floats]]:
    """Q-values: expected payoff of every move to the player who makes it, if both follow the profile afterwards.

    Returns
    -------
    list of (ndarray, ndarray)
        Shapes (rows, A_k) and (rows, B_k): expected over the nodes of an infoset, weighted with how often chance and
        the other player lead there (evenly where they never do), and over the other's move. For the value against a
        fixed opponent with best play from then on, see :func:`best_response`.
    """
    tree = tree.averaged
    profile = check_profile(tree, profile)
    sigma, values, reach = _at_nodes(tree, profile), node_values(tree, profile), reach_probabilities(tree, profile)
    result = []
    for k, (first, second) in enumerate(sigma):
        children = _children(values[k + 1], first, second)
        both = [np.einsum("nab,nb->na", children, second), -np.einsum("nab,na->nb", children, first)]
        for player in (0, 1):
            both[player] = _over_infosets(tree, k, player, both[player], reach[k][1 - player])
        result.append((both[0], both[1]))
    return result


def advantages(tree: GameTree, profile: Profile) -> list[tuple[Floats, Floats]]:
    """Advantages: the q-values of the moves minus their mean under the strategy."""
    return [
        (q0 - (q0 * s0).sum(axis=1, keepdims=True), q1 - (q1 * s1).sum(axis=1, keepdims=True))
        for (q0, q1), (s0, s1) in zip(q_values(tree, profile), check_profile(tree, profile), strict=True)
    ]


def best_response(tree: GameTree, profile: Profile, player: int) -> BestResponse:
    """Compute a player's best response to the other player's strategy of a profile.

    From the last level up, each infoset takes the move of highest expected value, weighting its nodes with how often
    chance and the other player lead there; with perfect recall the weights do not depend on the player's own moves.
    Among equal moves the first one is taken.

    Parameters
    ----------
    profile : Profile
        Its strategies of ``player`` play no role.
    player : {0, 1}
    """
    if player not in (0, 1):
        raise InputError(f"player is {player!r}; it must be 0 or 1")
    tree = tree.averaged
    profile = check_profile(tree, profile)
    sigma, reach = _at_nodes(tree, profile), reach_probabilities(tree, profile)
    # Value of each node to the player.
    values = tree.payoffs.reshape(-1) if player == 0 else -tree.payoffs.reshape(-1)
    strategy, q = [], []
    for k in reversed(range(tree.depth)):
        children = _children(values, *sigma[k])
        other = sigma[k][1 - player]
        at_nodes = np.einsum("nab,nb->na" if player == 0 else "nab,na->nb", children, other)
        at_rows = _over_infosets(tree, k, player, at_nodes, reach[k][1 - player])
        best = at_rows.argmax(axis=1)
        strategy.append(np.eye(at_rows.shape[1])[best])
        q.append(at_rows)
        # One move for the whole infoset, although another might be better at this node: the player can't tell them
        # apart.
        values = np.take_along_axis(at_nodes, best[tree.infosets[k][player]][:, None], axis=1)[:, 0]
    return BestResponse(float((tree.chance * values).sum()), strategy[::-1], q[::-1])


def exploitability(tree: GameTree, profile: Profile) -> Exploitability:
    """Measure how far a profile is from an equilibrium (NashConv; Lanctot et al. 2017)."""
    value = play_value(tree, profile)
    best = np.array([best_response(tree, profile, player).value for player in (0, 1)])
    gains = best - [value, -value]
    return Exploitability(float(gains.sum()), float(gains.sum()) / 2.0, gains, value, best)


def _at_nodes(tree: GameTree, profile: Profile) -> Profile:
    """Strategies with a row per node."""
    return [(s0[rows0], s1[rows1]) for (s0, s1), (rows0, rows1) in zip(profile, tree.infosets, strict=True)]


def _children(values: Floats, first: Floats, second: Floats) -> Floats:
    return values.reshape(len(first), first.shape[1], second.shape[1])


def _over_infosets(tree: GameTree, level: int, player: int, at_nodes: Floats, other_reach: Floats) -> Floats:
    """Mean of numbers per node over each infoset, weighted with chance and the other's reach."""
    rows: Integers = tree.infosets[level][player]
    count = tree.rows(level, player)
    if count == len(rows):
        # Every infoset is a node, and they are numbered in the order of the nodes.
        return at_nodes
    weights = other_reach * np.repeat(tree.chance, len(rows) // tree.roots)
    # Where the other player never comes, all nodes count equally: their weights would sum up to 0.
    never = np.bincount(rows, weights, count)[rows] == 0.0
    weights = np.where(never, 1.0, weights)
    total = np.bincount(rows, weights, count)
    columns = [np.bincount(rows, weights * column, count) / total for column in at_nodes.T]
    return np.stack(columns, axis=1)
