import numpy as np
import pytest
from zoo_games import CONFIG, toy_archive, untrained

from pcs_racing import PolicyArchive, RaceGame
from pcs_racing_agents.agents import Setting, make_setting
from pcs_racing_agents.networks import RegretNetwork


@pytest.fixture(scope="session")
def archive() -> PolicyArchive:
    """Twelve policies of the lattice planner, from slow to fast."""
    return toy_archive()


@pytest.fixture(scope="session")
def setting(archive) -> Setting:
    """Games of 4 s by the paper's rules."""
    return make_setting(archive, CONFIG)


@pytest.fixture(scope="session")
def game(oval, setting) -> RaceGame:
    return RaceGame(oval, setting.archive, setting.config)


@pytest.fixture(scope="session")
def network(setting) -> RegretNetwork:
    return untrained(setting)


@pytest.fixture(scope="session")
def seen(game) -> list[np.ndarray]:
    """What both players saw before each move of some games and at their end, shape (B, D) for each step."""
    rng = np.random.default_rng(0)
    state = game.reset(games=20, seed=1)
    steps = []
    for _ in range(game.config.moves):
        steps.append(game.observation(state).reshape(40, -1))
        state = game.step(state, rng.integers(0, len(game.move_names), (20, 2)))
    return [*steps, game.observation(state).reshape(40, -1)]
