"""What is fuzzed beside loaders: what stands in the place of a file (links, pipes, folders), and
the local server.
"""

import io
import json
import os
import shutil
import socket
import struct
import sys
import threading
import zipfile
from functools import cache, partial
from pathlib import Path
from typing import Any

from fuzz_inputs import Draw
from fuzz_targets import (
    ARTIFACTS,
    Target,
    artifact,
    card_folder,
    first_pairing,
    job,
    job_folder,
    scratch,
    small_game,
    small_map,
    tournament_folder,
    values,
)

from pcs_racing import parse_policy
from pcs_racing.base.errors import InputError
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.sb3_files import load_sb3_policy
from pcs_racing_agents.benchmark.card import read_cards
from pcs_racing_agents.study.results import open_results
from pcs_racing_agents.watch.person_race import PersonRaces, make_person_drive
from pcs_racing_agents.watch.race_replays import RaceRepeater
from pcs_racing_agents.watch.view_server import Answer, RaceService, make_server

SECRET = "a-secret-of-another-folder"
FOLDERS: dict[str, tuple[Any, Any]] = {
    "map": (small_map, lambda folder: load_track(str(folder))),
    "job": (job_folder, job),
    "results": (tournament_folder, first_pairing),
    "cards": (card_folder, lambda folder: read_cards([folder])),
    **{kind: (partial(artifact, kind), read) for kind, (_, read) in ARTIFACTS.items()},
}


@cache
def outside() -> Path:
    """A folder beside all others, with a secret in it, and a device that never ends."""
    place = scratch() / "outside"
    place.mkdir()
    (place / "secret").write_text(f"{SECRET}: [{SECRET}, {SECRET}\n{SECRET}\n")
    (place / "zero").symlink_to("/dev/zero")
    return place


def replaced(name: str, data: bytes) -> object:
    """Read a copy of a folder in which something else stands in the place of one or two files."""
    folder, read = FOLDERS[name]
    place, draw = scratch() / f"replaced-{name}", Draw(data)
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder(), place)
    files = sorted(file for file in place.rglob("*") if file.is_file())
    for file in {draw.choice(files) for _ in range(1 + draw.byte() % 2)}:
        kept = outside() / "kept"
        shutil.copyfile(file, kept)
        file.unlink()
        what = draw.byte() % 9
        if what == 0:
            os.mkfifo(file)
        elif what == 1:
            file.mkdir()
        elif what == 2:
            with socket.socket(socket.AF_UNIX) as bound:
                bound.bind(str(file))
        elif what == 3:
            os.link(kept, file)
        else:
            drawn = (
                draw.data[draw.at :][: draw.byte()]
                .replace(b"\0", b"/")
                .decode("utf-8", "surrogateescape")
            )
            targets = (
                str(outside() / "secret"),
                str(kept),
                "/dev/zero",
                str(outside() / "zero"),
                file.name,
                "..",
                ".",
            )
            file.symlink_to(
                draw.choice((*targets, draw.choice(files).name, "nowhere", drawn or "x"))
            )
    try:
        return read(place)
    except InputError as error:
        if SECRET in str(error):
            raise AssertionError(f"the error tells what lies outside: {error}") from None
        raise


STATUS = {b"200", b"403", b"404", b"409", b"100", b"400", b"414", b"417", b"431", b"501", b"505"}


@cache
def server() -> tuple[int, list[str]]:
    """Start a server of all three services; return its port, and a list to which its faults are
    added.
    """
    folder = tournament_folder()
    results = open_results(folder)
    repeated = RaceService(RaceRepeater(results), len(results.races))
    played = PersonRaces(small_game(), parse_policy("lattice"))
    driven = make_person_drive(parse_policy("lattice:pace=0.3"), track="Pipkin")

    def answer(path: str) -> Answer:
        if path.startswith(("/begin", "/drive")):
            return driven.answer(path)
        return (played if path.count("/") > 2 else repeated).answer(path)

    found, faults = make_server("<p>the page", answer), []
    # Here a request ends with the half of the connection on which it came; the viewer is still
    # there.
    found.RequestHandlerClass._left = lambda _: False  # type: ignore[attr-defined]

    def note(*_: Any) -> None:
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError):
            faults.append(f"{type(error).__name__}: {error}")

    found.handle_error = note  # type: ignore[method-assign]
    threading.Thread(target=found.serve_forever, daemon=True).start()
    return found.server_address[1], faults


def ask(data: bytes) -> bytes:
    """Return all that the server says to some bytes."""
    with socket.create_connection(("127.0.0.1", server()[0]), 30) as one:
        # Without it each connection would keep its port for a minute.
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        try:
            one.sendall(data)
            one.shutdown(socket.SHUT_WR)
            return b"".join(iter(lambda: one.recv(1 << 16), b""))
        except ConnectionError:
            return b"HTTP/1.1 400"  # it may refuse before it has read all


def request(path: str, *lines: str) -> bytes:
    head = (f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{server()[0]}", *lines)
    return "\r\n".join([*head, "Connection: close", "", ""]).encode()


def served(data: bytes) -> object:
    """Send any bytes: they are answered, by something known, and the next viewer gets the page."""
    answer, faults = ask(data), server()[1]
    # What is cut off or no HTTP at all is not answered, or, as in its first version, without a
    # head.
    first = data.split(b"\n")[0].strip()
    if faults:
        raise AssertionError(f"the server failed: {faults.pop()}")
    if not (answer or not first) or SECRET.encode() in answer:
        raise AssertionError(f"answered by {answer[:60]!r}")
    if answer.startswith(b"HTTP/") and answer.split()[1] not in STATUS:
        raise AssertionError(f"answered by status {answer.split()[1]!r}")
    if b"the page" not in ask(request("/")):
        raise AssertionError("the next viewer does not get the page")
    return None if b" 200 " in answer[:20] else _refuse(answer)


def _refuse(answer: bytes) -> object:
    raise InputError(answer[:60].decode("latin-1").splitlines()[0] if answer else "nothing")


def requests() -> list[bytes]:
    paths = (
        "/",
        "/race/0",
        "/race/1",
        "/race/0/0",
        "/race/2/0-1.html",
        "/begin/1",
        "/drive/1/0/5/50/30",
    )
    more = (
        "Origin: http://127.0.0.1",
        "Sec-Fetch-Site: same-origin",
        "Content-Length: 5",
        "Expect: 100-continue",
    )
    return [request(path) for path in paths] + [request("/", line) for line in more]


# Models of Stable-Baselines3: an archive of two files


@cache
def model_parts() -> dict[str, bytes]:
    import torch

    sizes = {
        "mlp_extractor.policy_net.0": (4, 6),
        "mlp_extractor.policy_net.2": (4, 4),
        "action_net": (3, 4),
    }
    state = {f"{layer}.weight": torch.ones(size) for layer, size in sizes.items()}
    state |= {f"{layer}.bias": torch.ones(size[0]) for layer, size in sizes.items()}
    kept = io.BytesIO()
    torch.save(state, kept)
    settings = {
        "policy_kwargs": {"net_arch": [4, 4], ":type:": "<class 'dict'>"},
        "n_envs": 1,
        "seed": None,
    }
    return {"data": json.dumps(settings).encode(), "policy.pth": kept.getvalue()}


def model(part: str, data: bytes) -> object:
    """Read a model of which one part is fuzzed; "" is the archive itself."""
    if part:
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as file:
            for name, content in {**model_parts(), part: data}.items():
                file.writestr(name, content)
        data = archive.getvalue()
    (scratch() / "model.zip").write_bytes(data)
    return load_sb3_policy(scratch() / "model.zip").layers


def whole_model() -> list[bytes]:
    model("data", model_parts()["data"])
    return [(scratch() / "model.zip").read_bytes()]


PLACES = {
    f"files of {name} replaced": Target(partial(replaced, name), values(30), "values", 20_000)
    for name in FOLDERS
}
PLACES["model"] = Target(partial(model, ""), whole_model, "binary", plain=True)
for one, of_kind in (("data", "json"), ("policy.pth", "binary")):
    parts = partial(lambda name: [model_parts()[name]], one)
    PLACES[f"model's {one}"] = Target(partial(model, one), parts, of_kind, plain=True)
PLACES["server"] = Target(served, requests, "text", 50_000)
