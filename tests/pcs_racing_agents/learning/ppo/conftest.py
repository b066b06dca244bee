"""Trainings of a second: short games on one small circuit."""

import pytest

from pcs_racing_agents.learning.ppo.settings import DuelSettings

SMALL = {
    "tracks": ("Pipkin",),
    "hidden": (8,),
    "value_hidden": (8,),
    "batch_size": 32,
    "epochs": 2,
    "evaluation_races": 4,
}


@pytest.fixture(scope="session")
def duel_settings():
    return DuelSettings(
        **SMALL,
        opponents={"random-moves": 2, "never-switch": 1, "pure-pursuit": 1},
        steps=64,
        envs=4,
        rollout=4,
        evaluate_every=32,
    )
