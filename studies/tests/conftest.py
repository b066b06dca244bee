"""The fixtures of the packages' tests, for these tests too."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "pcs_racing_agents")]


def _fixtures(file: Path) -> dict[str, object]:
    spec = spec_from_file_location("_".join(file.relative_to(TESTS).with_suffix("").parts), file)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name: thing for name, thing in vars(module).items() if not name.startswith("__")}


globals().update(
    _fixtures(TESTS / "conftest.py") | _fixtures(TESTS / "pcs_racing_agents" / "conftest.py")
)
