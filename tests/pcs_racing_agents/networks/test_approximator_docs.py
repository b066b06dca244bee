"""docs/approximator.md agrees with the code."""

import re

from repository import read_page

from pcs_racing_agents.networks import TARGETS


def test_the_page_has_the_table_of_targets():
    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+?) \|$", read_page("approximator.md"), re.MULTILINE)
    assert dict(rows) == {name: target.meaning for name, target in TARGETS.items()}
