"""``pcs-racing synthesize``: search for an archive of policies; a stopped search can be resumed."""

import argparse
import time
from collections import deque
from pathlib import Path

from pcs_racing.base.optional import require
from pcs_racing.base.settings import add_setting_options, stated_options
from pcs_racing_agents.cli.estimates import announce, cores_of, synthesis_seconds
from pcs_racing_agents.cli.options import TRACK_HELP, Commands, add_command
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.progress import show_line
from pcs_racing_agents.synthesis.archive_run import make_archive
from pcs_racing_agents.synthesis.archive_search import ArchiveCallback, ArchiveProgress
from pcs_racing_agents.synthesis.config import SHIPPED_TRACKS, ArchiveConfig, list_archive_configs, load_archive_config

OPTIONS = ("preset", "generations", "population", "method", "seed", "name")


def add(commands: Commands) -> None:
    """Add the command ``synthesize``."""
    parser = add_command(
        commands,
        "synthesize",
        "search for an archive of policies that drive differently, by racing on one or more circuits",
        "pcs-racing synthesize --out out/archive",
        "pcs-racing synthesize --track Tarnfjord Pipkin --generations 30 --population 24 --out out/mine",
        "pcs-racing synthesize --config default --out out/default",
    )
    shipped = ", ".join(list_archive_configs())
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the archive; a search that was stopped resumes in its folder",
    )
    parser.add_argument(
        "--config", metavar="C", help=f"settings: {shipped} or a YAML file; other options override them"
    )
    parser.add_argument(
        "--track",
        nargs="+",
        metavar="T",
        help=f"{TRACK_HELP}; every policy races on all of them (default: {', '.join(SHIPPED_TRACKS)})",
    )
    add_setting_options(parser, ArchiveConfig, *OPTIONS)
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Search, and print a summary of the archive."""
    changes = stated_options(arguments, ArchiveConfig)
    if arguments.track is not None:
        changes["tracks"] = tuple(arguments.track)
    if arguments.config is None:
        changes.setdefault("name", arguments.out.resolve().name)
    config = load_archive_config(arguments.config, **changes)
    require("moocore", *(("cma",) if config.method == "mo-cma-es" else ()), extra="synthesis")  # before hours of work
    print(
        f"{config.name}: {', '.join(config.tracks)}, preset {config.preset}, {config.generations} generations of "
        f"{config.population} policies",
        flush=True,
    )
    with executor_from(arguments) as executor:
        announce(synthesis_seconds(config), cores_of(arguments))
        archive = make_archive(config, arguments.out, executor=executor, callback=progress_line())
    print(archive)
    for axis, low, high in zip(archive.characteristics, archive.nadir, archive.ideal, strict=True):
        print(f"{axis}: {low:.2f} to {high:.2f}")
    for (one, other), together in archive.correlations.items():
        print(f"correlation of {one} and {other}: {together:+.3f}")
    for key in (
        "policies_not_beaten",
        "hypervolume",
        "hypervolume_error",
        "own_crash_mean",
        "own_crash_largest",
        "win_share_against_random",
        "duplicate_share",
    ):
        value = archive.settings[key]
        print(f"{key.replace('_', ' ')}: {value:.4g}")
    print(f"archive: {arguments.out}")


def progress_line() -> ArchiveCallback:
    """Return a callback that updates a line on stderr: progress, hypervolume, and remaining time."""
    print_line = show_line()
    begin = time.monotonic()
    recent = deque([(begin, 0.0)], maxlen=8)  # the last times and shares done: a resumed run begins fast

    def show(state: ArchiveProgress) -> None:
        recent.append((time.monotonic(), state.done))
        (first_time, first_done), (time_now, done) = recent[0], recent[-1]
        rest = ""
        if done > first_done:
            rest = f", about {(time_now - first_time) * (1.0 - done) / (done - first_done):.0f} s left"
        last = state.done >= 1.0
        print_line(
            f"{state.stage}: generation {state.generation}/{state.generations}, hypervolume {state.hypervolume:.3f}, "
            f"{state.front} policies, own crashes {state.own_crash:.1%}, {time_now - begin:.0f} s"
            f"{'' if last else rest}",
            last,
        )

    return show
