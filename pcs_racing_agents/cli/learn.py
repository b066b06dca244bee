"""``pcs-racing learn``: train agents in branched races, as answers to opponents or in self-play."""

import argparse
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcs_racing.base.settings import plain_settings
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import Commands, add_command, add_rules, add_tracks, rules
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import Job, open_job
from pcs_racing_agents.jobs.progress import show_progress

if TYPE_CHECKING:
    from pcs_racing_agents.agents.agent import Competitor
    from pcs_racing_agents.agents.setting import Setting


METHODS = {
    "response": "an approximate best response to a pool of opponents",
    "robust": "a response that is hard to exploit: restricted Nash response to the pool",
    "psro": "a mixture of responses: policy-space response oracles, beginning with the pool",
    "self-play": "an average strategy of counterfactual regret minimisation; it needs no pool",
}
POOL = ("never-switch", "random-moves")
"""Opponents of a pool by default: one that keeps a policy of the archive, and one that changes it at random."""


def add(commands: Commands) -> None:
    """Add the command ``learn``."""
    parser = add_command(
        commands,
        "learn",
        "train an agent in branched races: a response to opponents, a robust one, PSRO, or CFR in self-play",
        "pcs-racing learn self-play --track Brackwater --archive contest --race contest --out out/self-play",
        "pcs-racing learn robust --track Brackwater --archive contest --race contest --out out/robust",
        "pcs-racing learn psro --track Pipkin Saltmere --pool never-switch lane-switcher --out out/psro",
    )
    meanings = "; ".join(f"{name}: {meaning}" for name, meaning in METHODS.items())
    parser.add_argument("method", choices=list(METHODS), help=meanings)
    add_tracks(parser)
    parser.add_argument(
        "--archive", default="default", help="archive whose policies the agents drive (default: default)"
    )
    add_pool(parser)
    add_rules(parser)
    configs = "; ".join(f"{name}: {', '.join(_configs(name))}" for name in METHODS)
    parser.add_argument(
        "--config", metavar="NAME", help=f"settings of the method, the first by default, or a YAML file ({configs})"
    )
    parser.add_argument("--name", help="name of the agent's networks (default: the method)")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the work, with the result in its folder 'agent'; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def add_pool(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--pool``."""
    parser.add_argument(
        "--pool",
        nargs="+",
        default=list(POOL),
        metavar="AGENT",
        help=f"opponents, by name or name:option=value,... (default: {' '.join(POOL)})",
    )


def run(arguments: argparse.Namespace) -> None:
    """Train the agent and write its networks."""
    from pcs_racing_agents.cli.estimates import announce, cores_of
    from pcs_racing_agents.networks import NetworkSet, RegretNetwork, save_network, save_network_set

    setting, games = games_of(arguments)
    name = arguments.name or arguments.method
    pool = [] if arguments.method == "self-play" else pool_of(arguments, setting)
    settings, seconds, learn = _method(arguments, setting, games, pool, name)
    identity = {**run_identity(games, setting, pool), "name": name, "settings": plain_settings(settings)}
    with executor_from(arguments) as executor:
        announce(seconds, cores_of(arguments))
        with open_job(arguments.out, arguments.method, identity) as job:
            learned = learn(job, executor)
            folder = arguments.out / "agent"
            if isinstance(learned, NetworkSet):
                save_network_set(learned, folder)
                weights = ", ".join(f"{weight:.3g}" for weight in learned.weights)
                print(f"{len(learned.networks)} networks, played with probabilities {weights}")
                option = "networks"
            else:
                assert isinstance(learned, RegretNetwork)
                save_network(learned, folder)
                print(learned)
                option = "network"
    print(f"written: {folder}; race it as {arguments.method}:{option}={folder}")


def _configs(method: str) -> list[str]:
    """Return the shipped settings of a method, those that it takes by default first."""
    first = "response" if method == "response" else "default"
    return [first, *(name for name in shipped_configs(method) if name != first)]


def games_of(arguments: argparse.Namespace) -> "tuple[Setting, list[RaceGame]]":
    """Return archive and rules that the options name, and the game on each circuit."""
    from pcs_racing_agents.agents.setting import make_setting
    from pcs_racing_agents.tournament.play import game_rules

    config = game_rules(rules(arguments))
    setting = make_setting(arguments.archive, config)
    return setting, [make_game(load_track(name), setting.archive, config) for name in arguments.track]


def pool_of(arguments: argparse.Namespace, setting: "Setting") -> "list[Competitor]":
    """Return the opponents that the option ``--pool`` names."""
    from pcs_racing_agents.agents.zoo import parse_agent

    return [parse_agent(text, setting, seed=arguments.seed) for text in arguments.pool]


def run_identity(games: "list[RaceGame]", setting: "Setting", competitors: "list[Competitor]") -> dict[str, Any]:
    """Return what identifies games and competitors in the manifest of a job."""
    from pcs_racing_agents.agents.agent import competitor_hash

    return {
        "archive": setting.archive.content_hash,
        "rules": repr(games[0].config),
        "tracks": [game.track.content_hash for game in games],
        "competitors": [competitor_hash(competitor) for competitor in competitors],
    }


def _method(
    arguments: argparse.Namespace,
    setting: "Setting",
    games: "list[RaceGame]",
    pool: "list[Competitor]",
    name: str,
) -> tuple[Any, float, Callable[[Job, Executor | None], Any]]:
    """Return the settings of a method, its processor seconds, and the function that learns."""
    from pcs_racing_agents.cli.estimates import psro_seconds, response_seconds, robust_seconds, self_play_seconds
    from pcs_racing_agents.learning.responses import learn_response, load_response_settings
    from pcs_racing_agents.learning.robust import learn_psro, learn_robust, load_psro_settings, load_robust_settings
    from pcs_racing_agents.learning.self_play import RaceArena, learn_self_play, load_self_play_settings

    source = arguments.config or _configs(arguments.method)[0]
    changes = {"seed": arguments.seed}
    config, moves, count = games[0].config, len(games[0].move_names), len(games)
    options: dict[str, Any] = {"name": name, "progress": show_progress("tasks")}
    if arguments.method == "response":
        response = load_response_settings(source, **changes)
        seconds = response_seconds(response, config, moves, count * len(pool))
        return (
            response,
            seconds,
            lambda job, on: learn_response(games, pool, setting, response, job, executor=on, **options),
        )
    if arguments.method == "robust":
        robust = load_robust_settings(source, **changes)
        seconds = robust_seconds(robust, config, moves, count)
        return robust, seconds, lambda job, on: learn_robust(games, pool, setting, robust, job, executor=on, **options)
    if arguments.method == "psro":
        psro = load_psro_settings(source, **changes)
        seconds = psro_seconds(psro, config, moves, count)
        return psro, seconds, lambda job, on: learn_psro(games, pool, setting, psro, job, executor=on, **options)
    play = load_self_play_settings(source, **changes)
    arenas = [RaceArena(game, setting, play.worth) for game in games]
    seconds = self_play_seconds(play, config, moves, count)
    return play, seconds, lambda job, on: learn_self_play(arenas, play, job, executor=on, **options)
