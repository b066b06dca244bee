"""Fixtures that every test may use: tracks of the project's own, and real maps and reference data
where they are.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, missing
from hypothesis import HealthCheck, settings
from repository import REPOSITORY

# The first example of a compiled function includes its compilation: timing examples would test the
# machine. The same examples are drawn everywhere, and none are kept in a folder that may be
# read-only. The profile "long" draws new ones, a hundred times as many.
for name, examples in (("everywhere", 100), ("long", 10_000)):
    settings.register_profile(
        name,
        deadline=None,
        derandomize=name == "everywhere",
        max_examples=examples,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "everywhere"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that open a page: `make test` leaves them out where no page has changed."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")


def _folder(variable: str, default: Path, what: str) -> Path:
    folder = Path(os.environ.get(variable, default))
    if not folder.is_dir():
        pytest.skip(
            f"{what} are not here: {folder} does not exist (set {variable} to their folder)"
        )
    return folder


@pytest.fixture(scope="session")
def real_maps() -> Path:
    """Folder of real F1TENTH circuits (``PCS_RACING_MAPS``)."""
    return _folder("PCS_RACING_MAPS", REPOSITORY.parent / "shared" / "maps", "real circuits")


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of numbers computed by the established simulator (``PCS_RACING_REFERENCE``)."""
    return _folder(
        "PCS_RACING_REFERENCE", REPOSITORY.parent / "shared" / "reference", "reference data"
    )


@pytest.fixture(scope="module")
def browser():
    """A page in Chromium; its tests are skipped where there is none, unless ``PCS_RACING_BROWSER``
    says "needed".
    """
    if reason := missing():
        assert os.environ.get("PCS_RACING_BROWSER") != "needed", reason
        pytest.skip(reason)
    opened = Browser()
    yield opened
    opened.close()


@pytest.fixture
def own_registry(monkeypatch):
    """The characteristics that a test registers are forgotten after it."""
    from pcs_racing.game import characteristics

    monkeypatch.setattr(characteristics, "_registered", dict(characteristics._registered))


@pytest.fixture(scope="session")
def oval():
    """A stadium: two straights of 12 m, two half circles of 4 m radius, 2.2 m wide, driven
    counterclockwise.
    """
    return _stadium(resolution=0.05)


@pytest.fixture(scope="session")
def coarse_oval():
    """The same in cells of 0.2 m, for tests that also run as plain Python."""
    return _stadium(resolution=0.2)


def _stadium(resolution: float):
    from pcs_racing.track.building.tracks import build_track
    from pcs_racing.track.track import Calibration

    straight, radius, half_width = 12.0, 4.0, 1.1
    quarter = np.linspace(0.0, np.pi, 40, endpoint=False)
    along = np.linspace(-straight / 2, straight / 2, 40, endpoint=False)
    right = np.column_stack([straight / 2 + radius * np.sin(quarter), -radius * np.cos(quarter)])
    bottom = np.column_stack([along, np.full_like(along, -radius)])
    xy = np.concatenate([bottom, right, -bottom, -right])
    origin = (-straight / 2 - radius - 2.0, -radius - 2.0)
    shape = (
        round(2 * (radius + 2.0) / resolution),
        round((straight + 2 * radius + 4.0) / resolution),
    )
    y, x = np.meshgrid(*((np.arange(n) + 0.5) * resolution for n in shape), indexing="ij")
    # The centre line is where the distance to the segment between the two half circles' centres is
    # the radius.
    away = np.hypot(np.maximum(np.abs(x + origin[0]) - straight / 2, 0.0), y + origin[1])
    occupied = np.abs(away - radius) > half_width
    occupied &= np.abs(away - radius) < half_width + 0.3
    centerline = np.column_stack([xy, np.full((len(xy), 2), half_width)])
    # Known beforehand, or it would be found by driving: pace 1 is about as fast as the bends allow.
    lower, upper = ((2.0, 9.5),), ((26.5, 34.0),)
    calibration = {
        "paper": Calibration((0.8, 1.0), 0.9, {"left": lower, "right": upper}),
        "contest": Calibration((0.9, 1.14), 0.45, {"front": lower + upper}),
    }
    return build_track(
        "oval", occupied, resolution, origin, centerline, xy, calibration=calibration
    )
