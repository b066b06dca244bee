"""All racers of tournaments are opponents in the environments, by name and as an object."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from refusal import refused

import pcs_racing_agents
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.envs.duel import DuelEnv, HeadToHeadEnv

SHORT = {"steps": (0.4,) * 5}
UNTRAINED = {"psro", "self-play"}
"""Agents that are shipped for the contest alone; of these games they say so."""
NAMES = [name for name in pcs_racing_agents.agents.names() if name not in UNTRAINED]


@pytest.mark.parametrize("name", NAMES)
def test_every_name_and_every_object_is_an_opponent_of_all_environments(name):
    """By the paper's rules an agent under training can't stay, but its opponent may."""
    for opponent in (name, pcs_racing_agents.make(name)):
        env = DuelEnv(opponent=opponent, **SHORT)
        env.reset(seed=1)
        *_, info = env.step(1)
        assert env.action_space.n == 4
        assert env.outcome()["opponent"].replace(" ", "") == name
        drives = name == "random-policy"
        assert (info["opponent_move"] == -1) is drives
    assert list(HeadToHeadEnv(opponent=name, **SHORT).reset(seed=1)[0]) == ["car_0"]
    drive = gym.make("pcs_racing/Drive-v1", opponent=name)
    drive.reset(seed=1)
    *_, info = drive.step(np.array([0.0, -0.5], np.float32))
    assert info["opponent"] == 0


def test_a_name_without_a_network_for_the_game_says_what_is_missing():
    for name in sorted(UNTRAINED):
        refused(f"'{name}'", DuelEnv, error=UnknownNameError, opponent=name, **SHORT)


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
