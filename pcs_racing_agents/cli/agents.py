"""``pcs-racing agents`` and ``export``: agents, planners, and their networks."""

from pathlib import Path
from typing import Annotated

from pcs_racing.base.errors import UnknownNameError, choices
from pcs_racing.game.players import ALWAYS
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing.race.config import load_rules
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import ArchiveName, RulesName, archive_for, output_file

_CONSTANT = "makes the same move at every step"


@command(
    "agents",
    "pcs-racing agents",
    "pcs-racing agents best-fixed",
    "pcs-racing agents response --rules contest",
    "pcs-racing agents lattice",
)
def run(
    agent: Annotated[
        str | None, Option("name of the agent or planner to describe (default: list all)")
    ] = None,
    *,
    archive: ArchiveName = None,
    rules: RulesName = "paper",
) -> None:
    """List agents and planners, or describe one: options, training, strength; parameters."""
    from pcs_racing.game.make import make_game
    from pcs_racing_agents.agents.describe import describe, facts_of, shipped_words
    from pcs_racing_agents.agents.zoo import entries, names

    if agent is not None and agent.endswith(".py"):
        from pcs_racing.planners.imported import drivers_from

        drivers_from(agent)
    if agent is not None and (agent in planner_names() or agent.endswith(".py")):
        print(_describe(get_planner(agent)))
        return
    config = load_rules(rules)
    spec = make_game(None, archive_for(archive, config), config)
    available, listed = entries(), names(spec.archive, spec.rules)
    if agent is None:
        rows = [
            (name, available[name].summary + shipped_words(name))
            for name in listed
            if name in available
        ]
        constant = [name.removeprefix(ALWAYS) for name in listed if name not in available]
        rows.append((f"{ALWAYS}MOVE", f"{_CONSTANT}; MOVE: {', '.join(constant)}"))
        rows = [*sorted(rows), *((name, "planner") for name in planner_names())]
        print("\n".join(aligned(rows, left=2)))
        return
    if agent not in listed:
        known = [*listed, *planner_names()]
        raise UnknownNameError(f"agent {agent!r} is unknown; {choices(agent, known)}")
    about = f"{_CONSTANT.capitalize()}."
    if agent in available:
        about = describe(agent, available[agent]).replace("`", "")
    print(
        f"{agent}\n\n{about}\n\nWith archive {spec.archive.name} under the rules {spec.rules.name}:"
    )
    print("\n".join(f"- {line}" for line in facts_of(agent, spec)))


@command(
    "export",
    "pcs-racing export lidar-ppo --out lidar-ppo.onnx",
    "pcs-racing export model.zip --out model.onnx",
)
def run_export(
    network: Annotated[
        str,
        Option("model.zip, or the folder or name of a planner with a lidar"),
    ],
    *,
    out: Annotated[Path, Option("file to write (.onnx)", "FILE")],
) -> None:
    """Write the network of a policy or planner as an ONNX file."""
    from pcs_racing_agents.agents.onnx_export import export_onnx

    print(f"written: {export_onnx(network, output_file(out, '.onnx'))}")


def _describe(planner: Planner) -> str:
    lines = [planner.name]
    if planner.variants:
        lines.append(f"  variants: {', '.join(planner.variants)}")
    rows = [
        ("parameter", "default", "range", "meaning"),
        *(
            (p.name, f"{p.default:.4f}", f"[{p.low:g}, {p.high:g}]", p.meaning)
            for p in planner.parameters
        ),
    ]
    lines += [f"  {line}" for line in aligned(rows)]
    return "\n".join(lines)
