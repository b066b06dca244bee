"""Every client library has one example, and the page names the versions that it was tried with."""

import re

import pytest
from repository import REPOSITORY, read_page

PAGE = " ".join(read_page("reports/clients.md").split())
SCRIPTS = sorted((REPOSITORY / "examples" / "clients").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_the_page_says_what_it_does_and_the_versions_of_the_libraries_that_it_lists(script):
    assert f"| `{script.name}` |" in PAGE
    (needed,) = re.findall(r"^# dependencies = (.*)$", script.read_text("utf-8"), re.MULTILINE)
    libraries = re.findall(r'"([\w-]+)(?:\[\w+\])?(?:==([\w.]+))?"', needed)
    for name, version in libraries:
        assert not re.search(rf"\b{name} \d+\.\d+\.\d", PAGE) or version in PAGE, name
