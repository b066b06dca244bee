"""No room of the house is larger than its budget, which stands in a table of ``docs/design.md``."""

import re
from pathlib import Path
from typing import NamedTuple

import pytest
from repository import REPOSITORY, read_page


class Room(NamedTuple):
    """A row of the table."""

    places: tuple[str, ...]  # folders of Python, or patterns of pages
    counted: str  # lines or words
    goal: int
    limit: int


def rooms(page: str) -> list[Room]:
    """Return the rows of the table below the heading "Budgets"."""
    section = page.partition("\n## Budgets\n")[2].partition("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:3] == "| `"]
    return [
        Room(tuple(re.findall(r"`([^`]+)`", places)), counted, *(int(number.replace(",", "")) for number in numbers))
        for places, counted, *numbers in rows
    ]


def size(room: Room, root: Path) -> int:
    """Return the lines of all Python files in a room, without tests of its own, or the words of its pages."""
    if room.counted == "lines":
        found = [(root / place, file) for place in room.places for file in (root / place).rglob("*.py")]
        files = [file for folder, file in found if "tests" not in file.relative_to(folder).parts]
        return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
    pages = [page for place in room.places for page in root.glob(place)]
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


ROOMS = rooms(read_page("design.md"))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.places[0])
def test_no_room_is_larger_than_its_budget(room):
    taken = size(room, REPOSITORY)
    assert taken <= room.limit, f"{taken - room.limit} {room.counted} too many: see One in, one out in CONTRIBUTING"
    assert room.goal <= room.limit


def test_the_table_has_a_budget_for_every_folder_of_python():
    places = {place for room in ROOMS for place in room.places}
    assert {"pcs_racing", "pcs_racing_agents", "tests", "tools", "benchmarks", "docs/*.md"} <= places
    assert {room.counted for room in ROOMS} == {"lines", "words"}


def test_what_is_counted(tmp_path):
    """Two rooms of two files each: three lines of Python, and five words."""
    table = "# Design\n\n## Budgets\n\n| room | counted | goal | now at most |\n|---|---|---|---|\n"
    table += "| `a`, `b` | lines | 2 | 3 |\n| `*.md` | words | 1,000 | 2,000 |\n\n## Next\n\n| `c` | lines | 1 | 1 |\n"
    python, pages = rooms(table)
    assert python == (("a", "b"), "lines", 2, 3)
    assert pages == (("*.md",), "words", 1000, 2000)
    for name, text in {"a/x.py": "x = 1\n\n", "b/c/y.py": "y = 2", "a/z.txt": "\n\n", "a/tests/x.py": "\n"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert size(python, tmp_path) == 3
    (tmp_path / "one.md").write_text("# One\n\nmore")
    (tmp_path / "two.md").write_text("two words")
    assert size(pages, tmp_path) == 5
