"""A small archive and short games on it, for the tests of agents and tournaments."""

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.race.config import Rules
from pcs_racing_agents.agents.describe import Measured
from pcs_racing_agents.networks import RegretNetwork

CONFIG = Rules(steps=(0.8,) * 5, epsilon=0.5)


def toy_archive(policies: int = 12) -> PolicyArchive:
    """Lattice policies from slow to fast; their coordinates are made up."""
    rng = np.random.default_rng(0)
    lattice = REFERENCE
    pace = np.linspace(0.2, 0.9, policies)
    parameters = [lattice.policy({"pace": value}).parameters for value in pace]
    explored = [lattice.policy({"pace": value}).parameters for value in np.linspace(0.0, 1.0, 30)]
    coordinates = np.stack([20.0 * pace - 10.0, 4.0 - 3.0 * pace], axis=1) + rng.normal(
        0.0, [1.5, 0.5], (policies, 2)
    )
    return PolicyArchive(
        "toy",
        "lattice",
        lattice.parameter_names,
        np.array(parameters),
        ("aggressiveness", "restraint"),
        coordinates,
        explored_parameters=np.array(explored),
        explored_coordinates=rng.normal(size=(30, 2)),
    )


def untrained(
    spec: RaceGame, target: str = "regret", seed: int = 2, stay: bool = True
) -> RegretNetwork:
    """A network that has learned nothing, but decides differently in different situations."""
    rng = np.random.default_rng(seed)
    moves = spec.moves if stay else spec.moves[:-1]
    size, count = len(spec.observation_elements), len(moves)
    archive = spec.archive
    identity = GameIdentity(
        spec.identity.elements, moves, (0.5,), archive.name, archive.content_hash, spec.rules.name
    )
    weights = rng.normal(size=(16, size)), rng.normal(size=(count, 16))
    layers = DenseLayers(weights, (rng.normal(size=16), rng.normal(size=count)))
    return RegretNetwork(
        f"untrained-{target}", identity, target, False, layers, np.zeros(size), np.ones(size)
    )


def measured_agent(archive: str, digest: str, against: dict[str, float]) -> Measured:
    """Return measurements of never-switch in the paper's race."""
    strength = {"races": 300.0, "score": 0.5, "rating": -12.0, "own_crash": 0.02}
    interval = {"rating_low": -40.0, "rating_high": 20.0}
    cost = {"one_us": 46.0, "many_us": 0.53}
    known = {"tracks": "Tarnfjord, Saltmere", **strength, **interval, **cost}
    return Measured(archive, "paper", "never-switch", digest, **known, against=against)
