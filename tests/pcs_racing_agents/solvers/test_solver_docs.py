"""The code in docs/solvers.md runs, and so does the example that it names."""

import re

import pytest
from repository import REPOSITORY, read_page, run_python

from pcs_racing_agents.solvers import VARIANTS

PAGE = read_page("solvers.md")
BLOCKS = re.findall(r"(<!-- needs OpenSpiel -->\n)?```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_page_s_code_runs(number, tmp_path):
    needs, code = BLOCKS[number]
    if needs:
        pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    (tmp_path / "block.py").write_text(code)
    assert run_python("block.py", folder=tmp_path)


def test_every_variant_is_named():
    assert all(f"`{variant}`" in PAGE for variant in VARIANTS)


def test_the_example_with_openspiel(tmp_path):
    pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    out = run_python(REPOSITORY / "examples" / "clients" / "openspiel_tree.py", "--iterations", 50, folder=tmp_path)
    cells = {line.split(",")[0]: float(line.split()[-1]) for line in out.splitlines() if line[:4] in ("Open", "pcs-")}
    assert list(cells) == ["OpenSpiel CFR+", "OpenSpiel MCCFR", "pcs-racing CFR+", "pcs-racing"]
    assert cells["pcs-racing CFR+"] == pytest.approx(cells["OpenSpiel CFR+"], rel=0.01)
    assert abs(cells["pcs-racing"]) < 1e-12
