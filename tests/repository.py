"""Where this checkout lies, and the maintainers' tools in it."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

REPOSITORY = Path(__file__).resolve().parents[1]


def load_tool(name: str) -> ModuleType:
    """Return a module of ``tools/``, which is no part of the packages."""
    folder = str(REPOSITORY / "tools")
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(name)
