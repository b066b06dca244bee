"""Every block of docs/recipes.md runs, and so do the examples that it names."""

import ast
import importlib.util
import re

import pytest
from repository import REPOSITORY, python_blocks, read_page, run_block

PAGE = read_page("recipes.md")


def blocks():
    """Heading and code of every Python block."""
    for section in PAGE.split("\n## ")[1:]:
        heading = section.partition("\n")[0]
        for number, code in enumerate(python_blocks(section)):
            marks = [pytest.mark.compare] * ("sb3_contrib" in code)
            yield pytest.param(code, id=f"{heading} {number}", marks=marks)


def need_imports(code):
    """Skip if a library that the code imports is not installed."""
    for node in ast.walk(ast.parse(code)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module]
        for name in (name.partition(".")[0] for name in names):
            if importlib.util.find_spec(name) is None:
                pytest.skip(f"{name} is not installed")


@pytest.mark.parametrize("code", list(blocks()))
def test_blocks_run_as_they_stand(code, tmp_path, monkeypatch):
    need_imports(code)
    monkeypatch.chdir(tmp_path)  # where some write to
    run_block(code)


def test_named_scripts_exist():
    scripts = set(re.findall(r"(?:examples|dev/benchmarks)/\w+\.py", PAGE))
    assert "examples/cleanrl_loop.py" in scripts
    assert all((REPOSITORY / script).is_file() for script in scripts)
