"""``python -m research robust-curve``: gain against a pool over what is lost to a best reply."""

import argparse
from pathlib import Path

from pcs_racing.base.checks import check_whole
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.cli.learn import add_pool, games_of, pool_of, run_identity
from pcs_racing_agents.cli.options import Commands, add_command, add_rules, add_tracks, can_draw
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress

SHARES = (0.0, 0.5, 0.75, 0.9, 1.0)


def add(commands: Commands) -> None:
    """Add the experiment ``robust-curve``."""
    parser = add_command(
        commands,
        "robust-curve",
        "train robust responses for several shares of a pool, and print what each gains and loses",
        "python -m research robust-curve --track Brackwater --archive contest --race contest --out out/curve",
        "python -m research robust-curve --track Pipkin --shares 0.5 1 --baseline best-fixed --race contest "
        "--archive contest --out out/two",
    )
    add_tracks(parser)
    parser.add_argument(
        "--archive", default="default", help="archive whose policies the agents drive (default: default)"
    )
    add_pool(parser)
    parser.add_argument(
        "--shares",
        nargs="+",
        type=float,
        default=list(SHARES),
        metavar="P",
        help=f"shares of the training games against the pool (default: {' '.join(f'{share:g}' for share in SHARES)})",
    )
    parser.add_argument(
        "--baseline", default="never-switch", metavar="AGENT", help="agent to gain over (default: never-switch)"
    )
    add_rules(parser)
    for option, kind, default in (("--config", "robust", "default"), ("--reply", "response", "best-reply")):
        what = "the robust responses" if option == "--config" else "the best replies"
        known = ", ".join(shipped_configs(kind)) or "none shipped"
        parser.add_argument(
            option, metavar="NAME", default=default, help=f"settings of {what}: {known}, or a YAML file"
        )
    parser.add_argument(
        "--races",
        type=int,
        default=4000,
        metavar="N",
        help="races against each opponent of the pool and each best reply, on all circuits together (default: 4000)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for curve.csv, curve.png and the networks; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Train and measure, print the table, and write files and the picture."""
    from pcs_racing_agents.agents.zoo import parse_agent
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds, response_seconds, robust_seconds
    from pcs_racing_agents.learning.responses.best_reply import FEWEST
    from pcs_racing_agents.learning.responses.learner import load_response_settings
    from pcs_racing_agents.learning.robust import load_robust_settings
    from pcs_racing_agents.networks import save_network_set
    from pcs_racing_agents.pictures.style import save_picture
    from research.robust_curve.curve import check_shares, curve_picture, curve_text, robust_curve, write_curve

    settings = load_robust_settings(arguments.config, seed=arguments.seed)
    reply = load_response_settings(arguments.reply, seed=arguments.seed)
    setting, games = games_of(arguments)
    pool = pool_of(arguments, setting)
    baseline = parse_agent(arguments.baseline, setting, seed=arguments.seed)
    check_whole("races", arguments.races, FEWEST * len(games))
    shares = check_shares(arguments.shares)
    identity = {
        **run_identity(games, setting, [*pool, baseline]),
        "races": arguments.races,
        "settings": plain_settings(settings),
        "reply": plain_settings(reply),
    }
    config, moves = games[0].config, len(games[0].move_names)
    each = robust_seconds(settings, config, moves, len(games)) + response_seconds(reply, config, moves, len(games))
    races = racing_seconds(arguments.races * (len(pool) + 1), config.horizon)
    with executor_from(arguments) as executor:
        announce((each + races) * len(shares), cores_of(arguments))
        with open_job(arguments.out, "robust curve", identity) as job:
            points = robust_curve(
                games,
                pool,
                baseline,
                setting,
                settings,
                reply,
                job,
                pool_shares=shares,
                races=arguments.races,
                executor=executor,
                progress=show_progress("tasks"),
            )
            print(curve_text(points, arguments.baseline))
            print(f"written: {write_curve(points, arguments.out / 'curve.csv')}")
            for point in points:
                save_network_set(point.networks, arguments.out / f"p-{point.pool_share:g}")
            if can_draw("the curve"):
                figure = curve_picture(points, arguments.baseline)
                print(f"picture: {save_picture(figure, arguments.out / 'curve.png')}")
