"""``pcs-racing study``: run a study, from the game trees to the report."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import TRACK_HELP, Workers


@command(
    "study",
    "pcs-racing study quick --out out/quick",
    "pcs-racing study paper --out out/paper",
    "pcs-racing study out/my-study.yaml --out out/mine",
    "pcs-racing study contest --archive out/my-archive --seed 1 --out out/contest",
    "pcs-racing study contest --test-track maps/Monza maps/Spielberg --out out/real",
)
def run(
    config: Annotated[
        str, Option(f"settings: {', '.join(shipped_configs('study'))} or a YAML file")
    ],
    *,
    out: Annotated[Path, Option("folder of the study; an interrupted run resumes here", "DIR")],
    seed: Annotated[
        int | None, Option("seed of all random draws (default: seed of the settings)")
    ] = None,
    archive: Annotated[
        str | None, Option("name or folder of an archive (default: archive of the settings)", "A")
    ] = None,
    test_track: Annotated[
        Sequence[str], Option(f"further test circuits of the main table: {TRACK_HELP}", "T")
    ] = (),
    workers: Workers,
) -> None:
    """Run a complete study: archive, game trees, networks, agents, races and report."""
    from pcs_racing_agents.study import load_study_config, run_study

    given: dict[str, Any] = {"seed": seed, "archive": archive}
    changes = {name: value for name, value in given.items() if value is not None}
    settings = load_study_config(config, **changes)
    if test_track:
        tracks = (*settings.table.tracks, *test_track)
        settings = replace(settings, table=replace(settings.table, tracks=tracks))
    with workers.start() as executor:
        study = run_study(settings, out, executor=executor)
    for file in ("results.csv", "table.csv", "report.html"):
        print(f"{file}: {study.folder / file}")
    print((study.folder / "table.txt").read_text(encoding="utf-8"))
