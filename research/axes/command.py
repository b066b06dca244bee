"""``python -m research axes``: learn characteristics from races, show them, and put an archive on their axes."""

import argparse
from dataclasses import replace
from pathlib import Path

from pcs_racing.base.checks import check_names, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import add_setting_options, stated_options
from pcs_racing.game.archive_files import load_archive, save_archive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.learned import load_learned, save_learned
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.cli.options import POLICY_HELP, Commands, add_command, add_rules, add_tracks, can_draw, rules
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.payoffs.policy_pool import PolicyPool, spanning_policies
from research.axes.apply import ApplySettings, apply_characteristics
from research.axes.learn import LearnSettings, learn_characteristics
from research.axes.pools import CANDIDATE_RACES, CANDIDATES, draw_pool
from research.axes.report import learned_text, learning_text, write_weights

FILE = "characteristics.yaml"
_LEARN_OPTIONS = ("name", "inputs", "degree", "segments", "opponents", "starts", "folds")


def add(commands: Commands) -> None:
    """Add the group ``axes`` and its commands."""
    group = add_command(
        commands,
        "axes",
        "learn characteristics from races, show them, and put an archive on their axes",
        "python -m research axes learn --track Brackwater Pipkin --race contest --out out/learned",
        "python -m research axes apply --archive contest --learned out/learned/characteristics.yaml --out out/mine",
    )
    actions: Commands = group.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_learn(actions)
    _add_show(actions)
    _add_apply(actions)


def _add_learn(actions: Commands) -> None:
    parser = add_command(
        actions,
        "learn",
        "race all pairs of a pool, and learn axes that tell rating and cyclic plane from 8 s of driving",
        "python -m research axes learn --track Brackwater Pipkin --race contest --out out/learned",
        "python -m research axes learn --archive contest --size 24 --race contest --out out/mine",
    )
    add_tracks(parser)
    parser.add_argument("--planner", default="lattice", help="planner of a pool that is drawn (default: lattice)")
    parser.add_argument(
        "--size",
        type=int,
        default=24,
        metavar="N",
        help=f"policies of the pool; drawn at random, the best of {CANDIDATES} times as many, evenly spaced in speed, "
        "or taken from the archive (default: 24)",
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--archive", help="archive whose policies are the pool instead: its name or folder")
    source.add_argument("--policies", nargs="+", metavar="POLICY", help=f"a pool of your own instead: {POLICY_HELP}")
    add_rules(parser)
    parser.add_argument(
        "--races", type=int, default=32, metavar="N", help="races of each pair on each track (default: 32)"
    )
    add_setting_options(parser, LearnSettings, *_LEARN_OPTIONS)
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help=f"folder for {FILE}, weights.csv and a picture; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run_learn)


def run_learn(arguments: argparse.Namespace) -> None:
    """Draw or load the pool, race it, print what was learned, and write the files."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
    from pcs_racing_agents.pictures.style import save_picture

    settings = replace(LearnSettings(), **stated_options(arguments, LearnSettings))
    tracks = tuple(load_track(name) for name in arguments.track)
    config = rules(arguments)
    given: tuple[Policy, ...] | None = None
    if arguments.policies:
        given = tuple(parse_policy(text) for text in arguments.policies)
    elif arguments.archive:
        given = spanning_policies(load_archive(arguments.archive), arguments.size)[1]
    planner = get_planner(arguments.planner)
    size = len(given) if given is not None else check_whole("size", arguments.size, 3, 1000)
    # Checked before anything is raced, with stand-ins for policies that are yet to be drawn.
    pool = PolicyPool(given or (planner.policy(),) * size, tracks, config, races=arguments.races, seed=arguments.seed)
    if size < settings.folds:
        raise InputError(f"the pool holds {size} policies; {settings.folds} folds need as many")
    stated = {
        "tracks": [track.content_hash for track in tracks],
        "pool": [[policy.planner.name, *policy.parameters.tolist()] for policy in given]
        if given
        else [planner.name, size],
        "race": repr(config),
        "races": pool.races,
        "folds": pool.folds,
        "seed": pool.seed,
        "settings": repr(settings),
    }
    races = len(pool.pairs) * pool.races + 2 * size * settings.opponents * settings.starts
    if given is None:
        races += size * CANDIDATES * CANDIDATE_RACES
    with executor_from(arguments) as executor:
        announce(racing_seconds(len(tracks) * races, config.duration), cores_of(arguments))
        with open_job(arguments.out, "characteristics", stated) as job:
            if given is None:
                drawn = draw_pool(
                    planner,
                    tracks,
                    config,
                    size,
                    seed=arguments.seed,
                    segment_seconds=settings.segment_seconds,
                    job=job,
                    executor=executor,
                    progress=show_progress("blocks"),
                )
                pool = replace(pool, policies=drawn)
            learning = learn_characteristics(
                pool, settings, job=job, executor=executor, progress=show_progress("blocks")
            )
            print(learning_text(learning))
            print(f"written: {save_learned(learning.characteristics, arguments.out / FILE)}")
            print(f"written: {write_weights(learning.characteristics, arguments.out / 'weights.csv')}")
            if can_draw("what was learned"):
                from research.axes.report import learning_picture

                print(f"picture: {save_picture(learning_picture(learning), arguments.out / 'characteristics.png')}")


def _add_show(actions: Commands) -> None:
    parser = add_command(
        actions,
        "show",
        "print what learned characteristics are made of",
        "python -m research axes show out/learned/characteristics.yaml",
    )
    parser.add_argument("learned", metavar="FILE", help="learned characteristics, or an archive that brings them")
    parser.set_defaults(run=run_show)


def run_show(arguments: argparse.Namespace) -> None:
    """Print the axes of a set."""
    if Path(arguments.learned).is_dir():
        archive = load_archive(arguments.learned)
        if archive.learned is None:
            raise InputError(f"archive {archive.name!r} brings no learned characteristics")
        learned = archive.learned
    else:
        learned = load_learned(arguments.learned)
    print(learned_text(learned))


def _add_apply(actions: Commands) -> None:
    parser = add_command(
        actions,
        "apply",
        "measure the policies of an archive on learned axes, and write it as an archive of its own",
        "python -m research axes apply --archive contest --learned out/learned/characteristics.yaml "
        "--track Brackwater Pipkin --out out/contest-learned",
        "python -m research axes apply --archive contest --axes speed restraint --out out/contest-speed",
    )
    add_tracks(parser)
    parser.add_argument("--archive", default="contest", help="archive: its name or folder (default: contest)")
    parser.add_argument("--learned", type=Path, metavar="FILE", help="learned characteristics")
    parser.add_argument(
        "--axes", nargs="+", metavar="NAME", help="axes of the new archive, learned or not (default: all learned ones)"
    )
    parser.add_argument("--name", help="name of the new archive (default: that of its folder)")
    parser.add_argument("--race", help="rules of the races (default: the archive's)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of starts and noise (default: 0)")
    add_setting_options(parser, ApplySettings, "opponents", "starts", "explored_opponents")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the new archive")
    add_executor_options(parser)
    parser.set_defaults(run=run_apply)


def run_apply(arguments: argparse.Namespace) -> None:
    """Measure an archive on other axes, and write it."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds

    settings = replace(ApplySettings(), **stated_options(arguments, ApplySettings))
    archive = load_archive(arguments.archive)
    learned = None if arguments.learned is None else load_learned(arguments.learned)
    if learned is None and not arguments.axes:
        raise InputError("there is nothing to change; give --learned, --axes or both")
    tracks: tuple[Track, ...] = tuple(load_track(name) for name in arguments.track)
    config = load_race_config(arguments.race or archive.preset)
    axes = check_names("axes", arguments.axes or list(learned.names if learned is not None else ()))
    get_characteristics(axes)
    stated = {
        "tracks": [track.content_hash for track in tracks],
        "archive": archive.content_hash,
        "learned": None if learned is None else learned.content_hash,
        "axes": list(axes),
        "race": repr(config),
        "settings": repr(settings),
        "seed": arguments.seed,
    }
    own = len(archive) * settings.opponents * settings.starts
    races = 2 * len(tracks) * (own + len(archive.explored_parameters) * settings.explored_opponents)
    with executor_from(arguments) as executor:
        announce(racing_seconds(races, config.duration), cores_of(arguments))
        with open_job(arguments.out / "job", "axes", stated) as job:
            made = apply_characteristics(
                archive,
                learned,
                tracks,
                config,
                axes=axes,
                name=arguments.name or arguments.out.resolve().name,
                settings=settings,
                seed=arguments.seed,
                job=job,
                executor=executor,
                progress=show_progress("blocks"),
            )
            print(f"archive: {save_archive(made, arguments.out)}")
    print(made)
    for axis, low, high in zip(made.characteristics, made.nadir, made.ideal, strict=True):
        print(f"{axis}: {low:.2f} to {high:.2f}")
