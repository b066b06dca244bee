"""Fuzzing of every loader, the environments' inputs and the server: many broken inputs, one of two
answers to each.

    python dev/tools/fuzz.py run [--minutes 20] [--inputs N] [--turns N] [--targets NAME ...] [--seed 0]
    python dev/tools/fuzz.py summary [--out out/fuzz]

An input may be accepted, or refused by an error of the family :mod:`pcs_racing.base.errors`.
Anything else is a finding: another exception, a warning, more than 2 seconds of processor, more
memory than 500 MB, a crash of the interpreter; and, silent until now, NaN, infinite or complex
numbers in what a file that was accepted is read as.

Inputs are valid ones whose bytes and structure are changed (:mod:`fuzz_inputs`). Input number k
depends on the seed, the target and k alone. Each target works in a process of its own with an upper
limit on memory, in turns until the time is up; what was done is kept in ``log.jsonl`` line by line,
and the same command goes on from there. Findings are kept as files, one for each place in the code.
"""

import argparse
import hashlib
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_inputs import broken
from fuzz_places import PLACES
from fuzz_targets import TARGETS as LOADERS
from fuzz_targets import scratch

from pcs_racing.base.errors import InputError

TARGETS = {**LOADERS, **PLACES}
SLICE = 20.0  # seconds of processor that a target gets in a turn
SLOW = 2.0  # seconds of processor
STUCK = 300.0  # seconds beyond a slice, after which a process is ended
MEMORY = 500_000_000  # bytes that one input may add to the most that the process ever held
LIMIT = 6_000_000_000  # of the process's address space, above what it has at the start
MOST_BYTES = 20_000


def judge(
    run: Callable[[bytes], object], data: bytes, plain: bool = False, again: bool = True
) -> tuple[str, str]:
    """Return what a target makes of an input: a word, and for findings where it happened."""
    # Of this thread alone: what else the machine does must make no input slow.
    began, before = time.thread_time(), peak()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read = run(data)
        odd = odd_number(read) if plain else ""
        answer = ("SILENT", odd) if odd else ("accepted", "")
    except InputError as error:
        text = str(error)
        answer = (
            ("refused", "")
            if text and "\n" not in text
            else ("CRASH", f"message of several lines: {text[:60]!r}")
        )
    except RecursionError:
        answer = "CRASH", "RecursionError"
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        # Findings are told apart by the innermost line of ours: libraries fail in many places for
        # one reason.
        own = [frame for frame in frames if "pcs_racing" in frame.filename] or list(frames)
        answer = (
            "CRASH",
            (
                f"{type(error).__name__} in {Path(own[-1].filename).name}:{own[-1].lineno}:"
                f" {str(error)[:80]}"
            ),
        )
    if time.thread_time() - began > SLOW and again:
        return judge(run, data, plain, again=False)  # the first time may have compiled something
    if time.thread_time() - began > SLOW:
        return "SLOW", f"{time.thread_time() - began:.1f} s"
    if peak() - before > MEMORY:
        return "MEMORY", f"{(peak() - before) / 1e6:.0f} MB"
    return answer


def odd_number(value: Any, where: str = "") -> str:
    """Return where the first number that is not finite and real stands; nothing if there is none."""
    parts: Any = ()
    if isinstance(value, float | complex | np.ndarray | np.generic):
        found = np.asarray(value)
        if found.dtype.kind == "c" or (found.dtype.kind == "f" and not np.isfinite(found).all()):
            return where or "it"
    elif is_dataclass(value) and not isinstance(value, type):
        parts = [(field.name, getattr(value, field.name, None)) for field in fields(value)]
    elif isinstance(value, Mapping):
        parts = value.items()
    elif isinstance(value, list | tuple):
        parts = enumerate(value)
    return next(filter(None, (odd_number(part, f"{where}.{name}") for name, part in parts)), "")


def peak() -> int:
    """Return the most memory that the process ever held, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )


def broken_input(target: str, seed: int, number: int, valid: list[bytes]) -> bytes:
    """Return input ``number`` of a target."""
    rng = random.Random(f"{seed} {target} {number}")
    return broken(rng, valid, TARGETS[target].kind)[: max(MOST_BYTES, 2 * max(map(len, valid)))]


def keep_finding(out: Path, target: str, word: str, where: str, data: bytes) -> None:
    folder = out / "findings"
    folder.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha256(f"{target} {word} {where.partition(': ')[0]}".encode()).hexdigest()[:12]
    kept = folder / f"{name}.bin"
    if not kept.exists() or len(data) < kept.stat().st_size:
        kept.write_bytes(data)
        (folder / f"{name}.txt").write_text(f"{target}\n{word}\n{where}\n")


def work(target: str, seed: int, first: int, seconds: float, out: Path, present: Any) -> None:
    """Run inputs from number ``first`` on, and write a line of the log; in a process of its own."""
    run, valid = TARGETS[target].run, TARGETS[target].seeds()
    # Compiles, and fills caches. Without a sound input all others would be refused at the same
    # early place.
    answers = [judge(run, data, TARGETS[target].plain)[0] for data in valid]
    if "accepted" not in answers and TARGETS[target].kind != "values":
        sys.exit(f"no valid input of {target} is accepted")
    # Above what is there already: compiled code and libraries take gigabytes of addresses, though
    # little memory.
    space = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (space + LIMIT, space + LIMIT))
    counts: Counter[str] = Counter()
    begin = time.process_time()
    while present.value < TARGETS[target].most and (
        not counts or time.process_time() - begin < seconds
    ):
        data = broken_input(target, seed, present.value, valid)
        word, where = judge(run, data, TARGETS[target].plain)
        counts[word] += 1
        if word not in ("accepted", "refused"):
            keep_finding(out, target, word, where, data)
        # after the input: if the process dies, the parent knows which one it was
        present.value += 1
    write_line(out, target, seed, first, counts, time.process_time() - begin)
    shutil.rmtree(scratch(), ignore_errors=True)


def write_line(
    out: Path, target: str, seed: int, first: int, counts: Counter[str], seconds: float
) -> None:
    line = {
        "target": target,
        "seed": seed,
        "first": first,
        "inputs": counts.total(),
        "counts": counts,
    }
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "log.jsonl", "a", encoding="utf-8") as file:
        file.write(json.dumps({**line, "seconds": round(seconds, 2)}) + "\n")


def read_log(out: Path) -> list[dict[str, Any]]:
    file = out / "log.jsonl"
    return (
        [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        if file.is_file()
        else []
    )


def take_turn(target: str, seed: int, seconds: float, out: Path) -> bool:
    """Give a target its turn, from the input on where the last one ended; False if it has had all."""
    done = [line for line in read_log(out) if (line["target"], line["seed"]) == (target, seed)]
    first = max((line["first"] + line["inputs"] for line in done), default=0)
    if first >= TARGETS[target].most:
        return False
    context = get_context("fork")
    present = context.Value("q", first)
    child = context.Process(target=work, args=(target, seed, first, seconds, out, present))
    child.start()
    # An input that never ends would hold up all other targets.
    child.join(seconds + STUCK)
    child.kill()
    child.join()
    if child.exitcode == 1:
        raise SystemExit(f"fuzzing {target} failed by a fault of its own")
    if child.exitcode:
        data = broken_input(target, seed, present.value, TARGETS[target].seeds())
        keep_finding(out, target, "DEAD", f"exit code {child.exitcode}", data)
        counts = Counter({"not counted": present.value - first, "DEAD": 1})
        write_line(out, target, seed, first, counts, 0.0)
    return True


def summary(out: Path) -> None:
    """Print what was done, target by target and in all, and what was found."""
    totals: dict[str, Counter[str]] = {}
    for line in read_log(out):
        for name in (line["target"], "all"):
            totals.setdefault(name, Counter()).update(
                {**line["counts"], "seconds": line["seconds"]}
            )
    print(f"{'target':26} {'seconds':>8} {'accepted':>9} {'refused':>9} {'findings':>8}")
    for name, row in sorted(totals.items(), key=lambda item: (item[0] == "all", item[0])):
        findings = sum(row[word] for word in ("CRASH", "SILENT", "SLOW", "MEMORY", "DEAD"))
        print(
            f"{name:26} {row['seconds']:8.1f} {row['accepted']:9d} {row['refused']:9d}"
            f" {findings:8d}"
        )
    for file in sorted((out / "findings").glob("*.txt")):
        print(f"{file.stem}: {' | '.join(file.read_text().splitlines())}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("run", "summary"), nargs="?", default="run")
    parser.add_argument(
        "--targets", nargs="+", default=list(TARGETS), choices=list(TARGETS), metavar="NAME"
    )
    parser.add_argument(
        "--minutes", type=float, default=20.0, help="after which no other turn begins"
    )
    parser.add_argument(
        "--inputs", type=int, default=10**9, help="in the log, after which no other turn begins"
    )
    parser.add_argument("--turns", type=int, default=10**6, help="of each target, at most")
    parser.add_argument(
        "--slice", type=float, default=SLICE, help="seconds of processor for a target in a turn"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    left = list(given.targets) if given.what == "run" else []
    end = time.monotonic() + 60.0 * given.minutes

    def goes_on() -> bool:
        return (
            time.monotonic() < end
            and sum(line["inputs"] for line in read_log(given.out)) < given.inputs
        )

    for _ in range(given.turns):
        left = [
            name
            for name in left
            if goes_on() and take_turn(name, given.seed, given.slice, given.out)
        ]
        if not left:
            break
    summary(given.out)


if __name__ == "__main__":
    main()
