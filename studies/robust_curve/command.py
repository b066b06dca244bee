"""``python -m studies robust-curve``: gain against a pool over what is lost to a best reply."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.base.checks import check_whole
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.learn import POOL, Games, Pool, run_identity
from pcs_racing_agents.cli.options import Workers, can_draw

SHARES = (0.0, 0.5, 0.75, 0.9, 1.0)


@command(
    "robust-curve",
    "python -m studies robust-curve --track Brackwater --archive contest --race contest --out out/curve",
    "python -m studies robust-curve --track Pipkin --shares 0.5 1 --baseline best-fixed --race contest "
    "--archive contest --out out/two",
)
def run(
    *,
    games: Games,
    pool: Pool = POOL,
    shares: Annotated[Sequence[float], Option("shares of the training games against the pool", "P")] = SHARES,
    baseline: Annotated[str, Option("agent to gain over", "AGENT")] = "never-switch",
    config: Annotated[
        str, Option(f"settings of the robust responses: {', '.join(shipped_configs('robust'))}, or a YAML file", "NAME")
    ] = "default",
    reply: Annotated[
        str, Option(f"settings of the best replies: {', '.join(shipped_configs('response'))}, or a YAML file", "NAME")
    ] = "best-reply",
    races: Annotated[
        int, Option("races against each opponent of the pool and each best reply, on all circuits together")
    ] = 4000,
    out: Annotated[
        Path, Option("folder for curve.csv, curve.png and the networks; a stopped run resumes there", "DIR")
    ],
    workers: Workers,
) -> None:
    """Train robust responses for several shares of a pool, and print what each gains and loses."""
    from pcs_racing_agents.base.style import save_picture
    from pcs_racing_agents.learning.responses.best_reply import FEWEST
    from pcs_racing_agents.learning.responses.learner import load_response_settings
    from pcs_racing_agents.learning.robust import load_robust_settings
    from pcs_racing_agents.networks import save_network_set
    from studies.robust_curve.curve import check_shares, curve_picture, curve_text, robust_curve, write_curve

    settings = load_robust_settings(config, seed=games.rules.seed)
    replies = load_response_settings(reply, seed=games.rules.seed)
    setting, made = games.make()
    *opponents, target = games.agents([*pool, baseline], setting)
    check_whole("races", races, FEWEST * len(made))
    shares = check_shares(shares)
    identity = {
        **run_identity(made, setting, [*opponents, target]),
        "races": races,
        "settings": plain_settings(settings),
        "reply": plain_settings(replies),
    }
    with workers.start() as executor, open_job(out, "robust curve", identity) as job:
        points = robust_curve(
            made,
            opponents,
            target,
            setting,
            settings,
            replies,
            job,
            pool_shares=shares,
            races=races,
            executor=executor,
            progress=show_progress("tasks"),
        )
        print(curve_text(points, baseline))
        print(f"written: {write_curve(points, out / 'curve.csv')}")
        for point in points:
            save_network_set(point.networks, out / f"p-{point.pool_share:g}")
        if can_draw("the curve"):
            print(f"picture: {save_picture(curve_picture(points, baseline), out / 'curve.png')}")
