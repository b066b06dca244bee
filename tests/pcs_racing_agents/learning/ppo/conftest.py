"""Trainings of a second: short games and races on one small circuit."""

import pytest

from pcs_racing_agents.learning.ppo.settings import DriveSettings, DuelSettings

SMALL = {
    "tracks": ("Pipkin",),
    "hidden": (8,),
    "value_hidden": (8,),
    "batch_size": 32,
    "epochs": 2,
    "evaluation_races": 4,
}


@pytest.fixture(scope="session")
def short_rules(tmp_path_factory):
    """Rules with noise for races of 2 s, as a file."""
    file = tmp_path_factory.mktemp("rules") / "short.yaml"
    file.write_text("preset: contest\nname: short\nduration: 2.0\n")
    return str(file)


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


@pytest.fixture(scope="session")
def drive_settings(short_rules):
    return DriveSettings(
        **SMALL,
        opponents={"lattice:pace=0": 1, "pure-pursuit": 1},
        races=(short_rules,),
        duration=1.0,
        steps=640,
        envs=8,
        rollout=20,
        evaluate_every=320,
    )
