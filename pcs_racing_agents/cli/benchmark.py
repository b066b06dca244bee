"""``pcs-racing benchmark``: score cards, and their leaderboard."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Command, Option, command
from pcs_racing_agents.cli.options import Workers, output_folder

if TYPE_CHECKING:
    from pcs_racing_agents.agents.agent import Competitor
    from pcs_racing_agents.benchmark.protocol import Protocol
    from pcs_racing_agents.benchmark.scoring import CellRaces


group = Command(
    "benchmark",
    "Race agents by a fixed protocol, and rank their score cards.",
    ("pcs-racing benchmark card best-fixed --out out/cards/best-fixed",),
)


@command(
    "benchmark card",
    "pcs-racing benchmark card best-fixed --out out/cards/best-fixed",
    "pcs-racing benchmark card my_model.zip --out out/cards/mine",
    "pcs-racing benchmark card my_package.my_module:make_agent --weights net.pt --out"
    " out/cards/mine",
    "pcs-racing benchmark card line-ppo cfr-argmax --out out/cards/several",
)
def run(
    agents: Annotated[
        Sequence[str],
        Option(
            "name of an agent or planner, folder of a trained planner, module:function (called with"
            " the game spec, and the path of the weights if there is one), or a .zip file of"
            " Stable-Baselines3; each of several agents gets a card in its own folder",
            "AGENT",
        ),
    ],
    *,
    weights: Annotated[Path | None, Option("weights for module:function", "FILE")] = None,
    name: Annotated[str | None, Option("name on the card (default: name of the agent)")] = None,
    protocol: Annotated[str, Option("protocol: its name or a YAML file")] = "bench_v3",
    out: Annotated[Path, Option("folder of the card; an interrupted run resumes here", "DIR")],
    workers: Workers,
) -> None:
    """Race an agent by the fixed protocol of the benchmark, and write its score card."""
    from pcs_racing.game.competitor import competitor_name
    from pcs_racing_agents.agents.agent import competitor_hash
    from pcs_racing_agents.agents.zoo import load_entrant
    from pcs_racing_agents.benchmark.protocol import load_protocol
    from pcs_racing_agents.benchmark.scoring import play_protocol

    alone = len(agents) == 1
    if not alone and (weights is not None or name is not None):
        raise InputError(f"--weights and --name go with one agent; here are {len(agents)}")
    if weights is not None and ":" not in agents[0]:
        raise InputError("--weights goes with module:function")
    rules = load_protocol(protocol)
    entrants = [load_entrant(text, rules.spec, weights=weights, name=name) for text in agents]
    digests = [competitor_hash(agent) for agent in entrants]
    settings = {"protocol": rules.content_hash, "agents": digests}
    with workers.start() as executor, open_job(out, "benchmark", settings) as job:
        results = play_protocol(
            rules, entrants, job=job, executor=executor, progress=show_progress("races")
        )
        for agent, digest in zip(entrants, digests, strict=True):
            # Some file systems do not allow the colons and equals signs of agents' names.
            own = (
                out
                if alone
                else output_folder(out / re.sub(r"[^\w.+-]", "_", competitor_name(agent)))
            )
            _write(rules, agent, digest, results, own)


def _write(
    protocol: "Protocol",
    agent: "Competitor",
    digest: str,
    results: "dict[str, list[CellRaces]]",
    folder: Path,
) -> None:
    """Print and write the card of one agent."""
    from pcs_racing.game.competitor import competitor_name
    from pcs_racing_agents.base.tables import aligned
    from pcs_racing_agents.benchmark.card import Card, fact_lines, summary_rows, write_card
    from pcs_racing_agents.benchmark.scoring import decision_cost, gain, summarise

    name, config = competitor_name(agent), protocol.config
    own = results[name]
    raced = {name: own, **{blind: results[blind] for blind in config.blind}}
    compared = () if name in config.blind else ("train", "test", "all")
    found = {circuits: gain(raced, name, circuits) for circuits in compared}
    card = Card(
        protocol=config.name,
        protocol_sha256=protocol.content_hash,
        agent=name,
        agent_sha256=digest,
        scores=tuple(summarise(own)),
        # A planner with other start lines than the baselines has no races in common with them.
        gains={key: value for key, value in found.items() if value is not None},
        cost_us=decision_cost(protocol, agent),
    )
    print(f"\n{name}")
    print("\n".join(aligned(summary_rows(card))))
    print("\n".join(fact_lines(card)))
    for path in write_card(card, folder):
        print(f"written: {path}")


@command(
    "benchmark leaderboard",
    "pcs-racing benchmark leaderboard out/cards/mine out/cards/zoo --out out/leaderboard",
)
def run_board(
    cards: Annotated[
        Sequence[Path],
        Option("cards: their folders, their files, or folders of several cards", "CARDS"),
    ],
    *,
    out: Annotated[
        Path | None, Option("folder for leaderboard.html and leaderboard.md", "DIR")
    ] = None,
) -> None:
    """Rank score cards of one protocol, and write the page that shows them."""
    from pcs_racing_agents.base.tables import aligned, markdown
    from pcs_racing_agents.benchmark.card import board_page, board_rows, read_cards

    ranked = read_cards(cards)
    rows = board_rows(ranked)
    print("\n".join(aligned(rows)))
    if out is not None:
        folder = output_folder(out)
        for name, text in (
            ("leaderboard.md", "\n".join(markdown(rows)) + "\n"),
            ("leaderboard.html", board_page(ranked)),
        ):
            write_atomically(folder / name, text)
            print(f"written: {folder / name}")
