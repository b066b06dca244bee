import pytest

from pcs_racing import RaceGame, load_race_config, load_track, make_game, parse_policy
from pcs_racing_agents.tournament import (
    Tournament,
    play_tournament,
)

CONTEST = load_race_config("contest", duration=6.0)
POLICIES = [parse_policy(f"lattice:pace={pace}") for pace in (0.0, 0.5, 1.0)]
MIXED = ["random-moves", "best-fixed:target=3", "lane-switcher", POLICIES[1]]


@pytest.fixture(scope="session")
def contest(oval, archive) -> RaceGame:
    """Games with short steps."""
    return make_game(oval, archive, "contest", step_seconds=0.8)


@pytest.fixture(scope="session")
def tournament(oval) -> Tournament:
    return play_tournament([oval, load_track("Pipkin")], POLICIES, CONTEST, races_per_pair=6, seed=4)


@pytest.fixture(scope="session")
def mixed(oval, archive) -> Tournament:
    """Agents, a driver with variants, and a policy."""
    return play_tournament(oval, MIXED, CONTEST, archive=archive, races_per_pair=8, seed=1)
