"""``pcs-racing study``: run a study, from the search for policies to the report."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from pcs_racing_agents.cli.options import TRACK_HELP, Commands, add_command
from pcs_racing_agents.jobs.configuration import shipped_configs


def add(commands: Commands) -> None:
    """Add the command ``study``."""
    parser = add_command(
        commands,
        "study",
        "run a complete study: archive, game trees, networks, agents, races and report",
        "pcs-racing study quick --out out/quick",
        "pcs-racing study paper --out out/paper",
        "pcs-racing study out/my-study.yaml --out out/mine --stage archive trees",
        "pcs-racing study contest-table --archive out/my-archive --seed 1 --out out/table",
        "pcs-racing study contest-wide --unseen maps/Monza maps/Spielberg --out out/wide",
    )
    names = ", ".join(shipped_configs("study"))
    parser.add_argument("config", help=f"settings: {names} or a YAML file")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the study; a study that was stopped resumes in its folder",
    )
    parser.add_argument("--stage", nargs="+", metavar="NAME", help="stages to run (default: all that are not finished)")
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of all random draws (default: that of the settings)"
    )
    parser.add_argument(
        "--archive", metavar="ARCHIVE", help="name or folder of an archive to use instead of that of the settings"
    )
    parser.add_argument(
        "--unseen", nargs="+", default=[], metavar="T", help=f"further circuits of the main table: {TRACK_HELP}"
    )
    from pcs_racing_agents.jobs.executors import add_executor_options

    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run a study, and print the paths of its results."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, stage_estimates
    from pcs_racing_agents.jobs.executors import executor_from
    from pcs_racing_agents.study import load_study_config, run_study
    from pcs_racing_agents.study.run import stage_seconds, stages_to_run

    changes: dict[str, Any] = {} if arguments.seed is None else {"seed": arguments.seed}
    if arguments.archive is not None:
        changes |= {"synthesis": None, "archive": arguments.archive}
    config = load_study_config(arguments.config, **changes)
    if arguments.unseen:
        config = replace(config, tracks=(*config.tracks, *arguments.unseen))
    remaining = {stage.name for stage in stages_to_run(config, arguments.out, arguments.stage)}
    seconds = sum(spent for stage, spent in stage_estimates(config).items() if stage in remaining)
    with executor_from(arguments) as executor:
        announce(seconds, cores_of(arguments))
        study = run_study(config, arguments.out, only=arguments.stage, executor=executor)
    for name, seconds in stage_seconds(study).items():
        print(f"{name:16} {seconds:8.1f} s")
    for file in ("results.csv", "table.txt", "report.html"):
        if (study.folder / file).is_file():
            print(f"{file}: {study.folder / file}")
    if (study.folder / "table.txt").is_file():
        print((study.folder / "table.txt").read_text(encoding="utf-8"))
