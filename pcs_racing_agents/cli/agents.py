"""``pcs-racing agents`` and ``policies``: list agents and drivers, and planners with their parameters."""

import argparse

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing_agents.cli.options import Commands, add_command, add_race
from pcs_racing_agents.results.text_table import aligned


def add(commands: Commands) -> None:
    """Add the commands ``agents`` and ``policies``."""
    parser = add_command(
        commands,
        "agents",
        "list all agents and drivers, or describe one of them: options, training, strength, cost, hash",
        "pcs-racing agents",
        "pcs-racing agents best-fixed",
        "pcs-racing agents response --archive contest --race contest",
    )
    parser.add_argument("agent", nargs="?", help="name of the agent to describe (default: list all)")
    parser.add_argument(
        "--archive", default="default", help="archive whose policies the agents drive (default: default)"
    )
    add_race(parser)
    parser.set_defaults(run=run)
    parser = add_command(
        commands,
        "policies",
        "list planners with the bounds and meanings of their parameters",
        "pcs-racing policies lattice",
    )
    parser.add_argument("planner", nargs="?", help="name of the planner to list (default: all)")
    parser.set_defaults(run=run_policies)


def run(arguments: argparse.Namespace) -> None:
    """Print a description of one agent, or one line for each agent."""
    from pcs_racing_agents.agents.describe import describe, facts_of
    from pcs_racing_agents.agents.setting import make_setting
    from pcs_racing_agents.agents.zoo import entries, names

    setting = make_setting(arguments.archive, arguments.race)
    available, listed = entries(), names(setting.archive, setting.config)
    if arguments.agent is None:
        constant = "makes the same move again and again"
        rows = [(name, available[name].summary if name in available else constant) for name in listed]
        print("\n".join(aligned(rows, left=2)))
        return
    if arguments.agent not in listed:
        raise UnknownNameError(f"agent {arguments.agent!r} is unknown; there are: {', '.join(listed)}")
    if arguments.agent in available:
        told = describe(arguments.agent, available[arguments.agent]).replace("`", "")
        print(f"{arguments.agent}\n\n{told}")
    else:
        print(f"{arguments.agent}\n\nMakes the same move again and again.\n")
    print(f"\nWith archive {setting.archive.name} in the {setting.race} race:")
    print("\n".join(f"- {line}" for line in facts_of(arguments.agent, setting)))


def run_policies(arguments: argparse.Namespace) -> None:
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
