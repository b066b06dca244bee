"""``pcs-racing policies``: list the planners and their parameters."""

import argparse

from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing_agents.cli.options import Commands, add_command
from pcs_racing_agents.results.text_table import aligned


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
    rows = [(p.name, f"{p.default:g}", f"in [{p.low:g}, {p.high:g}]", p.meaning) for p in planner.parameters]
    lines += [f"  {line}" for line in aligned(rows)]
    return "\n".join(lines)
