import pytest
from faces import MATCH

from pcs_racing.game.archive import PolicyArchive


@pytest.fixture(scope="package")
def archive() -> PolicyArchive:
    return MATCH["archive"]


@pytest.fixture
def short():
    """Arguments of matches whose races take no time."""
    return dict(MATCH)
