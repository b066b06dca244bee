"""Run the tests of the rooms that a change touches: of files that differ from a branch, and that
git does not know.

    python dev/tools/quick.py
    python dev/tools/quick.py --against origin/main --list

The tests of ``pcs_racing/car/lidar.py`` are those in ``tests/pcs_racing/car``; a changed test file
runs as well. The floors and the budgets are always checked. All tests run with ``make test``, but
for those with a mark: ``--marks`` prints which of these ``make test`` leaves out for a change.
"""

import argparse
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
ALWAYS = ("tests/test_floors.py", "tests/test_budgets.py")
PACKAGES = ("pcs_racing", "pcs_racing_agents")
MARKS = {
    "benchmarks": ("dev/benchmarks/", "test_benchmarks.py"),
    "browser": ("pcs_racing/race/", "pcs_racing_agents/watch/", "pcs_racing_agents/study/"),
    "cluster": ("pcs_racing_agents/base/",),
    "training": ("examples/", "pcs_racing_agents/learning/", "pcs_racing/envs/"),
}
"""Marks of tests that start many programs, and the places whose changes these tests are for."""


def left_out(changed: list[str]) -> str:
    """Return the expression for ``pytest -m`` that leaves out marks of unchanged rooms."""
    paths = [path.removeprefix("tests/") for path in changed]
    marks = [
        mark for mark, rooms in MARKS.items() if not any(path.startswith(rooms) for path in paths)
    ]
    return " and ".join(f"not {mark}" for mark in marks)


def select(changed: list[str]) -> list[str]:
    """Return the test files and folders of changed files; paths are those in the repository."""
    found = list(ALWAYS)
    for path in map(Path, changed):
        folder = Path("tests") / path.parent
        if path.parts[0] == "tests" and path.name.startswith("test_"):
            folder = path
        elif path.suffix == ".md":
            folder = Path("tests/test_docs.py")
        elif path.parts[0] not in PACKAGES or path.name == "__init__.py":
            continue
        # Rooms without a folder of tests of their own belong to the one around them, but for the
        # whole package.
        while not (REPOSITORY / folder).exists() and len(folder.parts) > 3:
            folder = folder.parent
        if (REPOSITORY / folder).exists():
            found.append(folder.as_posix())
    return list(dict.fromkeys(found))


def git(*arguments: str) -> list[str]:
    done = subprocess.run(
        ["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", default="HEAD", help="branch or commit to compare with")
    parser.add_argument("--list", action="store_true", help="print the tests, and run none")
    parser.add_argument("--marks", action="store_true", help="print what `make test` leaves out")
    given = parser.parse_args()
    changed = git("diff", "--name-only", given.against)
    changed += git("ls-files", "--others", "--exclude-standard")
    if given.marks:
        print(left_out(changed))
        return 0
    tests = select(changed)
    print("\n".join(tests), flush=True)
    if given.list:
        return 0
    return subprocess.run([sys.executable, "-m", "pytest", *tests], cwd=REPOSITORY).returncode


if __name__ == "__main__":
    sys.exit(main())
