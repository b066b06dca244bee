"""Evaluation of behaviour profiles: values, reach, action values, best responses, exploitability.

Plain array code for all trees and all observations. It shares no code with the solvers,
so it can judge them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.game_tree import Floats, GameTree, Integers

Profile = list[tuple[Floats, Floats]]
"""Strategies of car 0, shape (rows, A_k), and car 1, shape (rows, B_k), for each level.

A row is a distribution.
"""

SUM_TOLERANCE = 1e-5  # networks have float32 outputs


class BestResponse(NamedTuple):
    """A best response to the other player's strategy of a profile."""

    value: float  #: Value of the best response to its player.
    strategy: list[Floats]  #: Pure best response of each level, shape (rows, M_k).
    #: Expected value of each move to its player, with best responses afterwards, shape (rows, M_k).
    q: list[Floats]


class Exploitability(NamedTuple):
    """Exploitability of a profile, by player and in total."""

    nash_conv: float  #: Sum of both players' gains by a best response; 0 in an equilibrium.
    exploitability: float  #: Half of ``nash_conv``.
    gains: Floats  #: shape (2,): Gain of each player.
    value: float  #: Payoff of the profile to car 0.
    #: shape (2,): Payoff of each player's best response to the other player's strategy.
    best_responses: Floats


def uniform_profile(tree: GameTree) -> Profile:
    """Return the profile that plays every move with the same probability."""

    def strategy(k: int, player: int) -> Floats:
        count = tree.moves[k][player]
        return np.full((tree.rows(k, player), count), 1.0 / count)

    return [(strategy(k, 0), strategy(k, 1)) for k in range(tree.depth)]


def check_profile(tree: GameTree, profile: list[tuple[ArrayLike, ArrayLike]] | Profile) -> Profile:
    """Return a profile as float64, with rows that sum up to 1."""
    if len(profile) != tree.depth or any(len(pair) != 2 for pair in profile):
        raise InputError(
            f"a profile of this tree has {tree.depth} pairs of strategies, one for each level"
        )
    checked = []
    for k, pair in enumerate(profile):
        both = []
        for player in (0, 1):
            strategy = np.asarray(pair[player], dtype=np.float64)
            wanted = (tree.rows(k, player), tree.moves[k][player])
            if strategy.shape != wanted:
                raise InputError(
                    f"level {k}, car {player}: a strategy has shape {strategy.shape}; it must be"
                    f" {wanted}"
                )
            total = strategy.sum(axis=1)
            wrong = np.flatnonzero(
                ~((strategy >= 0.0).all(axis=1) & (np.abs(total - 1.0) <= SUM_TOLERANCE))
            )
            if len(wrong):
                raise InputError(
                    f"level {k}, car {player}, row {int(wrong[0])}: {strategy[wrong[0]].tolist()}"
                    " is no distribution; probabilities are at least 0 and sum up to 1"
                )
            both.append(strategy / total[:, None])
        checked.append((both[0], both[1]))
    return checked


def reach_probabilities(tree: GameTree, profile: Profile) -> list[tuple[Floats, Floats]]:
    """Return, for each level, the probability that each player's own moves lead to each node.

    Arrays have shape (nodes,). The probability of a node is the product of both and of its root's
    chance.
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
    """Return the expected payoff to car 0 at every node if both players follow the profile.

    The list covers levels 0 to m, shape (nodes,) each.
    """
    sigma = _at_nodes(tree, check_profile(tree, profile))
    values = [tree.payoffs.reshape(-1)]
    for first, second in reversed(sigma):
        across = np.einsum("nab,nb->na", _children(values[-1], first, second), second)
        values.append((across * first).sum(axis=1))
    return values[::-1]


def play_value(tree: GameTree, profile: Profile) -> float:
    """Return the expected payoff to car 0 if both players follow the profile."""
    tree = tree.averaged
    return float((tree.chance * node_values(tree, profile)[0]).sum())


def best_response(tree: GameTree, profile: Profile, player: int) -> BestResponse:
    """Compute a player's best response to the other player's strategy of a profile.

    From the last level up, each infoset takes the move with the max expected value. Its nodes are
    weighted by the probability that chance and the other player lead there; with perfect recall the
    weights do not depend on the player's own moves. Among equal moves the first one is taken.

    Parameters
    ----------
    profile : Profile
        Strategies of both players; the strategies of ``player`` are not used.
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
        # One move for the whole infoset, although another might be better at this node: the player
        # can't distinguish its nodes.
        values = np.take_along_axis(at_nodes, best[tree.infosets[k][player]][:, None], axis=1)[:, 0]
    return BestResponse(float((tree.chance * values).sum()), strategy[::-1], q[::-1])


def exploitability(tree: GameTree, profile: Profile) -> Exploitability:
    """Measure the distance of a profile from an equilibrium (NashConv; Lanctot et al. 2017)."""
    value = play_value(tree, profile)
    best = np.array([best_response(tree, profile, player).value for player in (0, 1)])
    gains = best - [value, -value]
    return Exploitability(float(gains.sum()), float(gains.sum()) / 2.0, gains, value, best)


def _at_nodes(tree: GameTree, profile: Profile) -> Profile:
    """Return strategies with a row per node."""
    return [
        (s0[rows0], s1[rows1])
        for (s0, s1), (rows0, rows1) in zip(profile, tree.infosets, strict=True)
    ]


def _children(values: Floats, first: Floats, second: Floats) -> Floats:
    return values.reshape(len(first), first.shape[1], second.shape[1])


def _over_infosets(
    tree: GameTree, level: int, player: int, at_nodes: Floats, other_reach: Floats
) -> Floats:
    """Return means of node values over each infoset, weighted by chance and the other's reach."""
    rows: Integers = tree.infosets[level][player]
    count = tree.rows(level, player)
    if count == len(rows):
        # Every infoset is a node, and they are numbered in the order of the nodes.
        return at_nodes
    weights = other_reach * np.repeat(tree.chance, len(rows) // tree.roots)
    # All nodes count equally if the other player never comes: their weights would sum up to 0.
    never = np.bincount(rows, weights, count)[rows] == 0.0
    weights = np.where(never, 1.0, weights)
    total = np.bincount(rows, weights, count)
    columns = [np.bincount(rows, weights * column, count) / total for column in at_nodes.T]
    return np.stack(columns, axis=1)
