"""Rows are laid out as plain text and as Markdown."""

from pcs_racing_agents.results.text_table import aligned, markdown


def test_words_begin_and_numbers_end_below_each_other():
    rows = [("agent", "races", "note"), ("a", "5", "x|y"), ("bcd", "12", "")]
    assert aligned(rows) == ["agent  races  note", "a          5  x|y", "bcd       12"]
    assert aligned(rows, left=3)[1:] == ["a      5      x|y", "bcd    12"]
    assert markdown(rows) == ["| agent | races | note |", "| --- | --- | --- |", r"| a | 5 | x\|y |", "| bcd | 12 |  |"]
