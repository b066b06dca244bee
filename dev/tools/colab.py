"""Write the notebooks of docs/notebooks as Jupyter files for Colab, without outputs.

    python dev/tools/colab.py

A notebook begins with its badge and a cell that installs the package. A test compares the files
with the pages, whose cells the site's build runs.
"""

import json
import posixpath
import re
import tomllib
from pathlib import Path
from typing import Any

from pcs_racing.base.files import write_atomically

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = sorted((REPOSITORY / "docs" / "notebooks").glob("*.md"))
SOURCE = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "urls"
]["Source"]
PLACE = "docs/colab"
BADGE = "https://colab.research.google.com/assets/colab-badge.svg"
INSTALL = f'%pip install --quiet "pcs-racing[plots,learning] @ git+{SOURCE}"'


def address(name: str) -> str:
    """Return the address that opens a notebook in Colab."""
    path = SOURCE.removeprefix("https://github.com/")
    return f"https://colab.research.google.com/github/{path}/blob/main/{PLACE}/{name}.ipynb"


def cells(text: str) -> list[tuple[str, str]]:
    """Return the cells of a page: kind and text."""
    body = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    parts = re.split(r"```\{code-cell\}\n(.*?)\n```", body, flags=re.DOTALL)
    found = [
        ("code", part) if k % 2 else ("markdown", _linked(part)) for k, part in enumerate(parts)
    ]
    return [(kind, part.strip()) for kind, part in found if part.strip()]


def _linked(text: str) -> str:
    """Return the text of a page with whole addresses, without its link to Colab."""
    text = re.sub(r"\[Open in Colab\]\([^)]*\)\n*", "", text)

    def whole(link: re.Match[str]) -> str:
        path = posixpath.normpath(f"docs/notebooks/{link[1]}")
        return link[0] if "://" in link[1] else f"]({SOURCE}/blob/main/{path})"

    return re.sub(r"\]\(([^)\s]+)\)", whole, text)


def notebook(page: Path) -> str:
    """Return a page as a Jupyter notebook."""
    head = [
        ("markdown", f"[![Open in Colab]({BADGE})]({address(page.stem)})"),
        ("code", INSTALL),
    ]
    made: list[dict[str, Any]] = []
    for kind, text in [*head, *cells(page.read_text(encoding="utf-8"))]:
        cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{len(made)}", "metadata": {}}
        cell["source"] = text.splitlines(keepends=True)
        outputs = {"execution_count": None, "outputs": []} if kind == "code" else {}
        made.append(cell | outputs)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {
        "cells": made,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write all notebooks."""
    for page in PAGES:
        write_atomically(REPOSITORY / PLACE / f"{page.stem}.ipynb", notebook(page))


if __name__ == "__main__":
    main()
