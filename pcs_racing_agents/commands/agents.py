"""``pcs-racing agents``: the agents and drivers there are, what they do, and their options."""

import argparse

from pcs_racing.errors import UnknownNameError
from pcs_racing_agents.commands.options import Commands, add_command

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands, "agents", "list agents and drivers, what they do, and their options", "pcs-racing agents best-fixed"
    )
    parser.add_argument("agent", nargs="?", help="only this one, with its options")
    parser.add_argument("--archive", default="default", help="archive that agents move in (default: default)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Print one agent, or a line for each."""
    from pcs_racing_agents.strategies.describe import describe
    from pcs_racing_agents.strategies.zoo import entries, names

    known, listed = entries(), names(arguments.archive)
    if arguments.agent is None:
        width = max(map(len, listed))
        for name in listed:
            told = known[name].summary if name in known else "makes the same move again and again"
            print(f"{name.ljust(width)}  {told}")
    elif arguments.agent in known:
        print(describe(arguments.agent, known[arguments.agent]).replace("`", "").replace("### ", ""))
    elif arguments.agent in listed:
        print(f"{arguments.agent}\n\nMakes the same move again and again.")
    else:
        raise UnknownNameError(f"agent {arguments.agent!r} is unknown; there are: {', '.join(listed)}")
