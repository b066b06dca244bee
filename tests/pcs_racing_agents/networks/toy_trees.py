"""Trees of made-up payoffs in place of races: the players see the moves so far, and perhaps the
seed.
"""

from dataclasses import dataclass, field

import numpy as np

from pcs_racing_agents.solvers import GameTree


@dataclass(frozen=True)
class ToyTree:
    payoffs: np.ndarray  # (S, (A * A)**m)
    moves: int = 2
    options: int = 3
    policies: tuple[int, int] = (0, 1)
    ended: dict = field(default_factory=dict)  # level -> array (S, N_k)
    sees_seed: bool = False

    @property
    def over(self):
        return [
            self.ended.get(k, np.zeros((len(self.payoffs), self.nodes(k)), bool))
            for k in range(self.moves)
        ]

    def nodes(self, level):
        return self.options ** (2 * level)

    def game_tree(self):
        return GameTree.from_payoffs(
            self.payoffs.mean(axis=0).reshape((self.options,) * (2 * self.moves))
        )

    def observations(self, level):
        """One-hot own and other moves of each step, then the step, the car, and the seed if they
        see it.
        """
        a, m, count = self.options, self.moves, self.nodes(level)
        seen = np.zeros((len(self.payoffs), count, 2, 2 * a * m + 3), np.float32)
        for k in range(level):
            joint = np.arange(count) // a ** (2 * (level - 1 - k)) % a**2
            for player in (0, 1):
                own, other = (joint // a, joint % a)[:: 1 - 2 * player]
                seen[:, np.arange(count), player, 2 * a * k + own] = 1.0
                seen[:, np.arange(count), player, 2 * a * k + a + other] = 1.0
        seen[..., -3] = level
        seen[:, :, 1, -2] = 1.0
        if self.sees_seed:
            seen[..., -1] = np.arange(len(self.payoffs))[:, None, None]
        return seen


def random_tree(seeds=1, moves=2, options=3, seed=0, **changes) -> ToyTree:
    rng = np.random.default_rng(seed)
    payoffs = rng.normal(0.0, 10.0, (seeds, options ** (2 * moves)))
    return ToyTree(payoffs, moves, options, **changes)
