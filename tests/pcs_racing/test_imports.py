import ast
import subprocess
import sys

import pytest
from repository import REPOSITORY

from pcs_racing import load_track

# Imports inside functions: optional libraries, and scipy, which takes a second.
LATE = ("torch", "scipy", "matplotlib", "pygame", "stable_baselines3", "skimage", "clarabel", "cma")

MAX_MODULES = 60
"""Max modules of ``pcs_racing`` for one car alone on a known track."""


@pytest.mark.parametrize(
    "package", ["pcs_racing", "pcs_racing_agents", "pcs_racing_agents.cli.main"]
)
def test_importing_is_light(package):
    """Numba itself looks at scipy's version, so its own imports do not count."""
    code = f"""
import sys
import numba
before = set(sys.modules)
import {package}
print(*sorted({{name.split(".")[0] for name in set(sys.modules) - before}}))
print("of envs:", *(name for name in sys.modules if name.startswith("pcs_racing.envs.")))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    assert package.split(".")[0] in done.stdout.split()
    assert not set(LATE) & set(done.stdout.split())
    if package == "pcs_racing":  # environments are imported when they are made
        assert done.stdout.endswith("of envs: pcs_racing.envs.registration\n")


def test_one_car_alone_loads_what_it_drives():
    """A track of the cache is not built; nothing else drives; no other file changes imports."""
    load_track("Tarnfjord")  # into the cache
    code = """
import sys
import gymnasium
hooks = list(sys.meta_path)
import pcs_racing
gymnasium.make("pcs_racing/Drive-v1", opponent=None)
assert sys.meta_path == hooks
print(*(name for name in sys.modules if name.partition(".")[0] == "pcs_racing"))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    loaded = done.stdout.split()
    assert "pcs_racing.envs.drive" in loaded
    assert len(loaded) <= MAX_MODULES, sorted(loaded)


def test_imports_of_optional_libraries_are_late_and_every_public_name_is_there():
    for package in ("pcs_racing", "pcs_racing_agents"):
        for file in sorted((REPOSITORY / package).rglob("*.py")):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                assert not {name.split(".")[0] for name in names} & set(LATE), (
                    f"{file}: line {node.lineno}"
                )
    import pcs_racing

    for name in pcs_racing.__all__:
        assert getattr(pcs_racing, name) is not None
