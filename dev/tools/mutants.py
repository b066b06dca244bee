"""Put small faults into the code, one at a time, and see whether the tests notice.

``run`` puts them into a copy of the tree and runs the tests of the file's room; with ``--suite``
those that passed unnoticed go through all other tests. ``report`` counts by room and lists the
survivors. Results are added to ``out/mutants/results.csv`` line by line: a run that was stopped
goes on where it was left. A file that has changed is tried anew, a survivor is tried again when the
tests of its room have changed.

Survivors that do not matter stand in ``dev/tools/mutants_accepted.csv``, each with the reason.
"""

import argparse
import csv
import fnmatch
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from faults import Fault, changes_something, faults_of
from mutants_table import COMPILED, PLAIN, ROOT, files, room_of, tests_of

RESULTS = ROOT / "out" / "mutants" / "results.csv"
ACCEPTED = ROOT / "dev" / "tools" / "mutants_accepted.csv"
COLUMNS = ["file", "line", "kind", "before", "after", "source", "tests", "own", "suite", "seconds"]
LEFT_OUT = (".git", ".venv", "out", "build", "dist", "__pycache__", "generated")  # of the copy
SUITE = (
    "tests/goldens",
    "tests/pcs_racing",
    "tests/pcs_racing_agents",
    "tests/robustness",
    "tests",
)
MEMORY = 48 << 30  # bytes of addresses that a fault may take
PASSED = "-"

Row = dict[str, str]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", choices=("run", "report"))
    parser.add_argument("--faults", type=int, default=10, help="faults in each file (default 10)")
    parser.add_argument("--seed", type=int, default=1, help="which faults are drawn (default 1)")
    parser.add_argument(
        "--files", nargs="+", default=["*"], help="only files that match one of these patterns"
    )
    parser.add_argument(
        "--suite", action="store_true", help="try survivors with the rest of the suite"
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="processes of the rest of the suite (default 1)"
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="begin no further file after this time"
    )
    options = parser.parse_args()
    chosen = [
        file for file in files() if any(fnmatch.fnmatch(file, pattern) for pattern in options.files)
    ]
    if not chosen:
        sys.exit(f"no file with arithmetic or branches matches {' '.join(options.files)}")
    if options.command == "run":
        # so that the copies are removed
        signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))
        with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
            run(chosen, options, Workplace(Path(folder)))
    sys.exit(1 if report(chosen) else 0)


def run(chosen: list[str], options: argparse.Namespace, place: "Workplace") -> None:
    """Try the faults that were not tried yet, file by file; the rooms take turns."""
    done = {key(row): row for row in results()}
    end = time.monotonic() + 60.0 * options.minutes
    for file in chosen:
        if time.monotonic() < end:
            try_file(file, options, place, done)


def try_file(
    file: str, options: argparse.Namespace, place: "Workplace", done: dict[tuple[str, ...], Row]
) -> None:
    """Try the faults of one file."""
    text, tests = (
        (place.pristine / file).read_text(),
        digest(place.pristine, *tests_of(file, COMPILED)),
    )
    source = digest(place.pristine, file)
    earlier = {
        (row["line"], row["before"], row["after"])
        for row in done.values()
        if row["source"] == source
    }
    chosen = drawn(file, text, options.faults, options.seed)
    # A smaller --faults after a larger one must not forget survivors that were found before.
    again = [
        f
        for f in faults_of(text)
        if (str(f.line), f.before, f.after) in earlier and f not in chosen
    ]
    for fault in chosen + again:
        row = dict(
            zip(
                COLUMNS,
                (file, str(fault.line), fault.kind, fault.before, fault.after),
                strict=False,
            )
        )
        row |= {"source": source, "tests": tests, "own": "", "suite": ""}
        known = done.get(key(row))
        if known and (known["own"] != PASSED or known["tests"] == row["tests"]):
            row = dict(known)
        begun = time.monotonic()
        if not row["own"]:
            row["own"] = place.own_tests(file, fault)
        if options.suite and row["own"] == PASSED and not row["suite"] and not reason(row):
            row["suite"] = place.suite(file, fault, options.workers)
        if row != known:
            row["seconds"] = f"{time.monotonic() - begun:.0f}"
            add(row)


def drawn(file: str, text: str, count: int, seed: int) -> list[Fault]:
    """Faults of a file: first a line is drawn, then one of the faults that can be put there."""
    by_line: dict[int, list[Fault]] = {}
    for fault in faults_of(text):
        by_line.setdefault(fault.line, []).append(fault)
    # Each file has a stream of its own, so that an edit of one file draws no other faults in the
    # rest.
    rng = random.Random(f"{seed} {file}")
    lines, chosen = sorted(by_line), []
    rng.shuffle(lines)
    for line in lines:
        fault = rng.choice(by_line[line])
        if len(chosen) < count and changes_something(text, fault):
            chosen.append(fault)
    return chosen


class Workplace:
    """A copy of the tree with compiled code at hand, and a copy of that for the faults."""

    def __init__(self, folder: Path):
        self.pristine, self.tree = folder / "pristine", folder / "tree"
        self.limits: dict[tuple[str, frozenset[str]], tuple[float, list[str]]] = {}
        shutil.copytree(ROOT, self.pristine, ignore=shutil.ignore_patterns(*LEFT_OUT))

    def own_tests(self, file: str, fault: Fault) -> str:
        """Which test of its module noticed a fault; the plain ones are asked first."""
        found = PASSED
        for mode in (PLAIN, COMPILED):
            tests = tests_of(file, mode)
            if tests and found == PASSED:
                found = self.tried(file, fault, tests, mode)
        return found

    def suite(self, file: str, fault: Fault, workers: int) -> str:
        """Which of all tests noticed it."""
        more = ("-n", str(workers), "--dist", "worksteal") if workers > 1 else ()
        return self.tried(file, fault, (*SUITE, *more), COMPILED)

    def tried(self, file: str, fault: Fault, tests: tuple[str, ...], mode: str) -> str:
        """Which of some tests noticed the fault."""
        asked = mode, frozenset(tests)
        if asked not in self.limits:
            # Without any fault: compiled code is kept for later, the time is a measure, and what
            # fails says nothing.
            before = processor_seconds()
            failing = pytest(self.pristine, tests, mode, 7200.0, "--maxfail=1000")
            self.limits[asked] = (
                60.0 + 3.0 * (processor_seconds() - before),
                [f"--deselect={test}" for test in failing],
            )
            print(
                "".join(f"{test} fails without any fault ({mode})\n" for test in failing),
                end="",
                flush=True,
            )
        limit, left_out = self.limits[asked]
        # compiled code of the last fault must not be found
        if mode == COMPILED or not self.tree.exists():
            shutil.rmtree(self.tree, ignore_errors=True)
            shutil.copytree(self.pristine, self.tree)
        (self.tree / file).write_text(fault.text)
        found = pytest(self.tree, tests, mode, limit, "-x", *left_out)
        shutil.copy2(self.pristine / file, self.tree / file)
        return found[0] if found else PASSED


def pytest(tree: Path, tests: tuple[str, ...], mode: str, limit: float, *more: str) -> list[str]:
    """Run tests in a copy of the tree, and return those that failed."""
    # What the caller has set must not decide what is found.
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("NUMBA_", "PCS_RACING_"))
    }
    environment |= {"PYTHONPATH": str(tree), "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"}
    # The cache holds tracks that were built by code without the fault, under names that the code
    # decides.
    environment |= {
        "PCS_RACING_CACHE": str(tree / "cache"),
        "PCS_RACING_MAPS": "none",
        "PCS_RACING_REFERENCE": "none",
    }
    if mode == PLAIN:
        environment |= {
            "NUMBA_DISABLE_JIT": "1",
            "PYTHONDONTWRITEBYTECODE": "1" if tree.name == "tree" else "",
        }
    else:
        # The fault is compiled once and run for seconds: optimising would take longer than it
        # saves.
        environment |= {"NUMBA_OPT": "1", "NUMBA_LOOP_VECTORIZE": "0", "NUMBA_SLP_VECTORIZE": "0"}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "--tb=no",
        "-rfE",
        "--hypothesis-seed=0",
        "-p",
        "no:cacheprovider",
    ]
    if mode == PLAIN:
        command += ["-W", "ignore::RuntimeWarning"]  # of overflows and 0 / 0, which are meant
    # In a session of its own: tests start workers, and a fault may leave them behind.
    process = subprocess.Popen(
        [*command, *more, *tests],
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=partial(limit_resources, limit),
    )
    try:
        output, _ = process.communicate(timeout=20.0 * limit)
    except subprocess.TimeoutExpired:
        return ["time limit"]
    finally:
        with_group(process)
    if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return ["time limit"]
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return failed or ([f"exit status {process.returncode}"] if process.returncode else [])


def processor_seconds() -> float:
    """Processor time of all processes that were waited for so far."""
    times = os.times()
    return times.children_user + times.children_system


def limit_resources(seconds: float) -> None:
    """Let a fault fail that never ends or asks for ever more memory (there are no limits on
    Windows).
    """
    import resource

    # Processor time, because a machine that is busy with something else must not find faults.
    resource.setrlimit(resource.RLIMIT_CPU, (round(seconds), round(seconds) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def with_group(process: "subprocess.Popen[str]") -> None:
    """End a process and whatever it has started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


def report(chosen: list[str]) -> int:
    """Print the share of faults that were found in each room, and return how many survivors nobody
    has accepted.
    """
    rows = [row for row in {key(row): row for row in results()}.values() if row["file"] in chosen]
    rows = [row for row in rows if row["source"] == digest(ROOT, row["file"])]
    # Kinds of faults that are no longer made do not count either way.
    made = {
        file: {(str(f.line), f.after) for f in faults_of((ROOT / file).read_text())}
        for file in {r["file"] for r in rows}
    }
    rows = [row for row in rows if (row["line"], row["after"]) in made[row["file"]]]
    heading = ("files", "tried", "faults", "own tests", "suite", "accepted", "open", "found")
    print(f"{'room':32}" + "".join(f"{name:>10}" for name in heading))
    survivors: list[Row] = []
    for room in [*sorted(set(map(room_of, chosen))), "together"]:
        of_room = [row for row in rows if room in ("together", room_of(row["file"]))]
        own = [row for row in of_room if row["own"] != PASSED]
        suite = [
            row for row in of_room if row["own"] == PASSED and row["suite"] not in ("", PASSED)
        ]
        accepted = [
            row for row in of_room if row["own"] == PASSED and row not in suite and reason(row)
        ]
        survivors = [
            row for row in of_room if row not in own and row not in suite and row not in accepted
        ]
        # an accepted fault changes nothing that a test could see
        counted = len(of_room) - len(accepted)
        found = f"{(len(own) + len(suite)) / counted:.0%}" if counted else "-"
        numbers = (
            sum(room in ("together", room_of(file)) for file in chosen),
            len({row["file"] for row in of_room}),
        )
        numbers += tuple(map(len, (of_room, own, suite, accepted, survivors)))
        print(f"{room:32}" + "".join(f"{cell:>10}" for cell in (*numbers, found)))
    for row in survivors:
        print(
            f"\n{row['file']}:{row['line']}"
            f" ({row['kind']}){'' if row['suite'] else ', the suite not asked yet'}"
        )
        print(f"  - {row['before']}\n  + {row['after']}")
    return len(survivors)


def results() -> Iterator[Row]:
    """Every line of the file of results."""
    if RESULTS.exists():
        with open(RESULTS, newline="") as file:
            yield from csv.DictReader(file)


def add(row: Row) -> None:
    """Add a line to the results, and say it."""
    new = not RESULTS.exists()
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    with open(RESULTS, "a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)
    outcome = row["own"] if row["own"] != PASSED else f"SURVIVED {row['suite']}".rstrip()
    print(
        f"{row['file']}:{row['line']} {row['after'][:70]!r}: {outcome} ({row['seconds']} s)",
        flush=True,
    )


def key(row: Row) -> tuple[str, ...]:
    return tuple(row[name] for name in ("file", "source", "line", "before", "after"))


def reason(row: Row) -> str:
    """Why a survivor does not matter; empty if nobody has said so."""
    if not ACCEPTED.exists():
        return ""
    with open(ACCEPTED, newline="") as file:
        for accepted in csv.DictReader(file):
            if all(accepted[name] == row[name] for name in ("file", "before", "after")):
                return accepted["reason"]
    return ""


def digest(tree: Path, *files: str) -> str:
    return hashlib.sha256(b"".join((tree / file).read_bytes() for file in files)).hexdigest()[:12]


if __name__ == "__main__":
    main()
