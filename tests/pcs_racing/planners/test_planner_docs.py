"""docs/planners.md agrees with the code."""

import re

from repository import read_page

from pcs_racing.planners import view
from pcs_racing.planners.registry import SHIPPED
from pcs_racing.planners.view import VIEW

PAGE = read_page("planners.md")


def test_the_page_names_elements_of_the_view_and_every_shipped_planner():
    section = PAGE.split("\n### The view\n")[1].split("\n#")[0]
    rows = re.findall(r"^\|.*", section, flags=re.M)
    for name in re.findall(r"`(\w+?)(?:\.\.\.)?`", "".join(rows)):
        assert any(element.startswith(name) for element in VIEW), name
    for name in SHIPPED:
        assert f"| `{name}` |" in PAGE


def test_the_constants_are_the_indices_of_the_view():
    constants = [name if hasattr(view, name) else f"OWN_{name}" for name in VIEW]
    assert [getattr(view, constant) for constant in constants] == list(range(len(VIEW)))
