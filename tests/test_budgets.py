"""No room of the house is larger than its budget in the table of ``docs/design.md``."""

import ast
import re
from pathlib import Path
from typing import NamedTuple

import pytest
from repository import REPOSITORY, read_page


class Room(NamedTuple):
    """A row of the table."""

    places: tuple[str, ...]  # folders of Python, or patterns of pages
    counted: str  # statements or words
    goal: int
    limit: int


def rooms(page: str) -> list[Room]:
    """Return the rows of the table below the heading "Budgets"."""
    section = page.partition("\n## Budgets\n")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line[:3] == "| `"
    ]
    return [
        Room(
            tuple(re.findall(r"`([^`]+)`", places)),
            counted,
            *(int(number.replace(",", "")) for number in numbers),
        )
        for places, counted, *numbers in rows
    ]


def statements(file: Path) -> int:
    """Return the statements of a Python file. Expressions that are a text alone are docstrings, and
    not counted.
    """
    nodes = [
        node
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.stmt)
    ]
    values = [node.value for node in nodes if isinstance(node, ast.Expr)]
    return len(nodes) - sum(
        isinstance(value, ast.Constant) and isinstance(value.value, str) for value in values
    )


def size(room: Room, root: Path) -> int:
    """Return the statements of all Python files in a room, or the words of its pages."""
    if room.counted == "statements":
        return sum(
            statements(file) for place in room.places for file in (root / place).rglob("*.py")
        )
    pages = [page for place in room.places for page in root.glob(place)]
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


ROOMS = rooms(read_page("design.md"))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.places[0])
def test_no_room_is_larger_than_its_budget(room):
    taken = size(room, REPOSITORY)
    assert taken <= room.limit, (
        f"{taken - room.limit} {room.counted} too many: see One in, one out in CONTRIBUTING"
    )
    assert room.goal <= room.limit


def test_the_table_has_a_budget_for_every_folder_of_python():
    places = {place for room in ROOMS for place in room.places}
    assert {"pcs_racing", "pcs_racing_agents", "tests", "studies", "dev", "examples"} <= places
    assert {room.counted for room in ROOMS} == {"statements", "words"}


def test_what_is_counted(tmp_path):
    """Two rooms of two files each: six statements (a class and a loop are one each), and five
    words.
    """
    table = "# Design\n\n## Budgets\n\n| room | counted | goal | now at most |\n|---|---|---|---|\n"
    table += (
        "| `a`, `b` | statements | 2 | 3 |\n| `*.md` | words | 1,000 | 2,000 |\n\n## Next\n\n| `c`"
        " | words | 1 | 1 |\n"
    )
    python, pages = rooms(table)
    assert python == (("a", "b"), "statements", 2, 3)
    assert pages == (("*.md",), "words", 1000, 2000)
    source = '"""Text."""\n\nclass A:\n    """Text."""\n    x: int = 1; y = "text"\n'
    for name, text in {
        "a/x.py": source,
        "b/c/y.py": "for x in y: z(x)",
        "a/z.txt": "\n",
        "a/tests/x.py": "x = 1",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert size(python, tmp_path) == 6
    (tmp_path / "one.md").write_text("# One\n\nmore")
    (tmp_path / "two.md").write_text("two words")
    assert size(pages, tmp_path) == 5
