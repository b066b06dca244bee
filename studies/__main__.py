"""The command line of the experiments: ``python -m studies NAME``, in the root of a checkout."""

import argparse
import sys
from collections.abc import Sequence

from pcs_racing_agents.cli.commands import add_commands
from pcs_racing_agents.cli.main import run_parsed
from studies import everything, family, headroom, reading, rows
from studies.field import command as field
from studies.overtaking import command as overtaking
from studies.ppo_against_cfr import command as ppo_against_cfr


def main(arguments: Sequence[str] | None = None) -> int:
    """Run an experiment; with the errors and exit statuses of ``pcs-racing``."""
    parser = argparse.ArgumentParser(
        prog="python -m studies", description=__doc__, allow_abbrev=False
    )
    commands = parser.add_subparsers(title="experiments", metavar="NAME", required=True)
    single = everything, family, headroom, reading, rows
    for command in (*single, field, overtaking, ppo_against_cfr):
        add_commands(commands, command)
    return run_parsed(parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
