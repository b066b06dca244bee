"""``pcs-racing best-reply``: how much an agent loses to an opponent that was trained against it alone."""

import argparse
from pathlib import Path

from pcs_racing.base.checks import check_whole
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.make import make_game
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import Commands, add_command, add_rules, add_tracks, rules
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress


def add(commands: Commands) -> None:
    """Add the command ``best-reply``."""
    parser = add_command(
        commands,
        "best-reply",
        "train an opponent against one agent alone, and print what the agent loses to it in fresh races",
        "pcs-racing best-reply response --track Pipkin --archive contest --race contest --out out/reply",
        "pcs-racing best-reply lane-switcher --track Pipkin Saltmere --race contest --starts 512 --out out/quick",
    )
    parser.add_argument("agent", help="name of an agent or driver, or name:option=value,... (see 'pcs-racing agents')")
    add_tracks(parser)
    parser.add_argument(
        "--archive", default="default", help="archive whose policies the agents drive (default: default)"
    )
    add_rules(parser)
    configs = ", ".join(shipped_configs("response"))
    parser.add_argument(
        "--config",
        metavar="NAME",
        default="best-reply",
        help=f"settings of the learner: {configs} or a YAML file (default: best-reply)",
    )
    parser.add_argument(
        "--starts", type=int, metavar="N", help="the learner's budget: games branched at every step, on each circuit"
    )
    parser.add_argument(
        "--races", type=int, default=4000, metavar="N", help="fresh races on all circuits together (default: 4000)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for best_reply.csv, results.csv and the opponent's network; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Train the opponent, race it, print the loss, and write the files."""
    from pcs_racing_agents.agents.agent import competitor_hash
    from pcs_racing_agents.agents.setting import make_setting
    from pcs_racing_agents.agents.zoo import parse_agent
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds, response_seconds
    from pcs_racing_agents.learning.responses.best_reply import FEWEST, best_reply, reply_text, write_replies
    from pcs_racing_agents.learning.responses.learner import load_response_settings
    from pcs_racing_agents.networks.network_files import save_network
    from pcs_racing_agents.results.race_files import write_results
    from pcs_racing_agents.tournament.play import game_rules

    changes = {"seed": arguments.seed}
    if arguments.starts is not None:
        changes["starts"] = arguments.starts
    settings = load_response_settings(arguments.config, **changes)
    setting = make_setting(arguments.archive, game_rules(rules(arguments)))
    agent = parse_agent(arguments.agent, setting, seed=arguments.seed)
    games = [make_game(load_track(name), setting.archive, setting.config) for name in arguments.track]
    check_whole("races", arguments.races, FEWEST * len(games))
    identity = {
        "agent": competitor_hash(agent),
        "archive": setting.archive.content_hash,
        "rules": repr(setting.config),
        "tracks": [game.track.content_hash for game in games],
        "races": arguments.races,
        "learner": plain_settings(settings),
    }
    learning = response_seconds(settings, setting.config, len(setting.moves), len(games))
    with executor_from(arguments) as executor:
        announce(learning + racing_seconds(arguments.races, setting.config.horizon), cores_of(arguments))
        with open_job(arguments.out, "best reply", identity) as job:
            reply = best_reply(
                games,
                agent,
                setting,
                settings,
                job,
                races=arguments.races,
                executor=executor,
                progress=show_progress("tasks"),
            )
            print(reply_text({arguments.agent: reply}, settings))
            write_results(reply.races, arguments.out / "results.csv")
            print(f"written: {write_replies({arguments.agent: reply}, arguments.out / 'best_reply.csv')}")
            print(f"network: {save_network(reply.network, arguments.out / 'reply')}")
