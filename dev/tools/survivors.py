"""Print the faults that no test noticed, but for those in ``mutants_accepted.csv``.

    nox -s mutants -- pcs_racing/car/ittc.py

puts the faults into a file and runs this with cosmic-ray's record of them.
"""

import csv
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ACCEPTED = Path(__file__).with_name("mutants_accepted.csv")


def plain(file: str, before: str, after: str) -> tuple[str, ...]:
    """Return a fault without blanks and brackets, which cosmic-ray and the list set differently."""
    return (file, *(re.sub(r"[\s()]", "", line) for line in (before, after)))


def accepted() -> set[tuple[str, ...]]:
    """Return the faults of the list."""
    with open(ACCEPTED, newline="", encoding="utf-8") as file:
        return {plain(row["file"], row["before"], row["after"]) for row in csv.DictReader(file)}


def survivors(record: str) -> Iterator[tuple[str, str, str]]:
    """Yield file, line before and line after of each fault in cosmic-ray's record that survived."""
    for text in record.splitlines():
        fault, result = json.loads(text)
        if result and result["test_outcome"] == "survived":
            lines = result["diff"].splitlines()
            before, after = (
                " ".join(line[1:] for line in lines if re.match(rf"\{sign}(?!\{sign})", line))
                for sign in "-+"
            )
            yield fault["mutations"][0]["module_path"], before, after


def main() -> int:
    record = subprocess.run(
        ["cosmic-ray", "dump", sys.argv[1]], check=True, capture_output=True, text=True
    ).stdout
    known = accepted()
    found = [fault for fault in survivors(record) if plain(*fault) not in known]
    for file, before, after in found:
        print(f"{file}\n  - {before.strip()}\n  + {after.strip()}")
    print(f"{len(record.splitlines())} faults, {len(found)} unnoticed and not accepted")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
