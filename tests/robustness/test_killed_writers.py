"""Writers of several files, killed before each of their steps: the former files or the new ones."""

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from pcs_racing import load_archive, load_track
from pcs_racing.game.archive_files import save_archive
from pcs_racing.track.map_files import read_map, write_map
from pcs_racing_agents.networks import (
    load_network,
    load_network_set,
    save_network,
    save_network_set,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
STEPS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "shutil.rmtree"}
"""Audit events of changes of files."""


class Writer(NamedTuple):
    """A writer of several files, and a reader that distinguishes two of its values."""

    write: Callable[[Path, Any], object]
    read: Callable[[Path], Any]
    values: Callable[[], tuple[Any, Any]]


def networks():
    one = load_network("default-paper-regret")
    return replace(one, name="former"), replace(one, name="new", mean=one.mean + 1.0)


def network_sets():
    one = load_network_set("contest-contest-psro")
    names = ("former", "new")
    return tuple(
        replace(one, name=name, networks=one.networks[:count], weights=one.weights[:count])
        for name, count in zip(names, (2, 3), strict=True)
    )


def maps():
    former = read_map(load_track("Pipkin").folder)
    info = {**former.info, "description": "new"}
    return former, former._replace(info=info, centerline=former.centerline + 0.001)


WRITERS = {
    "network": Writer(
        lambda folder, network: save_network(network, folder),
        lambda folder: (load_network(folder).name, load_network(folder).mean[0]),
        networks,
    ),
    "set of networks": Writer(
        lambda folder, networks: save_network_set(networks, folder),
        lambda folder: (load_network_set(folder).name, len(load_network_set(folder).networks)),
        network_sets,
    ),
    "archive": Writer(
        lambda folder, archive: save_archive(archive, folder),
        lambda folder: (load_archive(folder).name, load_archive(folder).content_hash),
        lambda: (load_archive("default"), load_archive("contest")),
    ),
    "map": Writer(
        lambda folder, content: write_map(content._replace(folder=folder)),
        lambda folder: (
            read_map(folder).info.get("description"),
            round(float(read_map(folder).centerline[0, 0]), 6),
        ),
        maps,
    ),
}


def killed(step: int, folder: Path, write: Callable[[], object]) -> bool:
    """Write in a process that is killed before a step in the folder; False if it ended earlier."""
    process = os.fork()
    if process == 0:
        steps = iter(range(step))

        def hook(event: str, given: tuple[Any, ...]) -> None:
            if event in STEPS and str(folder) in str(given) and next(steps, None) is None:
                os._exit(9)

        sys.addaudithook(hook)
        write()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 9


@pytest.mark.parametrize("name", WRITERS)
def test_a_kill_leaves_the_former_files_or_the_new_ones(tmp_path, name):
    write, read, values = WRITERS[name]
    former, new = values()
    folder = tmp_path / "folder"
    folder.mkdir()
    write(folder, new)
    after = read(folder)
    write(folder, former)
    before = read(folder)
    assert before != after
    step, found = 0, []
    while killed(step, folder, lambda: write(folder, new)):
        found.append(read(folder))
        assert found[-1] in (before, after), step
        write(folder, former)
        assert read(folder) == before
        step += 1
    assert {before, after} == set(found)
    assert read(folder) == after
