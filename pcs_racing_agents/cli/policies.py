"""``pcs-racing policies``: list the planners and their parameters."""

import argparse

from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing_agents.cli.options import Commands, add_command

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command ``policies``."""
    parser = add_command(
        commands,
        "policies",
        "list planners with the bounds and meanings of their parameters",
        "pcs-racing policies lattice",
    )
    parser.add_argument("planner", nargs="?", help="name of the planner to list (default: all)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Print one planner, or all planners."""
    names = [arguments.planner] if arguments.planner else planner_names()
    print("\n\n".join(_describe(get_planner(name)) for name in names))


def _describe(planner: Planner) -> str:
    lines = [planner.name]
    if planner.variants:
        lines.append(f"  variants: {', '.join(planner.variants)}")
    width = max((len(name) for name in planner.parameter_names), default=0)
    lines += [
        f"  {p.name.ljust(width)}  {p.default:6g}  in [{p.low:g}, {p.high:g}]  {p.meaning}" for p in planner.parameters
    ]
    return "\n".join(lines)
