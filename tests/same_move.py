"""A competitor for tests of what is done with one."""

import numpy as np


class Model:
    """Stands in for a trained model, with no name but that of its class; it always makes the same
    move.
    """

    def __init__(self, move=0):
        self.move = move

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.full(len(observation), self.move), None
