"""Fuzzing of every loader and of the environments' inputs: many broken inputs, and one of two answers to each.

    python tools/fuzz.py run [--minutes 20] [--targets NAME ...] [--out out/fuzz] [--seed 0]
    python tools/fuzz.py atheris TARGET [--runs 20000]
    python tools/fuzz.py summary [--out out/fuzz]

An input may be accepted, or refused by an error of the family :mod:`pcs_racing.errors`. Anything else is a finding:
another exception, a warning, more than 2 seconds of processor, more memory than 500 MB, a crash of the interpreter.

``run`` mutates valid inputs, bytes and structure: input number k of a target depends on the seed, the target and k
alone. Each target works in a process of its own with an upper limit on memory, in turns until the time is up; what was
done is kept in ``log.jsonl`` line by line, and the same command goes on from there. Findings are kept as files, one for
each place in the code. ``atheris`` fuzzes one target guided by coverage (``pip install atheris``), from the same valid
inputs, and writes into the same log. The generators of hypothesis are a third engine (``--engine hypothesis``).
"""

import argparse
import hashlib
import json
import mmap
import os
import random
import resource
import struct
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

PLAIN = (
    "yaml", "fuzz_mutations", "fuzz_targets", *(f"pcs_racing.{name}" for name in (
        "reading", "map_files", "maps", "packing", "replay", "registry", "race_config", "archive", "files", "errors",
    )), *(f"pcs_racing_agents.{name}" for name in (
        "configuration", "chunk_files", "job_folders", "strategies.fits", "ppo.curves", "study.cell_races",
    )),
)  # fmt: skip
"""Modules that atheris instruments: those without compiled functions."""

if sys.argv[1:2] == ["atheris"]:  # modules are instrumented when they are first imported
    import atheris

    with atheris.instrument_imports(include=list(PLAIN)):
        import fuzz_targets  # noqa: F401

from fuzz_mutations import mutations  # noqa: E402

from pcs_racing.errors import InputError  # noqa: E402

SLICE = 20.0  # seconds of processor that a target gets in a turn
SLOW = 2.0  # seconds
STUCK = 60.0  # seconds of processor beyond a slice, after which a process is ended
MEMORY = 500_000_000  # bytes that one input may add to the most that the process ever held
LIMIT = 6_000_000_000  # of the process's address space, above what it has at the start
MOST_BYTES = 20_000


def judge(run: Callable[[bytes], object], data: bytes, again: bool = True) -> tuple[str, str]:
    """Return what a target makes of an input: a word, and for findings where it happened."""
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
    wall, begin = time.monotonic(), time.process_time()
    number = first
    for data in inputs(target, engine, seeds, seed, first, one.kind, one.words):
        struct.pack_into("<qq", shared, 0, number, len(data))
        shared[16 : 16 + len(data)] = data
        word, where = judge(one.run, data)
        counts[word] += 1
        if word not in ("accepted", "refused"):
            keep_finding(out / "findings", target, word, where, data)
        number += 1
        if time.process_time() - begin > seconds or number >= one.most:
            break
    write_line(
        out, target=target, engine=engine, seed=seed, first=first, inputs=number - first, counts=dict(counts),
        processor=round(time.process_time() - begin, 2), clock=round(time.monotonic() - wall, 2), peak_mb=peak() // 10**6,
    )  # fmt: skip


def inputs(
    target: str, engine: str, seeds: list[bytes], seed: int, first: int, kind: str, words: tuple[str, ...]
) -> Iterator[bytes]:
    """Inputs of a target from number ``first`` on."""
    if engine == "hypothesis":
        yield from generated(seeds, kind, seed + first)
        return
    number = first
    while True:
        rng = random.Random(f"{seed} {target} {number}")
        yield mutations(rng, seeds, kind, words)[:MOST_BYTES]
        number += 1


def generated(seeds: list[bytes], kind: str, seed: int) -> Iterator[bytes]:
    """Inputs that hypothesis makes: structures with the seeds' own names in them, or plain bytes."""
    from fuzz_mutations import strategy
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as with_seed

    source = strategy(seeds, kind)
    while True:
        found: list[bytes] = []

        @with_seed(seed)
        @settings(
            max_examples=500,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(source)
        def collect(data: bytes, found: list[bytes] = found) -> None:
            found.append(data[:MOST_BYTES])

        collect()
        yield from found
        seed += 1


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


def campaign(targets: list[str], engine: str, seed: int, minutes: float, slice_seconds: float, out: Path) -> None:
    """Give the targets their turns until the time is up."""
    from fuzz_targets import TARGETS

    context = get_context("fork")
    end = time.monotonic() + 60.0 * minutes
    while time.monotonic() < end:
        idle = True
        for target in targets or list(TARGETS):
            lines = [line for line in read_log(out) if (line["target"], line["engine"]) == (target, engine)]
            first = max((line["first"] + line["inputs"] for line in lines if line["seed"] == seed), default=0)
            if first >= TARGETS[target].most or time.monotonic() > end:
                continue
            idle = False
            shared = mmap.mmap(-1, MOST_BYTES + 16)
            child = context.Process(target=work, args=(target, engine, seed, first, slice_seconds, out, shared))
            child.start()
            while child.is_alive():
                child.join(1.0)
                if processor_of(child.pid) > slice_seconds + STUCK:
                    child.kill()
            if child.exitcode == 1:
                raise SystemExit(f"fuzzing {target} failed by a fault of its own")
            if child.exitcode:
                number, size = struct.unpack_from("<qq", shared, 0)
                keep_finding(out / "findings", target, "DEAD", f"exit code {child.exitcode}", shared[16 : 16 + size])
                done = number + 1 - first
                write_line(
                    out, target=target, engine=engine, seed=seed, first=first, inputs=done, counts={"DEAD": 1},
                    processor=0.0, clock=0.0, peak_mb=0,
                )  # fmt: skip
        if idle:
            break
    summary(out)


def atheris_campaign(target: str, runs: int, out: Path) -> None:
    """Fuzz one target guided by coverage."""
    import atheris
    from fuzz_targets import TARGETS

    one = TARGETS[target]
    corpus = out / "corpus" / hashlib.sha256(target.encode()).hexdigest()[:8]
    corpus.mkdir(parents=True, exist_ok=True)
    for i, data in enumerate(one.seeds()):
        (corpus / f"seed-{i}").write_bytes(data[:MOST_BYTES])
    counts: Counter[str] = Counter()
    began, clock = time.process_time(), time.monotonic()

    def test(data: bytes) -> None:
        word, where = judge(one.run, data)
        counts[word] += 1
        if word not in ("accepted", "refused"):
            keep_finding(out / "findings", target, word, where, data)
        if sum(counts.values()) == runs:
            write_line(
                out, target=target, engine="atheris", seed=0, first=0, inputs=runs, counts=dict(counts),
                processor=round(time.process_time() - began, 2), clock=round(time.monotonic() - clock, 2),
                peak_mb=peak() // 10**6,
            )  # fmt: skip
            os._exit(0)

    atheris.Setup(
        [sys.argv[0], "-max_len=4000", "-rss_limit_mb=6000", "-timeout=120", "-seed=1", "-verbosity=0", str(corpus)],
        test,
    )
    atheris.Fuzz()


def summary(out: Path) -> None:
    """Print what was done, and what was found."""
    totals: dict[tuple[str, str], Counter[str]] = {}
    for line in read_log(out):
        row = totals.setdefault((line["target"], line["engine"]), Counter())
        row.update(line["counts"])
        row["inputs"] += line["inputs"]
        row["milliseconds"] += round(1000 * line["processor"])
    print(f"{'target':26} {'engine':10} {'inputs':>9} {'per s':>7} {'accepted':>9} {'refused':>9} {'findings':>8}")
    whole: Counter[str] = Counter()
    for (target, engine), row in sorted(totals.items()):
        findings = row["inputs"] - row["accepted"] - row["refused"]
        speed = 1000 * row["inputs"] / max(row["milliseconds"], 1)
        print(
            f"{target:26} {engine:10} {row['inputs']:9d} {speed:7.0f} {row['accepted']:9d} {row['refused']:9d} "
            f"{findings:8d}"
        )
        whole.update(row)
    findings = whole["inputs"] - whole["accepted"] - whole["refused"]
    print(
        f"{'all':26} {'':10} {whole['inputs']:9d} {1000 * whole['inputs'] / max(whole['milliseconds'], 1):7.0f} "
        f"{whole['accepted']:9d} {whole['refused']:9d} {findings:8d}"
    )
    for file in sorted((out / "findings").glob("*.txt")):
        print(f"{file.stem}: {' | '.join(file.read_text().splitlines())}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "atheris", "summary"), nargs="?", default="run")
    parser.add_argument("target", nargs="?", default="yaml", help="of atheris")
    parser.add_argument("--engine", choices=("mutations", "hypothesis"), default="mutations")
    parser.add_argument("--targets", nargs="+", default=[])
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--slice", type=float, default=SLICE, help="seconds of processor for a target in a turn")
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    if given.what == "summary":
        summary(given.out)
    elif given.what == "atheris":
        atheris_campaign(given.target, given.runs, given.out)
    else:
        campaign(given.targets, given.engine, given.seed, given.minutes, given.slice, given.out)


if __name__ == "__main__":
    main()
