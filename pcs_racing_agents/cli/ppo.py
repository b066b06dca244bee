"""``pcs-racing ppo``: train a baseline by PPO, at the strategy level or at the control level."""

import argparse
from importlib.util import find_spec
from pathlib import Path

from pcs_racing_agents.cli.options import Commands, add_command
from pcs_racing_agents.jobs.configuration import shipped_configs


def add(commands: Commands) -> None:
    """Add the command ``ppo``."""
    parser = add_command(
        commands,
        "ppo",
        "train a baseline by PPO at the strategy or control level, or resume such a training",
        "pcs-racing ppo --config duel-paper --out out/ppo",
        "pcs-racing ppo --config drive --steps 2000000 --seeds 0 1 2 --executor processes --out out/ppo-drive",
    )
    configs = ", ".join(shipped_configs("ppo"))
    parser.add_argument("--config", required=True, metavar="NAME", help=f"settings: {configs} or a YAML file")
    parser.add_argument("--steps", type=int, metavar="N", help="maximum number of environment steps for each seed")
    parser.add_argument(
        "--seeds",
        type=int,
        nargs="+",
        metavar="N",
        help="seeds; one policy is trained with each seed, and the best is kept",
    )
    parser.add_argument(
        "--name", help="name of the policy (default: the name under which the agent 'ppo' looks for it)"
    )
    parser.add_argument("--tensorboard", action="store_true", help="also write the learning curves for TensorBoard")
    parser.add_argument("--no-picture", action="store_true", help="do not draw the learning curves")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for weights and learning curves; a stopped training keeps its finished seeds there",
    )
    from pcs_racing_agents.jobs.executors import add_executor_options

    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Train the policy, and print its evaluation."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, ppo_seconds
    from pcs_racing_agents.jobs.executors import executor_from
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.learning.ppo.evaluation import evaluation_curves, mean_score, score_table
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.learning.ppo.train import train_ppo
    from pcs_racing_agents.pictures.curves import curves_picture, write_tensorboard
    from pcs_racing_agents.pictures.style import save_picture

    changes = {"steps": arguments.steps, "seeds": arguments.seeds and tuple(arguments.seeds)}
    settings = load_ppo_settings(
        arguments.config, **{key: value for key, value in changes.items() if value is not None}
    )
    for package, needed in (("tensorboard", arguments.tensorboard), ("matplotlib", not arguments.no_picture)):
        if needed and find_spec(package) is None:
            extra = "plots" if package == "matplotlib" else "learning"
            raise ModuleNotFoundError(f'the curves need {package}: pip install "pcs-racing[{extra}]"')
    # torch learns on one core of a process, so only other processes learn from several seeds side by side.
    side_by_side = arguments.executor in ("processes", "dask")
    cores = cores_of(arguments)
    if cores is not None:
        cores = min(cores, len(settings.seeds)) if side_by_side else 1
    with executor_from(arguments) as executor:
        announce(ppo_seconds(settings), cores, most=settings.patience > 0)
        trained = train_ppo(
            settings,
            arguments.out,
            name=arguments.name,
            executor=executor,
            progress=show_progress("steps"),
        )
    opponents = settings.opponents
    if arguments.tensorboard:
        runs = {
            f"seed-{curve.seed}": [
                (steps, {f"evaluation/{key}": value for key, value in mean_score(scores, opponents)._asdict().items()})
                for steps, scores in zip(curve.steps, curve.scores, strict=True)
            ]
            for curve in trained.curves
        }
        write_tensorboard(arguments.out / "tensorboard", runs)
    if not arguments.no_picture:
        panels = evaluation_curves(trained.curves, opponents)
        x_label, title = f"million {trained.task.unit}", f"PPO: {trained.task.default_name}"
        save_picture(curves_picture(panels, x_label=x_label, title=title), arguments.out / "curve.png")
    steps = ", ".join(f"{curve.steps[-1]} with seed {curve.seed}" for curve in trained.curves)
    print(
        f"{steps}: {trained.seconds:.0f} s of training; kept is seed {trained.seed} after {trained.steps} "
        f"{trained.task.unit}\n\n{score_table(trained.scores, opponents)}\n\npolicy: {trained.folder}"
    )
