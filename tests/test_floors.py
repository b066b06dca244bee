"""The house has floors: no file imports from a higher one, and no files import each other in a
circle.
"""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from repository import REPOSITORY, load_tool

from pcs_racing.base.code_cache import SIMULATOR


def drawn_floors() -> list[tuple[str, str]]:
    """Package and folders of every floor in the picture of the house, the lowest floor first."""
    house = load_tool("house", "docs")
    return [(house.NAME[package], folders) for package, folders, _ in reversed(house.FLOORS)]


FLOOR_OF = {
    f"{package}.{folder.strip('/')}": floor
    for floor, (package, folders) in enumerate(drawn_floors())
    for folder in folders.split()
}


def modules() -> dict[str, Path]:
    """Files of both packages by the name under which they are imported."""
    return {
        ".".join(file.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): file
        for package in ("pcs_racing", "pcs_racing_agents")
        for file in (REPOSITORY / package).rglob("*.py")
    }


def imports(file: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the two packages that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {member if member in known else node.module or "" for member in members}
    return names & known.keys()


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    known = modules()
    return {name: imports(file, known) - {name} for name, file in known.items()}


def test_neither_package_nor_their_tests_import_the_experiments():
    folders = ("pcs_racing", "pcs_racing_agents", "tests")
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*.py")]
    assert len(files) > 300
    imported = re.compile(r"^\s*(from|import) (studies|dev)\b", re.MULTILINE)
    found = [file for file in files if imported.search(file.read_text("utf-8"))]
    assert not found


def floor_of(module: str) -> int | None:
    """None for the doors of a package: ``__init__`` and ``__main__``."""
    return FLOOR_OF.get(".".join(module.split(".")[:2]))


def test_every_file_stands_on_a_floor_and_imports_none_from_a_higher_one(graph):
    loose = {name for name in graph if floor_of(name) is None}
    assert loose == {"pcs_racing", "pcs_racing_agents", "pcs_racing_agents.__main__"}
    upward = [
        (name, other)
        for name, others in graph.items()
        for other in others
        if floor_of(name) is not None
        and floor_of(other) is not None
        and floor_of(other) > floor_of(name)
    ]
    assert not upward


def test_no_floor_imports_its_packages_front_door_and_the_simulator_is_the_lowest(graph):
    """``import pcs_racing`` offers names of the floors; a floor that imports it closes a circle."""
    assert not [
        (name, other)
        for name, others in graph.items()
        for other in others & {"pcs_racing", "pcs_racing_agents"}
        if floor_of(name) is not None
    ]
    # Its compiled code has a digest of its own, which is enough because it imports nothing from
    # above.
    assert [FLOOR_OF[f"pcs_racing.{floor}"] for floor in SIMULATOR] == list(range(len(SIMULATOR)))


def test_no_files_import_each_other_in_a_circle(graph):
    TopologicalSorter(graph).prepare()  # refuses a circle, and names its files


def test_dataclasses_are_frozen_but_for_two():
    """Immutable values may be shared, kept and hashed."""
    changing = set()
    for file in modules().values():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                options = " ".join(map(ast.unparse, node.decorator_list))
                if "dataclass" in options and "frozen=True" not in options:
                    changing.add(node.name)
    assert changing == {"ArchiveRun"}
