"""Tables are laid out as plain text and Markdown, and read line by line; what is no table is
refused.
"""

from refusal import refused

from pcs_racing_agents.base.tables import aligned, markdown, read_csv, write_csv


def written(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    return path


def test_lines_are_numbered_as_an_editor_does_and_what_is_no_text_is_refused(tmp_path):
    table = read_csv(written(tmp_path, '\ufeffego,lead\r\na,1.5\r\n\r\n"b, c",2\r\n'))
    assert table.columns == ("ego", "lead")
    assert list(table.values()) == [(2, ["a", "1.5"]), (4, ["b, c", "2"])]
    assert table.rows() == [{"ego": "a", "lead": "1.5"}, {"ego": "b, c", "lead": "2"}]
    table = read_csv(written(tmp_path, ""))
    assert (table.columns, table.rows()) == ((), [])
    path = write_csv([("ego", "lead"), ("b, c", 2), ("", 1.5)], tmp_path / "table.csv")
    assert path.read_bytes() == b'ego,lead\n"b, c",2\n,1.5\n'
    assert read_csv(path).rows() == [{"ego": "b, c", "lead": "2"}, {"ego": "", "lead": "1.5"}]
    refused("missing", write_csv, [("ego",)], tmp_path / "missing" / "table.csv")
    refused(r"can't read .*: No such file", read_csv, tmp_path / "none.csv")
    (tmp_path / "latin.csv").write_bytes(b"\xff\xfe")
    refused(r"is damaged: .*utf-8", read_csv, tmp_path / "latin.csv")


def test_damaged_tables_are_named(tmp_path):
    for text, message in [
        ("ego,lead\na,1\nb\n", r"line 3 .* 1 values"),
        ("ego,lead\na,1,2\n", r"line 2 .* 3 values"),
        ('ego,lead\na,"1\n', "line 2 is damaged"),
        ("x" * 200_000, "is damaged"),
        ("a," * 2000, "has 2001 columns"),
    ]:
        table = written(tmp_path, text)
        refused(message, lambda table=table: read_csv(table).rows())


def test_words_begin_and_numbers_end_below_each_other():
    rows = [("agent", "races", "note"), ("a", "5", "x|y"), ("bcd", "12", "")]
    assert aligned(rows) == ["agent  races  note", "a          5  x|y", "bcd       12"]
    assert aligned(rows, left=3)[1:] == ["a      5      x|y", "bcd    12"]
    assert markdown(rows) == [
        "| agent | races | note |",
        "| --- | --- | --- |",
        r"| a | 5 | x\|y |",
        "| bcd | 12 |  |",
    ]


def test_markdown_shows_tags_as_text():
    """Names come from files of strangers; numbers such as "< 0.001" stay as they are."""
    assert markdown([("agent",), ("<img src=x> | b",), ("< 0.001",)])[2:] == [
        "| &lt;img src=x> \\| b |",
        "| < 0.001 |",
    ]
