"""``pcs-racing explain``: explain the moves of an agent in one race, or summarise them over many races."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    TRACK_HELP,
    Commands,
    add_command,
    add_rules,
    can_draw,
    output_folder,
    rules,
)

if TYPE_CHECKING:
    from pcs_racing_agents.tournament.pairings import Pairing


def add(commands: Commands) -> None:
    """Add the command ``explain``."""
    parser = add_command(
        commands,
        "explain",
        "explain the moves of an agent in a race: its observations, its moves and their effect",
        "pcs-racing explain --agents cfr-argmax never-switch",
        "pcs-racing explain out/mine 12",
        "pcs-racing explain out/mine 12 --car 1 --out out/race-12",
        "pcs-racing explain --agents random-moves lane-switcher --track Tarnfjord --seed 3 --out out/race",
        "pcs-racing explain out/mine --situations cfr-argmax --out out/cfr",
    )
    parser.add_argument("results", nargs="?", type=Path, metavar="RACE", help="folder of a tournament or a study")
    parser.add_argument(
        "number",
        nargs="?",
        type=int,
        metavar="N",
        help="line of its results, counted from 0 (default: 0)",
        default=None,
    )
    parser.add_argument("--agents", nargs=2, metavar="AGENT", help="instead of a folder: the agents of car 0 and car 1")
    parser.add_argument("--track", metavar="T", help=f"with --agents: {TRACK_HELP} (default: {DEFAULT_TRACK})")
    add_rules(parser)
    parser.add_argument(
        "--archive", default="default", help="archive whose policies the agents drive (default: default)"
    )
    parser.add_argument(
        "--races", type=int, metavar="N", help="with --agents: number of planned races, even (default: 20)"
    )
    parser.add_argument(
        "--index", type=int, metavar="K", help="with --agents: number of the race to explain (default: 0)"
    )
    parser.add_argument(
        "--car", type=int, choices=(0, 1), help="car whose moves are explained (default: the first that makes moves)"
    )
    parser.add_argument(
        "--situations",
        metavar="AGENT",
        help="instead of one race: summarise the moves of this agent by situation, over all its races",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the pictures, the text and the replay")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Print the explanation; with ``--out``, also write it with its pictures."""
    _check(arguments)
    if arguments.situations is not None:
        _situations(arguments)
    else:
        _race(arguments)


def _check(arguments: argparse.Namespace) -> None:
    """Refuse options that can't be combined, before any race is simulated."""
    if (arguments.results is None) == (arguments.agents is None):
        raise InputError("give a folder of results, or two agents with --agents; one of the two")
    if arguments.results is not None:
        for option in ("track", "duration", "races", "index"):
            if getattr(arguments, option) is not None:
                raise InputError(f"--{option} goes with --agents; the races of a folder have their own")
    if arguments.situations is not None and (arguments.number is not None or arguments.index is not None):
        raise InputError("--situations is about all races; leave out the number of one")
    if arguments.out is not None:
        output_folder(arguments.out)


def _planned(arguments: argparse.Namespace) -> "Pairing":
    """Return the races of a tournament between the two agents of the options."""
    from pcs_racing.track.loading import load_track
    from pcs_racing_agents.tournament import plan_tournament

    plan = plan_tournament(
        load_track(DEFAULT_TRACK if arguments.track is None else arguments.track),
        arguments.agents,
        rules(arguments),
        archive=arguments.archive,
        races_per_pair=20 if arguments.races is None else arguments.races,
        seed=arguments.seed,
    )
    return plan.pairings[0]


def _race(arguments: argparse.Namespace) -> None:
    from pcs_racing_agents.agents.agent import Driver
    from pcs_racing_agents.explain.explain import explain_game
    from pcs_racing_agents.explain.words import story
    from pcs_racing_agents.view.results_folder import open_results

    results, number = None, arguments.number or 0
    if arguments.results is not None:
        results = open_results(arguments.results)
        row = results.row(number)
        pairing, race = results.pairing(row), row.race
    else:
        pairing, race = _planned(arguments), arguments.index or 0
        if not 0 <= race < len(pairing):
            raise InputError(f"--index is {race}; there are races 0 to {len(pairing) - 1}")
    car = arguments.car
    if car is None:
        car = int(isinstance(pairing.ego, Driver))
    explanation = explain_game(
        pairing.game,
        pairing.ego,
        pairing.opponent,
        **pairing.race_arguments(race),
        car=car,
        candidates=arguments.out is not None,
    )
    if results is not None:
        results.check_lead(number, explanation.played.lead[0])
    text = story(explanation)
    print(text)
    if arguments.out is not None:
        from pcs_racing.base.files import write_atomically
        from pcs_racing.race.replay_files import save_replay

        write_atomically(arguments.out / "race.txt", lambda file: file.write(f"{text}\n".encode()))
        print(f"to watch: {save_replay(explanation.replay, arguments.out / 'race.html')}")
        if can_draw("the picture of the race"):
            from pcs_racing_agents.explain.pictures import explanation_picture
            from pcs_racing_agents.pictures.style import save_picture

            print(f"picture: {save_picture(explanation_picture(explanation), arguments.out / 'race.png')}")


def _situations(arguments: argparse.Namespace) -> None:
    import numpy as np

    from pcs_racing.race.driving import default_threads
    from pcs_racing_agents.cli.estimates import announce, racing_seconds
    from pcs_racing_agents.explain.situations import situations_text, summarise, write_situations
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.tournament.games import game_between
    from pcs_racing_agents.tournament.runner import play_pairings
    from pcs_racing_agents.view.results_folder import open_results

    agent = arguments.situations
    if arguments.results is not None:
        pairings = list(open_results(arguments.results).pairings(agent))
    else:
        if agent not in arguments.agents:
            raise InputError(f"--situations is {agent!r}; it must be one of {', '.join(arguments.agents)}")
        pairings = [(_planned(arguments), arguments.agents.index(agent))]
    total, first = sum(len(pairing) for pairing, _ in pairings), pairings[0][0]
    announce(racing_seconds(total, first.game.config.horizon), default_threads())
    played = play_pairings(
        [pairing for pairing, _ in pairings], name=agent, observations=True, progress=show_progress()
    )
    observations, actions = [], []
    for (_, car), games in zip(pairings, played, strict=True):
        observations.append(games.observations[:, car])
        actions.append(games.moves.codes[:, car])
    arena = game_between(first.game, first.ego, first.opponent)
    situations = summarise(
        np.concatenate(observations), np.concatenate(actions), arena.archive, arena.move_names, agent
    )
    if arguments.results is None:
        print(f"{first.game.track.name}, {first.game.config.race.name} rules, {total} races")
    print(situations_text(situations))
    if arguments.out is not None:
        print(f"table: {write_situations(situations, arguments.out / 'situations.csv')}")
        if can_draw("the picture of the situations"):
            from pcs_racing_agents.explain.situations import situations_picture
            from pcs_racing_agents.pictures.style import save_picture

            print(f"picture: {save_picture(situations_picture(situations), arguments.out / 'situations.png')}")
