from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pcs_racing import CONTEST, load_track, make_game
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track
from pcs_racing_agents.trees import RaceTree


@pytest.fixture(scope="session")
def track() -> Track:
    return load_track("Tarnfjord")


@pytest.fixture(scope="session")
def archive() -> PolicyArchive:
    """Nine policies from slow to fast; made up, so that no other archive of the project decides
    what is tested.
    """
    pace = np.linspace(0.05, 0.95, 9)
    odd = np.arange(9) % 2
    values = [{"pace": p, "side_margin": 0.25 + 0.1 * o} for p, o in zip(pace, odd, strict=True)]
    theta = [REFERENCE.policy(one).parameters for one in values]
    coordinates = np.stack([20.0 * pace - 10.0, 2.0 - pace + 0.7 * odd], axis=1)
    names = ("aggressiveness", "restraint")
    return PolicyArchive(
        "tiny", "lattice", REFERENCE.parameter_names, np.array(theta), names, coordinates
    )


@pytest.fixture(scope="session")
def paper(track, archive) -> RaceGame:
    """Short games without noise."""
    return make_game(track, archive, steps=(2.0,) * 3, epsilon=0.35)


@pytest.fixture(scope="session")
def noisy(track, archive) -> RaceGame:
    """Games with noise and some crashes."""
    return make_game(
        track,
        archive,
        replace(CONTEST, steering_noise=0.03, utility="win", fault_penalty=0.0),
        steps=(6.0,) * 3,
        epsilon=0.35,
    )


@pytest.fixture(scope="session")
def far(track, archive) -> RaceGame:
    """Games of cars that start out of each other's sight, some with crashes."""
    rules = {
        "steps": (6.0,) * 4,
        "utility": "lead-at-crash",
        "fault_penalty": 3.0,
        "epsilon": 0.35,
    }
    contest = replace(CONTEST, name="far", start_gap=20.0, front_pace=(1.0, 1.0))
    return make_game(track, archive, contest, **rules)


@pytest.fixture(scope="session")
def played() -> Callable[..., GameState]:
    """Play histories of moves (n, k, 2) from a tree's start with the game itself."""

    def play(game: RaceGame, tree: RaceTree, seed: int, histories: np.ndarray) -> GameState:
        n = len(histories)
        starts = Starts(np.full(n, tree.start_s), np.full(n, tree.side))
        state = game.reset(np.full(n, tree.seeds[seed]), policies=tree.policies, starts=starts)
        for k in range(histories.shape[1]):
            state = game.step(state, histories[:, k])
        return state

    return play


@pytest.fixture(scope="session")
def number() -> Callable[..., np.ndarray]:
    """Nodes that histories (n, k, 2) of so many options lead to."""

    def count(histories: np.ndarray, options: int) -> np.ndarray:
        nodes = np.zeros(len(histories), np.int64)
        for k in range(histories.shape[1]):
            nodes = (nodes * options + histories[:, k, 0]) * options + histories[:, k, 1]
        return nodes

    return count
