"""``pcs-racing agents``: the agents and drivers there are, what they do, and their options."""

import argparse

from pcs_racing_agents.commands.options import Commands, add_command

__all__ = ["add"]

NEEDS = {"": "", "fit": "; needs a fit", "network": "; needs a network"}


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "agents",
        "list agents and drivers with what they do and their options",
        "pcs-racing agents best-fixed",
    )
    parser.add_argument("agent", nargs="?", help="only this one")
    parser.add_argument("--archive", default="default", help="archive that agents move in (default: default)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Print one agent, or all."""
    from pcs_racing.errors import UnknownNameError
    from pcs_racing_agents.strategies.zoo import entries, names, options

    known = entries()
    listed = [arguments.agent] if arguments.agent else names(arguments.archive)
    for name in listed:
        if name not in known:
            if name not in names(arguments.archive):
                raise UnknownNameError(f"agent {name!r} is unknown; there are: {', '.join(names(arguments.archive))}")
            print(f"{name}\n  makes the same move again and again")
            continue
        entry = known[name]
        print(f"{name}\n  {entry.summary}{NEEDS[entry.needs]}")
        if entry.source:
            print(f"  source: {entry.source}")
        for option, default in options(name).items():
            print(f"  option {option}, by default {default!r}")
