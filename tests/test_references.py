"""Each reference of a docstring, a field comment or a page to a name of ours leads to it."""

import re
from importlib import import_module

import pytest
from repository import REPOSITORY

ROLE = re.compile(r":(?:class|func|mod|attr|data|meth|exc):`~?(pcs_racing[\w.]*)`")
FILES = [
    *(REPOSITORY / "pcs_racing").rglob("*.py"),
    *(REPOSITORY / "pcs_racing_agents").rglob("*.py"),
    *(REPOSITORY / "docs").glob("*.md"),
]


def leads_to_a_name(path: str) -> bool:
    """Return whether a dotted path is a module, or a chain of attributes or fields below one."""
    parts = path.split(".")
    for k in range(len(parts), 0, -1):
        try:
            place = import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for name in parts[k:]:
            fields = getattr(place, "__annotations__", {})
            if not hasattr(place, name) and name not in fields:
                return False
            place = getattr(place, name, None)
        return True
    return False


def test_every_reference_leads_to_a_name():
    found = {
        (path, file.relative_to(REPOSITORY).as_posix())
        for file in FILES
        for path in ROLE.findall(file.read_text(encoding="utf-8"))
    }
    assert len(found) > 100
    wrong = {one: file for one, file in found if not leads_to_a_name(one)}
    assert not wrong


@pytest.mark.parametrize(
    ("path", "right"),
    [
        ("pcs_racing.race", True),
        ("pcs_racing.race.races.RaceResult.lead", True),
        ("pcs_racing.envs.league.League", False),
        ("pcs_racing.race.races.RaceResult.leads", False),
    ],
)
def test_a_wrong_reference_is_found(path, right):
    assert leads_to_a_name(path) is right
