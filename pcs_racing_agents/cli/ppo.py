"""``pcs-racing ppo``: train a baseline by PPO, at the strategy level or at the control level."""

from pathlib import Path
from typing import Annotated, Any

from pcs_racing.base.errors import require
from pcs_racing_agents.cli.commands import Option, SettingOptions, command
from pcs_racing_agents.cli.options import Workers
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.learning.ppo.settings import PPOSettings


@command(
    "ppo",
    "pcs-racing ppo --config duel-paper --out out/ppo",
    "pcs-racing ppo --config drive --steps 2000000 --seeds 0 1 2 --executor processes --out out/ppo-drive",
)
def run(
    *,
    config: Annotated[str, Option(f"settings: {', '.join(shipped_configs('ppo'))} or a YAML file", "NAME")],
    changes: Annotated[dict[str, Any], SettingOptions(PPOSettings, "steps", "seeds")],
    name: Annotated[
        str | None, Option("name of the policy (default: the name under which the agent 'ppo' looks for it)")
    ] = None,
    tensorboard: Annotated[bool, Option("also write the learning curves for TensorBoard")] = False,
    no_picture: Annotated[bool, Option("do not draw the learning curves")] = False,
    out: Annotated[
        Path, Option("folder for weights and learning curves; a stopped training keeps its finished seeds there", "DIR")
    ],
    workers: Workers,
) -> None:
    """Train a baseline by PPO at the strategy or control level, or resume such a training."""
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.learning.ppo.evaluation import evaluation_curves, mean_score, score_table
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.learning.ppo.train import train_ppo
    from pcs_racing_agents.pictures.curves import curves_picture, write_tensorboard
    from pcs_racing_agents.pictures.style import save_picture

    settings = load_ppo_settings(config, **changes)
    if tensorboard:
        require("tensorboard", extra="learning")
    if not no_picture:
        require("matplotlib", extra="plots")
    with workers.start() as executor:
        trained = train_ppo(
            settings,
            out,
            name=name,
            executor=executor,
            progress=show_progress("steps"),
        )
    opponents = settings.opponents
    if tensorboard:
        runs = {
            f"seed-{curve.seed}": [
                (steps, {f"evaluation/{key}": value for key, value in mean_score(scores, opponents)._asdict().items()})
                for steps, scores in zip(curve.steps, curve.scores, strict=True)
            ]
            for curve in trained.curves
        }
        write_tensorboard(out / "tensorboard", runs)
    if not no_picture:
        panels = evaluation_curves(trained.curves, opponents)
        x_label, title = f"million {trained.task.unit}", f"PPO: {trained.task.default_name}"
        save_picture(curves_picture(panels, x_label=x_label, title=title), out / "curve.png")
    steps = ", ".join(f"{curve.steps[-1]} with seed {curve.seed}" for curve in trained.curves)
    print(
        f"{steps}: {trained.seconds:.0f} s of training; kept is seed {trained.seed} after {trained.steps} "
        f"{trained.task.unit}\n\n{score_table(trained.scores, opponents)}\n\npolicy: {trained.folder}"
    )
