"""Tables are laid out as plain text and Markdown, and read line by line; what is no table is
refused.
"""

import numpy as np
from refusal import refused

from pcs_racing_agents.base.style import Curve, curves_picture, picture_bytes
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


X = np.arange(5.0)
FALLING = Curve(X, np.exp(-X), "training", error=np.full(5, 0.01))
SPARSE = Curve(X, np.array([1.0, np.nan, 0.5, np.nan, 0.0]), "validation")


def heights(axes, line: int) -> list[float]:
    return list(axes.lines[line].get_ydata())


def test_panels_show_what_is_known():
    figure = curves_picture(
        {"loss": [FALLING, SPARSE], "share": [SPARSE]}, log=("loss",), mark=2.0, title="net"
    )
    loss, share = figure.axes
    assert (loss.get_yscale(), share.get_yscale()) == ("log", "linear")
    assert {0.2, 0.5} <= set(np.round(loss.yaxis.get_majorticklocs(), 6))
    assert loss.yaxis.get_major_formatter()(0.25, 0) == "0.25"
    assert heights(loss, 1) == [1.0, 0.5]  # NaN is left out, and 0 where the axis is logarithmic
    assert heights(share, 0) == [1.0, 0.5, 0.0]
    labels = [text.get_text() for text in loss.get_legend().get_texts()]
    assert labels == ["training", "validation"]
    assert list(loss.lines[-1].get_xdata()) == [2.0, 2.0]
    assert len(loss.collections) == 1  # the band of the standard error
    assert figure.get_suptitle() == "net"
    assert picture_bytes(figure, "png").startswith(b"\x89PNG")
