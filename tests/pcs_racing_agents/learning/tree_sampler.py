"""Samples of small game trees for self-play, and the average strategy on them, whose exploitability
is exact.
"""

from dataclasses import dataclass

import numpy as np

from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.agents.from_network import regret_matching
from pcs_racing_agents.networks import NetworkSet
from pcs_racing_agents.solvers import GameTree, uniform_profile


@dataclass(frozen=True, eq=False)
class TreeSampler:
    """External sampling on a game tree; what a player observes is which of all infosets it is in.

    Games with an even number are traversed by player 0, the others by player 1. Both have one
    network.
    """

    tree: GameTree

    @property
    def size(self) -> int:
        return sum(self.tree.rows(k, player) for k in range(self.steps) for player in (0, 1))

    @property
    def moves(self) -> int:
        return max(max(pair) for pair in self.tree.moves)

    @property
    def identity(self) -> GameIdentity:
        counts = ("set", self.size), ("m", self.moves)
        elements, moves = (tuple(f"{word} {i}" for i in range(n)) for word, n in counts)
        return GameIdentity(elements, moves, (0.5,), "toy", "0" * 64, "toy", self.steps)

    @property
    def steps(self) -> int:
        return self.tree.depth

    def observed(self, level: int, player: int, nodes: np.ndarray) -> np.ndarray:
        before = [self.tree.rows(k, p) for k in range(self.steps) for p in (0, 1)]
        offset = sum(before[: 2 * level + player])
        return np.eye(self.size, dtype=np.float32)[
            offset + self.tree.infosets[level][player][nodes]
        ]

    def chances(self, network, exploration, level, player, nodes) -> np.ndarray:
        count = self.tree.moves[level][player]
        if network is None:
            return np.full((len(nodes), count), 1.0 / count)
        values = network.unclipped(self.observed(level, player, nodes))[:, :count]
        return (1.0 - exploration) * regret_matching(values) + exploration / count

    def play(self, network, exploration, levels, nodes, player, rng, uniform=False) -> np.ndarray:
        for level in levels:
            drawn = []
            for car in (0, 1):
                free = uniform and car == player
                chances = self.chances(None if free else network, exploration, level, car, nodes)
                drawn.append(
                    (rng.random((len(nodes), 1)) >= np.cumsum(chances, axis=1)).sum(axis=1)
                )
                drawn[-1] = np.minimum(drawn[-1], chances.shape[1] - 1)
            nodes = (nodes * self.tree.moves[level][0] + drawn[0]) * self.tree.moves[level][
                1
            ] + drawn[1]
        return nodes

    def traverse(self, network, exploration, step, keys):
        blocks = [self.one_player(network, exploration, step, keys, player) for player in (0, 1)]
        return {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}

    def one_player(self, network, exploration, step, keys, player):
        games = np.flatnonzero(np.arange(len(keys)) % 2 == player)
        count = self.tree.moves[step][player]
        if count < self.moves:  # it has no choice here
            games = games[:0]
        rng = np.random.default_rng([int(keys[0]), player])
        roots = rng.choice(len(self.tree.chance), len(games), p=self.tree.chance)
        nodes = self.play(network, exploration, range(step), roots, player, rng, uniform=True)
        outcomes = np.zeros((len(games), self.moves))
        a, b = self.tree.moves[step]
        chances = self.chances(network, exploration, step, 1 - player, nodes)
        passed = rng.random((len(games), 1)) >= np.cumsum(chances, axis=1)
        other = np.minimum(passed.sum(axis=1), chances.shape[1] - 1)
        for move in range(self.moves if len(games) else 0):
            pair = (move, other) if player == 0 else (other, move)
            children = (nodes * a + pair[0]) * b + pair[1]
            leaves = self.play(
                network, exploration, range(step + 1, self.steps), children, player, rng
            )
            outcomes[:, move] = (1 - 2 * player) * self.tree.payoffs.reshape(-1)[leaves]
        own = (
            self.chances(network, exploration, step, player, nodes)
            if len(games)
            else np.zeros((0, self.moves))
        )
        return {
            "observations": self.observed(step, player, nodes),
            "advantages": outcomes - (own * outcomes).sum(axis=1, keepdims=True),
            "game": games,
        }

    def average(self, networks: NetworkSet):
        """The strategy of drawing a network for each game, as a profile: weighted by each one's own
        reach.
        """
        profile = uniform_profile(self.tree)
        sums = [[np.zeros_like(strategy) for strategy in pair] for pair in profile]
        for network, weight in zip(networks.networks, networks.weights, strict=True):
            reach = [np.full(self.tree.nodes(0), weight) for _ in (0, 1)]
            for k in range(self.steps):
                nodes = np.arange(self.tree.nodes(k))
                following = []
                for player in (0, 1):
                    chances = self.chances(network, 0.0, k, player, nodes)
                    rows = self.tree.infosets[k][player]
                    first = np.unique(rows, return_index=True)[1]
                    sums[k][player][rows[first]] += (reach[player][:, None] * chances)[first]
                    following.append(reach[player][:, None] * chances)
                if k + 1 < self.steps:
                    a, b = self.tree.moves[k]
                    reach = [
                        np.repeat(following[0], b, axis=1).reshape(-1),
                        np.tile(following[1], (1, a)).reshape(-1),
                    ]
        return [tuple(_shares(rows) for rows in pair) for pair in sums]


def _shares(sums: np.ndarray) -> np.ndarray:
    """Rows as probabilities; evenly where no network ever comes."""
    total = sums.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, sums / np.where(total > 0.0, total, 1.0), 1.0 / sums.shape[1])
