"""Where this checkout lies: the pages of its documentation and their code, and the maintainers'
tools.
"""

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

from warm_start import call_python

REPOSITORY = Path(__file__).resolve().parents[1]


def load_tool(name: str, place: str = "dev/tools") -> ModuleType:
    """Return a module of ``dev/tools/`` or of another folder, which is no part of the packages."""
    folder = str(REPOSITORY / place)
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(name)


def read_page(name: str) -> str:
    """Return the text of a page of the documentation."""
    return (REPOSITORY / "docs" / name).read_text(encoding="utf-8")


def python_blocks(text: str) -> list[str]:
    """Return the Python code of a page, block by block."""
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


def run_block(code: str) -> None:
    """Run code of a page as a program of its own."""
    exec(compile(code, "page", "exec"), {"__name__": "snippet"})


def run_python(*arguments: object, folder: Path = REPOSITORY) -> str:
    """Run Python in another process, which must end well, and return what it printed."""
    done = call_python(*arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout
