"""A table of behaviours in which the opponents are easy to tell apart."""

import numpy as np

from pcs_racing_agents.agents import Setting
from studies.matches.behaviours import Behaviours


def made_up_behaviours(setting: Setting, opponents: int = 3) -> Behaviours:
    """Opponents that are told by their first coordinate, 0, 0.5 and 1; the best reply to opponent j is policy j."""
    policies, width = len(setting.archive), len(setting.archive.characteristics) + 2
    seen = np.zeros((policies, opponents, width))
    seen[:, :, 0] = np.linspace(0.0, 1.0, opponents)
    seen[:, :, -1] = 1.0
    scores = np.full((policies, opponents), 0.4)
    scores[np.arange(opponents), np.arange(opponents)] = 0.9
    scores[opponents] = 0.6  # best on average, best against nobody
    game = setting.identity._replace(elements=(), moves=())
    return Behaviours(game, tuple(f"rival {j}" for j in range(opponents)), scores, seen, 0.01 * np.eye(width))
