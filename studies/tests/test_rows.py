"""The table of a study as Markdown, from its CSV file."""

from refusal import refused

from pcs_racing_agents.base.tables import read_csv, write_csv
from studies.__main__ import main
from studies.rows import read_differences

HEAD = (
    *("kind", "track", "train", "opponent", "arm", "base", "difference", "low", "high"),
    *("score_base", "paper_difference"),
)
LINES = (
    ("difference", "Tarnfjord", 1, "never-switch", "ppo", "none", 0.1, 0.05, 0.15, 0.4, 0.054),
    ("adaptivity gain", "Tarnfjord", 1, "never-switch", "ppo", "fixed", 0.0, -0.1, 0.1, 0.5, 0.054),
    ("difference", "Monza", 0, "random-moves", "ppo", "none", -0.2, -0.3, -0.1, 0.6, ""),
    ("adaptivity gain", "Monza", 0, "random-moves", "ppo", "fixed", 0.0, -0.1, 0.1, 0.6, ""),
)


def test_a_line_has_the_paper_s_difference_and_ours(tmp_path):
    write_csv([HEAD, *LINES], tmp_path / "table.csv")
    assert main(["rows", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    written = read_csv(tmp_path / "out" / "rows.csv")
    assert written.columns == ("circuit", "opponent", "paper: GT", "none", "ppo", "ppo - fixed")
    first, second = (list(row.values()) for row in written.rows())
    assert first[:5] == [
        "Tarnfjord (training)",
        "never-switch",
        "+0.054",
        "0.400",
        "+0.100 [+0.050, +0.150]",
    ]
    assert second[:4] == ["Monza (test)", "random-moves", "", "0.600"]


def test_an_unfinished_study_is_refused(tmp_path):
    refused("there is no .*table.csv; give folders of", read_differences, tmp_path)
