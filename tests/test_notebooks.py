"""The notebooks of the documentation run, cell by cell, as the site's build runs them (there with larger budgets)."""

import re
import sys
import types

import pytest
from repository import REPOSITORY

NOTEBOOKS = sorted((REPOSITORY / "docs" / "notebooks").glob("*.md"))
SHORTER = {".learn(8_192)": ".learn(1)", "races_per_pair=40": "races_per_pair=2", "[fast] * 100": "[fast] * 10"}


def cells(text: str) -> list[str]:
    """Return the code of a notebook, cell by cell."""
    return re.findall(r"^```\{code-cell\}\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


@pytest.fixture
def display(monkeypatch):
    """Stand for IPython, which only the site's build needs, and keep what a notebook shows."""
    shown = []
    module = types.ModuleType("IPython.display")
    module.Image = lambda *args, **options: shown.append((args, options))
    package = types.ModuleType("IPython")
    package.version_info, package.get_ipython = (9, 0), lambda: None  # matplotlib asks for both
    monkeypatch.setitem(sys.modules, "IPython", package)
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    return shown


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_cell_runs(notebook, display, monkeypatch, tmp_path, capsys):
    text = notebook.read_text(encoding="utf-8")
    if "stable_baselines3" in text:
        pytest.importorskip("stable_baselines3")
    if "matplotlib" in text or "picture" in text:
        pytest.importorskip("matplotlib")
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "notebook"}
    for number, code in enumerate(cells(text)):
        exec(compile(code, f"{notebook.name}, cell {number}", "exec"), space)
    assert capsys.readouterr().out
    assert display or notebook.stem == "train_ppo"


def test_there_are_notebooks_without_outputs():
    """Outputs are made when the site is built: git keeps text only."""
    assert [path.stem for path in NOTEBOOKS] == ["first_race", "space_and_game", "train_ppo"]
    for path in NOTEBOOKS:
        assert len(cells(path.read_text(encoding="utf-8"))) >= 4
        assert path.stat().st_size < 10_000
    assert [file.name for file in (REPOSITORY / "docs").rglob("*.ipynb")] == []
