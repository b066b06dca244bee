"""Every block of docs/recipes.md that is not marked "not run" runs, and so do the examples that it names."""

import ast
import importlib.util
import re

import pytest
from repository import REPOSITORY

PAGE = (REPOSITORY / "docs" / "recipes.md").read_text(encoding="utf-8")
NOT_RUN = "<!-- not run -->\n"


def blocks():
    """Heading, code and whether it can run here, of every Python block."""
    for section in PAGE.split("\n## ")[1:]:
        heading = section.partition("\n")[0]
        found = re.finditer(rf"({NOT_RUN})?```python\n(.*?)```", section, re.DOTALL)
        for number, match in enumerate(found):
            marks = [pytest.mark.compare] * ("sb3_contrib" in match[2])
            yield pytest.param(match[2], match[1] is None, section, id=f"{heading} {number}", marks=marks)


def need_imports(code):
    """Skip if a library that the code imports is not installed."""
    for node in ast.walk(ast.parse(code)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module]
        for name in (name.partition(".")[0] for name in names):
            if importlib.util.find_spec(name) is None:
                pytest.skip(f"{name} is not installed")


@pytest.mark.parametrize(("code", "runs", "section"), list(blocks()))
def test_blocks_run_as_they_stand(code, runs, section):
    tree = compile(code, "docs/recipes.md", "exec")
    if not runs:
        assert "examples/clients/rllib_ppo.py" in section  # tools/try_clients.py runs the same code
        return
    need_imports(code)
    exec(tree, {"__name__": "recipe"})


def test_named_scripts_exist():
    scripts = set(re.findall(r"(?:examples|benchmarks)/\w+\.py", PAGE))
    assert "examples/cleanrl_loop.py" in scripts
    assert all((REPOSITORY / script).is_file() for script in scripts)
