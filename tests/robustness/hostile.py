"""Inputs that ask for far more than they are worth, one after the other in a process with little
memory.

Run by `test_found_by_fuzzing.py`; prints a line for every case that is not refused by one of our
own errors.
"""

import hashlib
import io
import os
import resource
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import yaml

from pcs_racing import InputError, load_archive, load_rules, load_track, racer
from pcs_racing.base.settings import read_settings
from pcs_racing.envs.drive import DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.game.archive_files import ARCHIVE_FORMAT
from pcs_racing.track.map_files import parse_csv, parse_grid, read_map
from pcs_racing.track.maps import parse_ros_yaml
from pcs_racing_agents.agents.blind import load_fit
from pcs_racing_agents.base.folders import claim_folder
from pcs_racing_agents.base.jobs import read_chunk, write_chunk
from pcs_racing_agents.networks import load_network
from pcs_racing_agents.tournament.race_files import read_results
from pcs_racing_agents.trees import load_trees

ROOM = 1_000_000_000  # bytes above the memory of the process at the start
GROWTH = 300_000_000  # that the most it ever held may grow by
SECONDS = 5.0  # of processor for one case
GREY = {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.25}

BOMB = "\n".join(["a0: &a0 [x, x]", *(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40))])
MERGED = "\n".join(
    ["a0: &a0 {k: v}", *(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 40))]
)
TEXTS = {
    "names that stand for names": BOMB,
    "merged mappings": MERGED,
    "deep nesting": "a: " + "[" * 1000,
    "deep mappings": "{a: " * 1000,
    "a long number": "seed: 0x" + "f" * 100_000,
    "a large file": "a: " + "x" * 2_000_000,
    "code": "!!python/object/apply:os.system ['touch hacked']",
}


def arrays(**values: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **values)
    return buffer.getvalue()


def announced(shape: str, kind: str = "<f8") -> bytes:
    text = (
        f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(118)
        + b"\n"
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(
            "parameters.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
        )
    return buffer.getvalue()


def zeros(size: int) -> bytes:
    """A zip file of a few MB that unpacks to much more."""
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open("parameters.npy", "w", force_zip64=True) as out,
    ):
        for _ in range(size // 10_000_000):
            out.write(bytes(10_000_000))
    return buffer.getvalue()


class Evil:
    """Code that would run if anything here was unpickled."""

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, ("touch hacked",)


def png(width: int, height: int) -> bytes:
    def part(name: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + part(b"IHDR", head)
        + part(b"IDAT", zlib.compress(bytes(1000)))
        + part(b"IEND", b"")
    )


def cases(here: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """Name and call of every case; files are made in ``here``."""

    def file(name: str, content: bytes | str) -> Path:
        path = here / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    readers: dict[str, Callable[[Path], object]] = {
        "map": lambda path: parse_ros_yaml(path, path.read_bytes()),
        "race config": load_rules,
        "config": read_settings,
        "fit": load_fit,
    }
    for what, text in TEXTS.items():
        path = file("hostile.yaml", text)
        for reader, read in readers.items():
            yield f"{reader}: {what}", lambda read=read, path=path: read(path)
        for folder, manifest, load in (
            ("archive", "manifest.yaml", load_archive),
            ("network", "manifest.yaml", load_network),
            ("trees", "job.yaml", load_trees),
        ):
            place = here / f"{folder}-folder"
            place.mkdir(exist_ok=True)
            (place / manifest).write_text(text)
            yield f"{folder}: {what}", lambda load=load, place=place: load(place)
        job = here / "job-folder"
        job.mkdir(exist_ok=True)
        (job / "job.yaml").write_text(text)
        yield f"job: {what}", lambda job=job: claim_folder(job, "kind", {}).__enter__()

    contents = {
        "an array of terabytes": announced("(1000000000000,)"),
        "a text of gigabytes": announced("()", "<U1000000000"),
        "zeros": zeros(ROOM + 100_000_000),
        "objects": arrays(parameters=np.array([Evil()], object)),
    }
    for what, content in contents.items():
        path = file("hostile.npz", content)
        yield f"chunk: {what}", lambda path=path: read_chunk(path)
        place = here / "arrays-folder"
        place.mkdir(exist_ok=True)
        manifest = yaml.safe_load(
            (ARCHIVE_FORMAT.shipped / "default" / "manifest.yaml").read_text()
        )
        manifest["arrays_sha256"] = hashlib.sha256(content).hexdigest()
        (place / "manifest.yaml").write_text(yaml.safe_dump(manifest))
        (place / "archive.npz").write_bytes(content)
        yield f"archive: {what}", lambda place=place: load_archive(place)
    signed = here / "signed.npz"
    write_chunk(signed, {"a": np.zeros(3)}, "0" * 64)
    signed.write_bytes(signed.read_bytes()[:-60])
    yield "a chunk that was cut off", lambda: read_chunk(signed)

    for size in ((100_000, 100_000), (2**31 - 1, 1), (1, 2**31 - 1), (9000, 9000), (8000, 8000)):
        yield f"a picture of {size}", lambda size=size: parse_grid(here / "x.png", png(*size), GREY)
    yield (
        "a table of one line",
        lambda: parse_csv(here / "x.csv", b"1," * 4_000_000, ("x", "y"), ","),
    )
    yield (
        "a table of numbers that are none",
        lambda: parse_csv(here / "x.csv", b"nan,inf\n" * 100, ("x", "y"), ","),
    )

    yield (
        "a table of millions of points",
        lambda: parse_csv(here / "x.csv", b"0,0\n" * 2_000_000, ("x", "y"), ","),
    )
    wide = file("wide.csv", ",".join(f"c{i}" for i in range(50_000)) + "\na" * 50_000)
    short = file("short.csv", ",".join(f"c{i}" for i in range(900)) + "\na" * 1_000_000)
    zero = here / "zero.csv"
    zero.symlink_to("/dev/zero")
    for what, path in (("wide", wide), ("short lines", short), ("without end", zero)):
        yield f"results of races: {what}", lambda path=path: read_results(path)

    yield "a billion beams", lambda: DriveVectorEnv(1, beams=10**9)
    yield "a billion environments", lambda: DriveVectorEnv(10**9)
    yield "many environments with many beams", lambda: DriveVectorEnv(100_000, beams=100_000)
    yield "a billion games", lambda: DuelVectorEnv(10**9)
    yield "a thousand moves", lambda: DuelVectorEnv(1, steps=(1.0,) * 1001)
    yield "a billion seeds", lambda: DriveVectorEnv(2, opponent=None).reset(seed=[0] * 3)
    yield "a long policy", lambda: racer("lattice:" + "pace=1," * 100_000)
    yield "a long name", lambda: load_track("x" * 100_000)

    # Leaving the folder of a map.
    outside = here / "outside.png"
    outside.write_bytes(png(20, 20))
    folder = here / "Map"
    folder.mkdir()
    (folder / "link.png").symlink_to(outside)
    (folder / "zero.png").symlink_to("/dev/zero")
    (folder / "loop.png").symlink_to(folder / "loop.png")
    os.mkfifo(folder / "pipe.png")
    links = ("link.png", "zero.png", "loop.png", "pipe.png")
    for image in ("../outside.png", str(outside), *links, "/dev/zero", ".", "a\x00b"):
        text = yaml.safe_dump({"image": image, "resolution": 0.1, "origin": [0.0, 0.0, 0.0]})

        def read(text: str = text) -> object:
            (folder / "Map_map.yaml").write_text(text)
            return read_map(folder)

        yield f"a picture that is {image!r}", read


def main() -> None:
    here = Path(sys.argv[1])
    os.chdir(here)
    # compiled before anything is measured: that is no fault of a case
    DriveVectorEnv(2, opponent=None).reset(seed=0)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (held + ROOM, held + ROOM))
    count = 0
    for name, call in cases(here):
        count += 1
        before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.thread_time()
        try:
            call()
            answer = "accepted"
        except InputError as error:
            answer = (
                ""
                if "\n" not in str(error) and len(str(error)) < 3000
                else "a message that is too long"
            )
        except BaseException as error:
            answer = f"{type(error).__name__}: {error}"[:200]
        if 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) > GROWTH:
            answer += " memory"
        if time.thread_time() - began > SECONDS:
            answer += " time"
        if answer:
            print(f"{name}: {answer}")
    if Path("hacked").exists():
        print("code was run")
    print(f"{count} cases")


if __name__ == "__main__":
    main()
