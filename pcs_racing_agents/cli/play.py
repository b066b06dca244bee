"""``pcs-racing play``: drive races against an agent by making the moves of one car on a page."""

import argparse

from pcs_racing.base.checks import check_seed
from pcs_racing_agents.cli.options import Commands, add_command, add_rules, add_track, rules, serve


def add(commands: Commands) -> None:
    """Add the command ``play``."""
    parser = add_command(
        commands,
        "play",
        "make the moves of one car yourself, on a local page, against an agent",
        "pcs-racing play",
        "pcs-racing play --opponent response --archive contest --race contest --track Pipkin",
        "pcs-racing play --opponent lattice:pace=0.9 --no-open",
    )
    parser.add_argument(
        "--opponent",
        default="cfr-argmax",
        metavar="NAME",
        help="agent, driver or policy in the other car (see 'pcs-racing agents'; default: cfr-argmax)",
    )
    add_track(parser)
    add_rules(parser)
    parser.add_argument("--archive", default="default", help="archive whose policies both drive (default: default)")
    parser.add_argument("--port", type=int, default=0, metavar="P", help="port of the page (default: a free port)")
    parser.add_argument("--no-open", action="store_true", help="do not open the page in a browser")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Serve the page until the command is interrupted."""
    from pcs_racing.game.archive_files import load_archive
    from pcs_racing.game.make import make_game
    from pcs_racing.track.loading import load_track
    from pcs_racing_agents.agents.zoo import make
    from pcs_racing_agents.view.person_race import PersonRaces, play_page
    from pcs_racing_agents.view.view_server import make_server

    check_seed(arguments.seed)
    config, archive = rules(arguments), load_archive(arguments.archive)
    opponent = make(arguments.opponent, archive=archive, race=config, seed=arguments.seed)
    game = make_game(load_track(arguments.track), archive, config, stay=True)
    races = PersonRaces(game, opponent, arguments.seed)
    races.situation(0, ())  # a competitor that does not fit is told now, and kernels are compiled before the page opens
    with make_server(play_page(races), races.answer, arguments.port) as server:
        serve(server, "play", open_it=not arguments.no_open)
