"""Fixtures that every test may use: the project's own tracks, and real maps and reference data where they are at hand."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The first example of a compiled function includes its compilation: timing examples would test the machine.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

REPOSITORY = Path(__file__).resolve().parent.parent


def _folder(variable: str, default: Path, what: str) -> Path:
    folder = Path(os.environ.get(variable, default))
    if not folder.is_dir():
        pytest.skip(f"{what} are not here: {folder} does not exist (set {variable} to their folder)")
    return folder


@pytest.fixture(scope="session")
def real_maps() -> Path:
    """Folder of real F1TENTH circuits (``PCS_RACING_MAPS``)."""
    return _folder("PCS_RACING_MAPS", REPOSITORY.parent / "shared" / "maps", "real circuits")


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of numbers computed by the established simulator (``PCS_RACING_REFERENCE``)."""
    return _folder("PCS_RACING_REFERENCE", REPOSITORY.parent / "shared" / "reference", "reference data")
