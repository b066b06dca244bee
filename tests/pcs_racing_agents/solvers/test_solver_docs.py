"""The code in docs/solvers.md runs, and so does the example that it names."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY

from pcs_racing_agents.solvers import VARIANTS

PAGE = (REPOSITORY / "docs" / "solvers.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"(<!-- needs OpenSpiel -->\n)?```python\n(.*?)```", PAGE, flags=re.DOTALL)


def run(folder: Path, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_page_s_code_runs(number, tmp_path):
    needs, code = BLOCKS[number]
    if needs:
        pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    (tmp_path / "block.py").write_text(code)
    assert run(tmp_path, "block.py")


def test_every_variant_is_in_the_table():
    assert all(f"| `{variant}` |" in PAGE for variant in VARIANTS)


def test_the_example_with_openspiel(tmp_path):
    pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    out = run(tmp_path, REPOSITORY / "examples" / "openspiel_tree.py", "--iterations", 50)
    cells = {line.split(",")[0]: float(line.split()[-1]) for line in out.splitlines() if line[:4] in ("Open", "pcs-")}
    assert list(cells) == ["OpenSpiel CFR+", "OpenSpiel MCCFR", "pcs-racing CFR+", "pcs-racing"]
    assert cells["pcs-racing CFR+"] == pytest.approx(cells["OpenSpiel CFR+"], rel=0.01)
    assert abs(cells["pcs-racing"]) < 1e-12
