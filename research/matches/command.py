"""``python -m research match``: what remembering the opponent is worth in a series of races against it."""

import argparse
from pathlib import Path

from pcs_racing.game.archive_files import load_archive
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import TRACK_HELP, Commands, add_command, add_rules, add_tracks, rules
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress


def add(commands: Commands) -> None:
    """Add the experiment."""
    parser = add_command(
        commands,
        "match",
        "learn how an archive's policies behave and what beats them, and play matches with and without that memory",
        "python -m research match --race contest --track Pipkin Saltmere --unseen Tarnfjord --out out/match",
    )
    add_tracks(parser)
    parser.add_argument(
        "--unseen", nargs="+", default=[], metavar="T", help=f"circuits that are not learned on: {TRACK_HELP}"
    )
    parser.add_argument("--archive", default="contest", help="archive: its name or folder (default: contest)")
    add_rules(parser)
    parser.add_argument("--races", type=int, default=3, metavar="R", help="races of a match (default: 3)")
    parser.add_argument(
        "--matches",
        type=int,
        default=32,
        metavar="N",
        help="matches of each player against each policy on each track, even (default: 32)",
    )
    parser.add_argument(
        "--learning-races",
        type=int,
        default=64,
        metavar="N",
        help="races of each two policies on each track that is learned on, even (default: 64)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for matches.csv and the table of behaviours; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Learn, play, print the table and write the files."""
    from pcs_racing_agents.agents.setting import make_setting
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
    from pcs_racing_agents.tournament.play import game_rules
    from research.matches.behaviours import save_behaviours
    from research.matches.gain import ARMS, MatchTest, gain_text, match_gains, write_gains
    from research.matches.learning import LearningRaces, learn_behaviours

    setting = make_setting(load_archive(arguments.archive), game_rules(rules(arguments)))
    learned = tuple(load_track(name) for name in arguments.track)
    tracks = (*learned, *(load_track(name) for name in arguments.unseen))
    learning = LearningRaces(setting, learned, arguments.learning_races, arguments.seed)
    MatchTest.check(tracks, arguments.races, arguments.matches, arguments.seed)
    policies = len(setting.archive)
    races = len(learning.pairs) * learning.races * len(learned)
    races += len(ARMS) * policies * arguments.matches * arguments.races * len(tracks)
    settings = {
        "archive_sha256": setting.archive.content_hash,
        "game": setting.config,
        "learned": [track.content_hash for track in learned],
        "tracks": [track.content_hash for track in tracks],
        "races": arguments.races,
        "matches": arguments.matches,
        "learning_races": arguments.learning_races,
        "seed": arguments.seed,
    }
    with executor_from(arguments) as executor:
        announce(racing_seconds(races, setting.config.horizon), cores_of(arguments))
        with open_job(arguments.out, "match", settings) as job:
            table = learn_behaviours(learning, job=job, executor=executor, progress=show_progress("blocks"))
            test = MatchTest(setting, table, tracks, arguments.races, arguments.matches, arguments.seed)
            gains = match_gains(test, job=job, executor=executor, progress=show_progress("opponents"))
            print(f"the best fixed policy is {table.opponents[table.best_fixed]}")
            print(gain_text(gains))
            print(f"written: {save_behaviours(table, arguments.out / 'behaviours')}")
            print(f"written: {write_gains(gains, table.opponents, arguments.out / 'matches.csv')}")
