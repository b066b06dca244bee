"""``pcs-racing synthesize``: search for an archive of policies; a stopped search can be resumed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pcs_racing.base.errors import require
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import ConfigOptions, Option, command
from pcs_racing_agents.cli.options import TRACK_HELP, Workers
from pcs_racing_agents.policies.archive_run import ArchiveCallback, SearchProgress, synthesize
from pcs_racing_agents.policies.config import (
    SHIPPED_TRACKS,
    ArchiveConfig,
    load_archive_config,
)


@command(
    "synthesize",
    "pcs-racing synthesize --out out/archive",
    "pcs-racing synthesize --track Tarnfjord Pipkin --generations 30 --population 24 --out"
    " out/mine",
    "pcs-racing synthesize --config default --out out/default",
)
def run(
    *,
    out: Annotated[
        Path, Option("folder of the archive; an interrupted search resumes here", "DIR")
    ],
    config: Annotated[
        str | None,
        Option(
            f"configuration: {', '.join(shipped_configs('archive'))} or a YAML file; other options"
            " override them",
            "C",
        ),
    ] = None,
    track: Annotated[
        Sequence[str] | None,
        Option(
            f"{TRACK_HELP}; every policy races on all of them (default:"
            f" {', '.join(SHIPPED_TRACKS)})",
            "T",
        ),
    ] = None,
    rules: Annotated[
        str | None, Option("rules of the races (default: from the configuration)")
    ] = None,
    changes: Annotated[
        dict[str, Any],
        ConfigOptions(ArchiveConfig, "generations", "population", "seed", "name"),
    ],
    workers: Workers,
) -> None:
    """Search for an archive of policies that drive differently."""
    if track is not None:
        changes["tracks"] = tuple(track)
    if rules is not None:
        changes["rules"] = rules
    if config is None:
        changes.setdefault("name", out.resolve().name)
    settings = load_archive_config(config, **changes)
    # A missing library is reported before hours of work, not after them.
    require("moocore", "cma", extra="synthesis")
    print(
        f"{settings.name}: {', '.join(settings.tracks)}, rules {settings.rules}, "
        f"{settings.generations} generations of {settings.population} policies",
        flush=True,
    )
    with workers.start() as executor:
        archive = synthesize(settings, out, executor=executor, callback=show_search())
    print(archive)
    for axis, low, high in zip(archive.characteristics, archive.nadir, archive.ideal, strict=True):
        print(f"{axis}: {low:.2f} to {high:.2f}")
    for (one, other), together in archive.correlations.items():
        print(f"correlation of {one} and {other}: {together:+.3f}")
    for key in (
        "policies_not_beaten",
        "hypervolume",
        "own_crash_mean",
        "own_crash_max",
        "win_share",
        "duplicate_share",
    ):
        value = archive.settings[key]
        print(f"{key.replace('_', ' ')}: {value:.4g}")
    print(f"archive: {out}")


def show_search() -> ArchiveCallback:
    """Return a callback that keeps a line on stderr up to date: races, hypervolume, time left."""
    show = show_progress("steps")

    def update(stage: str, done: int, total: int, state: SearchProgress | None) -> None:
        about = (
            f", generation {state.generation}, hypervolume {state.hypervolume:.3f},"
            f" {state.front} policies, own crashes {state.own_crash:.1%}"
            if state
            else ""
        )
        show(done, total, stage + about)

    return update
