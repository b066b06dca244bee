"""``pcs-racing benchmark`` and ``pcs-racing leaderboard``: score cards of agents by a fixed protocol, and a ranking."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.cli.options import Commands, add_command, output_folder
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from pcs_racing_agents.agents.agent import Competitor
    from pcs_racing_agents.benchmark.protocol import Protocol
    from pcs_racing_agents.benchmark.scoring import CellRaces
    from pcs_racing_agents.jobs.jobs import Job


WATCHED = 3
REPLY_RACES = 4000
LEARNER = "best-reply"  # settings of the learner of best replies


def add(commands: Commands) -> None:
    """Add both commands."""
    parser = add_command(
        commands,
        "benchmark",
        "race an agent by the fixed protocol of the benchmark, and write its score card",
        "pcs-racing benchmark best-fixed --out out/cards/best-fixed",
        "pcs-racing benchmark my_model.zip --out out/cards/mine",
        "pcs-racing benchmark my_package.my_module:make_agent --weights net.pt --out out/cards/mine",
        "pcs-racing benchmark ppo-drive --drive --out out/cards/ppo-drive",
        "pcs-racing benchmark best-fixed robust self-play --out out/cards/zoo",
    )
    parser.add_argument(
        "agents",
        metavar="AGENT",
        nargs="+",
        help="a name of the zoo, module:function (called with the setting of the game, and the path of the weights if "
        "there is one), or a .zip file of Stable-Baselines3; of several each gets a card in a folder of its own, and "
        "the blind strategies are raced only once",
    )
    parser.add_argument("--drive", action="store_true", help="AGENT is a driver at control level: its name or folder")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="file that is handed to module:function")
    parser.add_argument("--name", help="name on the card (default: that of the agent)")
    parser.add_argument("--protocol", default="bench_v1", help="protocol: its name or a YAML file (default: bench_v1)")
    parser.add_argument(
        "--full", action="store_true", help="also train a best reply to the agent and measure the loss to it (minutes)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the card; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)
    board = add_command(
        commands,
        "leaderboard",
        "rank score cards of one protocol, and write the page that shows them",
        "pcs-racing leaderboard out/cards/mine out/cards/zoo --out out/leaderboard",
    )
    board.add_argument(
        "cards", type=Path, nargs="+", metavar="FOLDER", help="folders of cards, or folders that hold such folders"
    )
    board.add_argument("--out", type=Path, metavar="DIR", help="folder for leaderboard.html and leaderboard.md")
    board.set_defaults(run=run_board)


def run(arguments: argparse.Namespace) -> None:
    """Race agents, print their cards and write them."""
    from pcs_racing.game.competitor import competitor_name
    from pcs_racing_agents.agents.agent import competitor_hash
    from pcs_racing_agents.benchmark.entrants import load_entrant
    from pcs_racing_agents.benchmark.protocol import load_protocol
    from pcs_racing_agents.benchmark.scoring import play_protocol
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds, response_seconds, shared_seconds
    from pcs_racing_agents.learning.responses.learner import load_response_settings

    texts, alone = arguments.agents, len(arguments.agents) == 1
    if not alone and (arguments.weights is not None or arguments.name is not None):
        raise InputError(f"--weights and --name go with one agent; here are {len(texts)}")
    if arguments.weights is not None and ":" not in texts[0]:
        raise InputError("--weights goes with module:function")
    protocol = load_protocol(arguments.protocol)
    agents = [
        load_entrant(text, protocol.setting, drive=arguments.drive, weights=arguments.weights, name=arguments.name)
        for text in texts
    ]
    digests = [competitor_hash(agent) for agent in agents]
    config = protocol.config
    arms = len({*map(competitor_name, agents), *config.blind})
    races = len(list(protocol.cells)) * arms * 2 * config.egos * config.variants
    rules = protocol.setting.config
    seconds = shared_seconds(races, rules.horizon)
    if arguments.full:
        learner, circuits = load_response_settings(LEARNER), len(config.seen)
        learning = response_seconds(learner, rules, len(protocol.setting.moves), circuits)
        seconds += len(agents) * (learning + racing_seconds(REPLY_RACES, rules.horizon))
    settings = {"protocol": protocol.content_hash, "agents": digests}
    with executor_from(arguments) as executor:
        announce(seconds, cores_of(arguments))
        with open_job(arguments.out, "benchmark", settings) as job:
            results = play_protocol(protocol, agents, job=job, executor=executor, progress=show_progress("races"))
            for i, (agent, digest) in enumerate(zip(agents, digests, strict=True)):
                part = "" if alone else f"agent-{i}-"
                reply = _best_reply(protocol, agent, job, part, executor) if arguments.full else None
                folder = re.sub(r"[^\w.+-]", "_", competitor_name(agent))
                own_folder = arguments.out if alone else output_folder(arguments.out / folder)
                _write(protocol, agent, digest, results, reply, own_folder)


def _write(
    protocol: "Protocol",
    agent: "Competitor",
    digest: str,
    results: "dict[str, list[CellRaces]]",
    reply: dict[str, float | int | str] | None,
    folder: Path,
) -> None:
    """Print the card of one agent and write it."""
    from pcs_racing.game.competitor import competitor_name
    from pcs_racing_agents.benchmark.card import Card, fact_lines, summary_rows, write_card
    from pcs_racing_agents.benchmark.scoring import decision_cost, gain, rating, summarise, telling_races
    from pcs_racing_agents.results.text_table import aligned

    name, config = competitor_name(agent), protocol.config
    own = results[name]
    raced = {name: own, **{blind: results[blind] for blind in config.blind}}
    circuits = {"seen": True, "unseen": False, "all": None}
    found = {} if name in config.blind else {key: gain(raced, name, seen) for key, seen in circuits.items()}
    gains = {key: value for key, value in found.items() if value is not None}
    # A driver that starts from other lines than the blind strategies has no races to compare with theirs.
    other = next((cells for blind, cells in raced.items() if blind != name), own) if gains or not found else own
    card = Card(
        protocol=config.name,
        protocol_sha256=protocol.content_hash,
        agent=name,
        agent_sha256=digest,
        scores=tuple(summarise(own)),
        gains=gains,
        rating=rating(protocol, own),
        cost_us=decision_cost(protocol, agent),
        best_reply=reply,
    )
    print(f"\n{name}")
    print("\n".join(aligned(summary_rows(card))))
    print("\n".join(fact_lines(card)))
    for path in write_card(card, folder, telling_races(own, other, WATCHED)):
        print(f"written: {path}")


def _best_reply(
    protocol: "Protocol", agent: "Competitor", job: "Job", part: str, executor: "Executor | None"
) -> dict[str, float | int | str]:
    """Train a best reply to the agent on the circuits that may be trained on, and return what it wins there."""
    from pcs_racing_agents.learning.responses.best_reply import best_reply
    from pcs_racing_agents.learning.responses.learner import load_response_settings

    settings = load_response_settings(LEARNER)
    reply = best_reply(
        [protocol.game(name) for name in protocol.config.seen],
        agent,
        protocol.setting,
        settings,
        job,
        races=REPLY_RACES,
        part=part,
        executor=executor,
        progress=show_progress("best reply"),
    )
    loss = reply.loss
    budget = {"starts": settings.starts, "rounds": settings.rounds}
    return {"loss": loss.mean, "low": loss.low, "high": loss.high, **budget, "races": loss.units}


def run_board(arguments: argparse.Namespace) -> None:
    """Rank cards."""
    from pcs_racing_agents.benchmark.card import board_page, board_rows, read_cards
    from pcs_racing_agents.results.text_table import aligned, markdown

    cards = read_cards(arguments.cards)
    rows = board_rows(cards)
    print("\n".join(aligned(rows)))
    if arguments.out is not None:
        folder = output_folder(arguments.out)
        for name, text in (
            ("leaderboard.md", "\n".join(markdown(rows)) + "\n"),
            ("leaderboard.html", board_page(cards)),
        ):
            write_atomically(folder / name, lambda file, text=text: file.write(text.encode()))  # type: ignore[misc]
            print(f"written: {folder / name}")
