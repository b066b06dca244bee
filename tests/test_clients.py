"""Every client library of the recipes has one example, which names the versions that it was tried with."""

import sys

import pytest
from repository import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "tools"))
import try_clients

PAGE = (REPOSITORY / "docs" / "recipes.md").read_text(encoding="utf-8")
SCRIPTS = try_clients.scripts(None)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_the_page_names_the_file_and_the_versions_that_it_was_tried_with(script):
    (row,) = [line for line in PAGE.splitlines() if line.startswith("|") and f"`{script.stem}.py`" in line]
    for library in try_clients.dependencies(script):
        if "==" in library:
            name, version = library.partition("[")[0].partition("==")[0], library.partition("==")[2]
            assert f"{name} {version}" in row


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_it_is_a_program_that_only_runs_as_one(script):
    compile(script.read_text(encoding="utf-8"), script.name, "exec")
    assert script.read_text(encoding="utf-8").endswith('if __name__ == "__main__":\n    main()\n')


def test_a_script_without_metadata_is_refused(tmp_path):
    script = tmp_path / "plain.py"
    script.write_text("print(1)\n")
    with pytest.raises(ValueError, match=r"plain\.py"):
        try_clients.dependencies(script)


def test_an_unknown_client_is_refused():
    with pytest.raises(SystemExit, match="'nobody'"):
        try_clients.scripts(["nobody"])
