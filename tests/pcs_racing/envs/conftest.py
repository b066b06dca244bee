import numpy as np
import pytest

from pcs_racing import PolicyArchive, get_planner


@pytest.fixture(scope="package")
def archive() -> PolicyArchive:
    """Six policies from slow to fast, with coordinates that were made up."""
    planner = get_planner("lattice")
    pace = np.linspace(0.3, 0.9, 6)
    parameters = np.array([planner.policy({"pace": value}).parameters for value in pace])
    coordinates = np.column_stack([20.0 * pace - 10.0, [4.0, 3.0, 3.5, 2.0, 2.5, 1.0]])
    axes = ("aggressiveness", "restraint")
    return PolicyArchive("six", "lattice", planner.parameter_names, parameters, axes, coordinates)


@pytest.fixture
def short(archive):
    """Arguments of matches whose races take no time."""
    return {"archive": archive, "track": "Pipkin", "step_seconds": 0.5, "moves": 1, "race": "contest"}
