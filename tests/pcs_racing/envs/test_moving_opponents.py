"""An agent as the opponent of a drive: it watches, observes and moves as in a game."""

from itertools import pairwise

import numpy as np
from slow_follower import slow_follower

from pcs_racing import make_game
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.race.state import ITTC_SAMPLES

STEP = 8.0  # s between two moves


class Watcher:
    """Store the observation, and move to less aggressiveness."""

    name = "watcher"

    def __init__(self):
        self.seen = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.seen.append(observation[0].copy())
        return np.ones(len(observation), np.int64), None


def race_of(env, seed, seconds):
    """States of a race every 8 s and, right after each, the parameters of the opponent; None if it
    ends before.
    """
    env.reset(seed=seed)
    states, parameters = [env.batch.state.copy()], [env.batch.theta[0, 1].copy()]
    while env.batch.state.tick[0] * 0.01 < seconds:
        if env.step(slow_follower(env))[2]:
            return None
        if round(env.batch.state.tick[0] * 0.01 / STEP, 6).is_integer():
            states.append(env.batch.state.copy())
            parameters.append(env.batch.theta[0, 1].copy())
    return states, parameters


def test_what_it_observes_and_drives_is_what_a_game_says():
    game = make_game("Tarnfjord")
    for seed in range(20):
        watcher = Watcher()
        race = race_of(DriveEnv(track="Tarnfjord", opponent=watcher), seed, 2 * STEP + 0.1)
        if race is not None:
            break
    assert race is not None, "every race ends in a crash"
    states, parameters = race
    # restraint is measured while such an opponent drives
    assert (states[-1].sums[0, :, ITTC_SAMPLES] > 0.0).all()
    index = {element.name: i for i, element in enumerate(game.observation_elements)}
    axes = [axis.name for axis in game.characteristics]
    for step, (before, after) in enumerate(pairwise(states)):
        estimate = game.measure(before, after)[0, 0]  # of car 0, which it races against
        seen = [watcher.seen[step][index[f"opponent_{axis}_{step}"]] for axis in axes]
        np.testing.assert_allclose(seen, estimate, atol=1e-6)
        assert watcher.seen[step][index["step"]] == step / game.rules.moves
    policies = [
        int(np.flatnonzero((game.theta(np.arange(len(game.archive))) == p).all(axis=1))[0])
        for p in parameters
    ]
    assert policies[1:3] == [game.table[policies[0], 1], game.table[game.table[policies[0], 1], 1]]
