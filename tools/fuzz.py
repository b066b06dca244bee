"""Fuzzing of every loader and of the environments' inputs: many broken inputs, and one of two answers to each.

    python tools/fuzz.py run [--engine mutations] [--minutes 20] [--turns N] [--targets NAME ...] [--seed 0]
    python tools/fuzz.py summary [--out out/fuzz]

An input may be accepted, or refused by an error of the family :mod:`pcs_racing.base.errors`. Anything else is a finding:
another exception, a warning, more than 2 seconds of processor, more memory than 500 MB, a crash of the interpreter.

Three engines make inputs (``--engine``): ``mutations`` changes bytes and structure of valid ones, ``hypothesis``
generates, ``atheris`` is guided by coverage (``pip install atheris``). Input number k of the first depends on the seed,
the target and k alone. Each target works in a process of its own with an upper limit on memory, in turns until the time
is up; what was done is kept in ``log.jsonl`` line by line, and the same command goes on from there. Findings are kept
as files, one for each place in the code.
"""

import argparse
import hashlib
import json
import mmap
import os
import resource
import struct
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fuzz_engines import ENGINES, MOST_BYTES, fuzz_guided, generate, import_instrumented, mutate

SLICE = 20.0  # seconds of processor that a target gets in a turn
SLOW = 2.0  # seconds
STUCK = 60.0  # seconds of processor beyond a slice, after which a process is ended
MEMORY = 500_000_000  # bytes that one input may add to the most that the process ever held
HEADER = 32  # bytes before an input that is shared with the process that watches
LIMIT = 6_000_000_000  # of the process's address space, above what it has at the start


def judge(run: Callable[[bytes], object], data: bytes, again: bool = True) -> tuple[str, str]:
    """Return what a target makes of an input: a word, and for findings where it happened."""
    from pcs_racing.base.errors import InputError  # not before atheris has seen the import

    began, before = time.thread_time(), peak()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run(data)
        answer = "accepted", ""
    except InputError as error:
        text = str(error)
        answer = ("refused", "") if text and "\n" not in text else ("CRASH", f"message of several lines: {text[:60]!r}")
    except RecursionError:
        answer = "CRASH", "RecursionError"
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "pcs_racing" in frame.filename] or list(frames)
        answer = "CRASH", f"{type(error).__name__} in {Path(own[-1].filename).name}:{own[-1].lineno}: {str(error)[:80]}"
    if time.thread_time() - began > SLOW and again:
        return judge(run, data, again=False)  # the first time may have compiled something
    if time.thread_time() - began > SLOW:
        return "SLOW", f"{time.thread_time() - began:.1f} s"
    if peak() - before > MEMORY:
        return "MEMORY", f"{(peak() - before) / 1e6:.0f} MB"
    return answer


def peak() -> int:
    """Return the most memory that the process ever held, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def keep_finding(folder: Path, target: str, word: str, where: str, data: bytes) -> None:
    name = hashlib.sha256(f"{target} {word} {where.partition(': ')[0]}".encode()).hexdigest()[:12]
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / f"{name}.bin"
    if not kept.exists() or len(data) < kept.stat().st_size:
        kept.write_bytes(data)
        (folder / f"{name}.txt").write_text(f"{target}\n{word}\n{where}\n")


def work(target: str, engine: str, seed: int, first: int, seconds: float, out: Path, shared: mmap.mmap) -> None:
    """Run inputs from number ``first`` on, and write a line of the log; in a process of its own."""
    from fuzz_targets import TARGETS

    one = TARGETS[target]
    seeds = one.seeds()
    for data in seeds:  # compiles, and fills caches
        judge(one.run, data)
    space = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (space + LIMIT, space + LIMIT))
    counts: Counter[str] = Counter()
    wall, begin, number = time.monotonic(), time.process_time(), first

    def try_one(data: bytes) -> bool:
        """Judge an input, and say whether there is time for another."""
        nonlocal number
        size = min(len(data), MOST_BYTES)
        struct.pack_into("<4q", shared, 0, number, size, counts["accepted"], counts["refused"])
        shared[HEADER : HEADER + size] = data[:size]
        word, where = judge(one.run, data)
        counts[word] += 1
        number += 1
        if word not in ("accepted", "refused"):
            keep_finding(out / "findings", target, word, where, data)
        return time.process_time() - begin < seconds and number < one.most

    def note() -> None:
        write_line(
            out, target=target, engine=engine, seed=seed, first=first, inputs=number - first, counts=dict(counts),
            processor=round(time.process_time() - begin, 2), clock=round(time.monotonic() - wall, 2),
            peak_mb=peak() // 10**6,
        )  # fmt: skip

    if engine == "atheris":
        corpus = out / "corpus" / hashlib.sha256(target.encode()).hexdigest()[:8]
        fuzz_guided(try_one, note, seeds, corpus, f"{seed} {target} {first}")
    elif engine == "hypothesis":
        generate(try_one, seeds, f"{seed} {target}", first, one.kind)
    else:
        mutate(try_one, seeds, f"{seed} {target}", first, one.kind, one.words)
    note()


def processor_of(pid: int | None) -> float:
    """Processor time of a process so far, s; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def write_line(out: Path, **values: Any) -> None:
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "log.jsonl", "a", encoding="utf-8") as file:
        file.write(json.dumps(values) + "\n")


def read_log(out: Path) -> list[dict[str, Any]]:
    file = out / "log.jsonl"
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.is_file() else []


def campaign(
    targets: list[str], engine: str, seed: int, minutes: float, turns: int, slice_seconds: float, out: Path
) -> None:
    """Give the targets their turns until the time is up."""
    if engine == "atheris":
        import_instrumented()
    from fuzz_targets import TARGETS

    context = get_context("fork")
    end = time.monotonic() + 60.0 * minutes
    for _ in range(turns):
        idle = True
        for target in targets or list(TARGETS):
            lines = [line for line in read_log(out) if (line["target"], line["engine"]) == (target, engine)]
            first = max((line["first"] + line["inputs"] for line in lines if line["seed"] == seed), default=0)
            if first >= TARGETS[target].most or time.monotonic() > end:
                continue
            idle = False
            shared = mmap.mmap(-1, MOST_BYTES + HEADER)
            child = context.Process(target=work, args=(target, engine, seed, first, slice_seconds, out, shared))
            child.start()
            while child.is_alive():
                child.join(1.0)
                if processor_of(child.pid) > slice_seconds + STUCK:
                    child.kill()
            if child.exitcode == 1:
                raise SystemExit(f"fuzzing {target} failed by a fault of its own")
            if child.exitcode:
                number, size, accepted, refused = struct.unpack_from("<4q", shared, 0)
                data = shared[HEADER : HEADER + size]
                keep_finding(out / "findings", target, "DEAD", f"exit code {child.exitcode}", data)
                counts = {"accepted": accepted, "refused": refused, "DEAD": 1}
                write_line(
                    out, target=target, engine=engine, seed=seed, first=first, inputs=number + 1 - first, counts=counts,
                    processor=0.0, clock=0.0, peak_mb=0,
                )  # fmt: skip
        if idle or time.monotonic() > end:
            break
    summary(out)


def summary(out: Path) -> None:
    """Print what was done, target by target and engine by engine, by what is read, and in all; and what was found."""
    from fuzz_targets import GROUPS

    group = {target: name for name, targets in GROUPS.items() for target in targets}
    totals: dict[tuple[str, str], Counter[str]] = {}
    inputs: dict[str, Counter[str]] = {name: Counter() for name in [*GROUPS, "all"]}
    for line in read_log(out):
        for target, engine in ((line["target"], line["engine"]), ("all", line["engine"]), ("all", "all")):
            row = totals.setdefault((target, engine), Counter())
            row.update(line["counts"])
            row["inputs"] += line["inputs"]
            row["milliseconds"] += round(1000 * line["processor"])
        for name in (group[line["target"]], "all"):
            inputs[name][line["engine"]] += line["inputs"]
    print(f"{'target':26} {'engine':10} {'inputs':>9} {'seconds':>8} {'accepted':>9} {'refused':>9} {'findings':>8}")
    for (target, engine), row in sorted(totals.items(), key=lambda item: (item[0][0] == "all", item[0])):
        findings = row["inputs"] - row["accepted"] - row["refused"]
        print(
            f"{target:26} {engine:10} {row['inputs']:9d} {row['milliseconds'] / 1000:8.1f} {row['accepted']:9d} "
            f"{row['refused']:9d} {findings:8d}"
        )
    print("\n| inputs | " + " | ".join(ENGINES) + " |\n| --- |" + " ---: |" * len(ENGINES))
    for name, row in inputs.items():
        print(f"| {name} | " + " | ".join(f"{row[engine]:,}" for engine in ENGINES) + " |")
    print()
    for file in sorted((out / "findings").glob("*.txt")):
        print(f"{file.stem}: {' | '.join(file.read_text().splitlines())}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "summary"), nargs="?", default="run")
    parser.add_argument("--engine", choices=ENGINES, default="mutations")
    parser.add_argument("--targets", nargs="+", default=[])
    parser.add_argument("--minutes", type=float, default=20.0, help="after which no other turn begins")
    parser.add_argument("--turns", type=int, default=10**6, help="of each target, at most")
    parser.add_argument("--slice", type=float, default=SLICE, help="seconds of processor for a target in a turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    if given.what == "summary":
        summary(given.out)
    else:
        campaign(given.targets, given.engine, given.seed, given.minutes, given.turns, given.slice, given.out)


if __name__ == "__main__":
    main()
