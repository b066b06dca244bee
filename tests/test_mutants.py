"""The tool behind ``make mutants``: which faults it makes, and that its table fits the tree."""

import csv

from repository import REPOSITORY, load_tool

faults, mutants, table = (load_tool(name) for name in ("faults", "mutants", "mutants_table"))

TEXT = '''"""A module's words stay as they are, 1 and 2 and 3."""

from math import floor

if TYPE_CHECKING:
    from math import ceil

__all__ = ["lead"]


def lead(own0, own1, length=2.0):
    """How far car 0 is ahead."""
    if own0 < own1:
        raise ValueError(f"{1 + 1} cars")
    way = min(own0 - own1, length)
    way += 1
    plot(way, color="blue", alpha=0.5)
    return -way


class Rules:
    duration: Annotated[float, Interval(ge=0.1, le=3600.0), "Length, s."] = 40.0
'''


def test_faults_are_small_and_leave_words_and_messages_alone():
    made = {fault.after for fault in faults.faults_of(TEXT)}
    assert made >= {
        "def lead(own0, own1, length=(4.0)):",
        "if (own0 > own1):",
        "if (not (own0 < own1)):",
        "if own1 < own1:",
        "way = (max(own0 - own1, length))",
        "way = min((own0 + own1), length)",
        "way = min(own0, length)",
        "way -= 1",
        "way += (0)",
        "pass",
        "return way",
    }
    alone = ("words", "ValueError", "import", "TYPE_CHECKING", "alpha", "duration")
    assert not any(word in after for word in alone for after in made if after != "pass")


def test_every_fault_is_one_change_and_one_seed_draws_the_same():
    for fault in faults.faults_of(TEXT):
        assert faults.changes_something(TEXT, fault)
        lines = zip(TEXT.split("\n"), fault.text.split("\n"), strict=True)
        changed = [k for k, (a, b) in enumerate(lines, 1) if a != b]
        assert changed == [fault.line]
    draw = mutants.drawn
    few, many, others = draw("a.py", TEXT, 3, 1), draw("a.py", TEXT, 5, 1), draw("a.py", TEXT, 5, 2)
    assert len(few) == 3
    assert many[:3] == few
    assert others != many
    assert len({fault.line for fault in many}) == 5  # spread over the lines


def test_every_room_has_faults_and_tests_and_the_nearest_tests_come_first():
    rooms = {
        file.parent.relative_to(REPOSITORY).as_posix()
        for file in REPOSITORY.glob("pcs_racing*/*/__init__.py")
    }
    assert {table.room_of(file) for file in table.files()} == rooms
    for room in rooms:
        of_room = [file for file in table.files() if table.room_of(file) == room]
        assert table.tests_of(of_room[0], table.COMPILED), room
        assert [table.files()[file] for file in of_room] == sorted(
            map(table.files().get, of_room), reverse=True
        )
    assert (
        table.tests_of("pcs_racing/track/grid.py", table.PLAIN)[0]
        == "tests/pcs_racing/track/test_grid.py"
    )
    for file in table.files():  # those with its name first, then those that import it
        tests = table.tests_of(file, table.COMPILED)
        module, stem = (
            file.removesuffix(".py").replace("/", "."),
            file.rpartition("/")[2].removesuffix(".py"),
        )
        ranks = [
            (stem not in test.rpartition("/")[2], module not in (REPOSITORY / test).read_text())
            for test in tests
        ]
        assert ranks == sorted(ranks), file


def test_what_the_table_names_is_there_and_every_survivor_has_a_reason():
    assert [test for test in table.PLAIN_TESTS if not (REPOSITORY / test).is_file()] == []
    for room, patterns in table.ELSEWHERE.items():
        assert (REPOSITORY / room).exists()
        assert all(any(REPOSITORY.glob(pattern)) for pattern in patterns)
    with open(mutants.ACCEPTED, newline="") as file:
        for row in csv.DictReader(file):
            assert row["file"] in table.files()
            assert row["before"] != row["after"]
            assert len(row["reason"]) > 10, row
