"""Racers of tournaments as opponents in the environments, by name."""

import subprocess
import sys

import gymnasium as gym
from refusal import refused

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.envs.duel import DuelEnv


def test_a_name_without_a_network_for_the_game_says_what_is_missing():
    """Two agents are shipped for the contest alone."""
    for name in ("psro", "self-play"):
        refused(f"'{name}'", DuelEnv, error=UnknownNameError, opponent=name)


def test_a_policy_of_a_set_is_drawn_for_each_episode():
    envs = gym.make_vec(
        "pcs_racing/Duel-v1", num_envs=60, opponent="lane-switcher:any", steps=(0.1,) * 2
    )
    envs.reset(seed=0)
    drawn = {tuple(theta) for theta in envs.unwrapped.batch.state.theta[:, 1]}
    assert len(drawn) > 10


def test_the_first_package_knows_its_own_opponents_without_the_second():
    code = (
        "import sys\n"
        "from pcs_racing.envs.duel import DuelEnv\n"
        "DuelEnv(opponent=['random-moves', 'never-switch', 'always-stay'])\n"
        "print(any(name.startswith('pcs_racing_agents') for name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
