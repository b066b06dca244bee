"""A newcomer meets few names: 27 in the two packages, and eight places to import from."""

import ast
import importlib
import re

import pytest
from repository import REPOSITORY

import pcs_racing
import pcs_racing_agents

PLACES = {
    "pcs_racing",
    "pcs_racing.envs",
    "pcs_racing.game",
    "pcs_racing.planners",
    "pcs_racing.testing",
    "pcs_racing_agents",
    "pcs_racing_agents.agents",
    "pcs_racing_agents.tournament",
}
MAX_NAMES = 27
PAGES = [
    *[REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md"],
    *(REPOSITORY / "docs").glob("*.md"),
    *(REPOSITORY / "docs" / "notebooks").glob("*.md"),
    *(REPOSITORY / "examples").rglob("*.py"),
]


def imports(text: str) -> list[tuple[str, str]]:
    """Return places and names of all imports of our packages in a page or a file."""
    pattern = r"^[ >]*from (pcs_racing[\w.]*) import (\([^)]*\)|.*)$"
    found = [
        (place, name)
        for place, names in re.findall(pattern, text, re.MULTILINE)
        for name in re.findall(r"\w+(?: as \w+)?", re.sub(r"#.*", "", names))
    ]
    return [(place, name.split()[0]) for place, name in found] + [
        (place, "") for place in re.findall(r"^ *import (pcs_racing[\w.]*)", text, re.MULTILINE)
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(REPOSITORY).as_posix())
def test_pages_and_examples_import_public_names_from_eight_places(page):
    for place, name in imports(page.read_text(encoding="utf-8")):
        assert place in PLACES, f"{page.name} imports from {place}; offer the name in {PLACES}"
        module = importlib.import_module(place)
        assert not name or name in module.__all__, f"{place} does not offer {name}"


@pytest.mark.parametrize(
    "example", sorted((REPOSITORY / "examples").rglob("*.py")), ids=lambda file: file.stem
)
def test_examples_register_the_environments_that_they_make(example):
    text = example.read_text(encoding="utf-8")
    makes = re.search(r"""\b(gym|gymnasium)\.make(_vec)?\(\s*(?!\s|["']pcs_racing:)""", text)
    assert not makes or "register_envs(pcs_racing)" in text


def test_the_two_packages_offer_few_names_and_their_folders():
    names = {
        f"{package.__name__}.{name}"
        for package in (pcs_racing, pcs_racing_agents)
        for name in package.__all__
    }
    folders = {name for name in names if (REPOSITORY / name.replace(".", "/")).is_dir()}
    assert len(names - folders) <= MAX_NAMES


@pytest.mark.parametrize("place", sorted(PLACES))
def test_every_public_name_is_there_and_editors_know_it(place):
    module = importlib.import_module(place)
    for name in module.__all__:
        assert getattr(module, name) is not None
    stub = REPOSITORY / place.replace(".", "/") / "__init__.pyi"
    if stub.is_file():  # ``import lazy_loader`` reads the same list
        nodes = ast.parse(stub.read_text(encoding="utf-8")).body
        listed = [
            alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names
        ]
        assert sorted(listed) == sorted(module.__all__)
