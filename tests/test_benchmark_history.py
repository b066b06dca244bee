import pytest
from repository import load_tool


@pytest.fixture(scope="module")
def record():
    return load_tool("record", "benchmarks")


def lines(*values: float, processor: str = "here") -> list[dict[str, str]]:
    return [{"processor": processor, "race": str(value)} for value in values]


def test_what_is_slower_than_it_was_on_this_machine_is_named(record):
    (line,) = record.slower({"race": 14.0}, lines(10.0, 10.2, 9.8), "here")
    assert line.startswith("race takes 14 times the reference; it was 10 (+40 %)")
    assert record.slower({"race": 12.5}, lines(10.0, 10.2, 9.8), "here") == []
    assert record.slower({"race": 2.0}, lines(10.0), "here") == []
    history = lines(*[1.0] * 20, 10.0, 10.0, 10.0, 100.0, 10.0)
    assert record.slower({"race": 11.0}, history, "here") == []
    assert record.slower({"race": 14.0}, history, "here") != []
    history = lines(5.0, processor="there") + lines(10.0)
    assert record.slower({"race": 11.0}, history, "here") == []
    assert record.slower({"race": 11.0}, history, "elsewhere") != []
    assert record.slower({"scan": 3.0}, lines(1.0), "here") == []
    assert record.slower({"race": 3.0}, [], "here") == []


def test_lines_are_added_and_the_kept_history_has_every_ratio(record, tmp_path):
    file = tmp_path / "history.csv"
    record.add_line({"race": 10.0}, 5.0, file)
    record.add_line({"race": 20.0, "scan": 1.0}, 5.0, file)
    first, second = record.read_history(file)
    assert (first["race"], first["scan"], second["scan"]) == ("10", "", "1")
    assert record.slower({"race": 30.0}, [first, second], second["processor"]) != []
    history = record.read_history()
    assert history
    assert all(float(history[-1][name]) > 0.0 for name in record.RATIOS)
