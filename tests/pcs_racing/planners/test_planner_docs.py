"""docs/planners.md agrees with the code, and its code runs."""

import re

import pytest
from repository import REPOSITORY, python_blocks, run_python

from pcs_racing.planners import view
from pcs_racing.planners.registry import SHIPPED
from pcs_racing.planners.view import VIEW

PAGE = (REPOSITORY / "docs" / "planners.md").read_text(encoding="utf-8")


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


@pytest.mark.parametrize("code", python_blocks(PAGE))
def test_each_block_of_the_page_is_a_program(code, tmp_path):
    page = tmp_path / "page.py"
    page.write_text(code)
    printed = run_python(page)
    assert ("calls:" in code) == bool(re.search(r"calls: [1-9]\d", printed))


def test_the_example_runs():
    rows = run_python(
        "examples/custom_planner.py", "--races", "4", "--track", "Pipkin"
    ).splitlines()
    assert len([row for row in rows[:7] if row]) == 7
    # its drivers against agents of the zoo
    assert any(row.startswith("Pipkin, rules contest, seed 0: 60 races of 40 s, ") for row in rows)
    assert any(row.startswith("caution 0.3 ") for row in rows)
    assert rows[0].startswith("Pipkin, contest: 4 races")
