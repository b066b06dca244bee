"""The code of docs/reports.md runs, beside the results of a study."""

import pytest
from repository import python_blocks, read_page, run_block
from toy_races import toy_races

from pcs_racing_agents.results.race_files import write_results

BLOCKS = python_blocks(read_page("reports.md"))


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_code_runs(number, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "out" / "my-study" / "results.csv"
    results.parent.mkdir(parents=True)
    write_results(toy_races(tracks=("Tarnfjord",), egos=3, variants=3), results)
    run_block(BLOCKS[number])
    assert capsys.readouterr().out.strip() not in ("", "False")
    if "write_table" in BLOCKS[number]:
        assert (results.parent / "table-again.csv").is_file()
