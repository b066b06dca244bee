import pytest
from faces import six_policies

from pcs_racing.game.archive import PolicyArchive


@pytest.fixture(scope="package")
def archive() -> PolicyArchive:
    return six_policies()
