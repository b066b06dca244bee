"""``pcs-racing tune`` and ``synthesize``: searches of policies; a stopped search resumes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pcs_racing.base.errors import require
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.jobs import show_progress
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.cli.commands import ConfigOptions, Option, command
from pcs_racing_agents.cli.options import TRACK_HELP, Workers
from pcs_racing_agents.policies.archive_run import ArchiveCallback, SearchProgress, synthesize
from pcs_racing_agents.policies.config import SHIPPED_TRACKS, ArchiveConfig, load_archive_config
from pcs_racing_agents.policies.tuning import (
    HELD_OUT,
    TUNING_TRACKS,
    CheckLine,
    TuningCallback,
    TuningConfig,
    TuningProgress,
    tune,
)


@command(
    "tune",
    "pcs-racing tune spliner --out out/spliner",
    "pcs-racing tune lattice --against lattice spliner gap-follower --track Pipkin Tarnfjord"
    " --generations 60 --out out/lattice",
)
def run_tune(
    planner: Annotated[str, Option("planner whose parameters are tuned")],
    *,
    against: Annotated[
        Sequence[str],
        Option(
            "opponents: planner, planner:variant, planner:parameter=value,... (default:"
            " lattice:early)",
            "POLICY",
        ),
    ] = (),
    track: Annotated[Sequence[str], Option(f"circuits of the search: {TRACK_HELP}", "T")] = (),
    held_out: Annotated[
        Sequence[str],
        Option(
            f"circuits of choice and check only (default: {', '.join(HELD_OUT)}, if not searched)",
            "T",
        ),
    ] = (),
    rules: Annotated[str | None, Option("rules of the races: a name or a YAML file")] = None,
    out: Annotated[Path, Option("folder of the search; a stopped search resumes here", "DIR")],
    changes: Annotated[
        dict[str, Any],
        ConfigOptions(
            TuningConfig,
            "start",
            "fixed",
            "duration",
            "generations",
            "population",
            "starts",
            "crash_limit",
            "seed",
        ),
    ],
    workers: Workers,
) -> None:
    """Tune the parameters of a planner by races, and check them on circuits held out."""
    given = {"against": tuple(against), "tracks": tuple(track)}
    changes |= {key: value for key, value in given.items() if value}
    searched = changes.get("tracks", TUNING_TRACKS)
    rest = tuple(name for name in HELD_OUT if name not in searched)
    changes["held_out"] = tuple(held_out) or rest
    if rules is not None:
        changes["rules"] = rules
    config = TuningConfig(planner=planner, **changes)
    # A missing library is reported before the races, not after them.
    require("cma", extra="synthesis")
    with workers.start() as executor:
        tuned = tune(config, out, executor=executor, callback=show_tuning())
    print("\n".join(aligned(check_rows(tuned.check))))
    print(f"\n{tuned.kept}\n{tuned.policy.name}")
    print(f"written: {out / 'tuned.yaml'}, check.csv, progress.csv")


def show_tuning() -> TuningCallback:
    """Return a callback that keeps a line on stderr up to date."""
    show = show_progress("generations")

    def update(stage: str, done: int, total: int, state: TuningProgress | None) -> None:
        about = f", score {state.score:.2f}, own crashes {state.own_crash:.1%}" if state else ""
        show(done, total, stage + about)

    return update


def check_rows(check: Sequence[CheckLine]) -> list[tuple[str, ...]]:
    """Return a table with a line for each opponent: scores and own crashes, before and after."""
    rows: list[tuple[str, ...]] = [
        ("opponent", "circuits", "start", "own crashes", "tuned", "own crashes")
    ]
    for opponent in dict.fromkeys(line.opponent for line in check):
        for kind, words in (("no", "searched"), ("yes", "held out")):
            cells = []
            for policy in ("start", "tuned"):
                lines = [
                    one
                    for one in check
                    if (one.opponent, one.held_out, one.policy) == (opponent, kind, policy)
                ]
                if lines:
                    score, crash = np.mean([(one.score, one.own_crash) for one in lines], axis=0)
                    cells += [f"{score:.3f}", f"{crash:.1%}"]
            if cells:
                rows.append((opponent, words, *cells))
    return rows


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
