"""Maintainers' tools: which tests a change needs, and which faults no test noticed."""

import ast
import csv
import json

import pytest
from repository import REPOSITORY, load_tool

colab, quick, survivors = load_tool("colab"), load_tool("quick"), load_tool("survivors")


def test_a_change_is_tested_in_its_rooms_and_by_the_pages_that_name_it():
    changed = [
        "pcs_racing/car/lidar.py",
        "pcs_racing_agents/learning/ppo.py",
        "docs/view.md",
        "dev/tools/quick.py",
    ]
    rooms = ["tests/pcs_racing/car", "tests/pcs_racing_agents/learning", "tests/test_docs.py"]
    assert quick.select(changed) == [*quick.ALWAYS, *rooms]
    assert quick.select(
        ["tests/test_floors.py", "tests/browser.py", "pcs_racing/__init__.py"]
    ) == list(quick.ALWAYS)
    assert quick.select(["pcs_racing/race/replay.html"])[-1] == "tests/pcs_racing/race"


def test_tests_that_start_many_programs_run_where_their_rooms_changed():
    assert quick.left_out([]) == ("not benchmarks and not browser and not cluster and not training")
    found = quick.left_out(["pcs_racing/race/replay.html", "dev/benchmarks/bits.py"])
    assert found == "not cluster and not training"
    found = quick.left_out(["tests/pcs_racing_agents/base/test_cluster.py"])
    assert found == "not benchmarks and not browser and not training"


def test_a_fault_that_no_test_noticed_is_found_and_compared_without_brackets():
    fault = {"mutations": [{"module_path": "a.py"}]}
    diff = "--- a/a.py\n+++ b/a.py\n@@ -1 +1 @@\n-  return one\n+  return 1 + one\n  rest"
    results = [None, *({"test_outcome": end, "diff": diff} for end in ("killed", "survived"))]
    record = "\n".join(json.dumps([fault, result]) for result in results)
    (found,) = survivors.survivors(record)
    assert found == ("a.py", "  return one", "  return 1 + one")
    assert survivors.plain(*found) == survivors.plain("a.py", "return one", "return (1 + one)")


def test_every_accepted_fault_has_a_reason():
    with open(survivors.ACCEPTED, newline="", encoding="utf-8") as file:
        assert all(len(row["reason"]) > 10 for row in csv.DictReader(file))


@pytest.mark.parametrize("page", colab.PAGES, ids=lambda page: page.stem)
def test_a_notebook_of_colab_has_the_cells_of_its_page(page):
    file = REPOSITORY / colab.PLACE / f"{page.stem}.ipynb"
    text = file.read_text(encoding="utf-8")
    assert text == colab.notebook(page), "run: python dev/tools/colab.py"
    badge, install, *cells = json.loads(text)["cells"]
    address = colab.address(page.stem)
    assert badge["source"] == [f"[![Open in Colab]({colab.BADGE})]({address})"]
    assert install["source"] == [colab.INSTALL]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    page_text = page.read_text(encoding="utf-8")
    assert page_text.count("```{code-cell}") == len(code) > 2
    assert all(ast.parse(cell) and cell in page_text for cell in code)
    assert f"[Open in Colab]({address})" in page_text
    assert "](../" not in "".join(line for cell in cells for line in cell["source"])
