"""``pcs-racing train``: train a network to predict counterfactual regrets from observations."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pcs_racing.base.errors import InputError, require
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.folders import hold_folder
from pcs_racing_agents.cli.commands import ConfigOptions, Option, command
from pcs_racing_agents.cli.options import Workers, can_draw, output_folder
from pcs_racing_agents.networks.settings import TrainSettings


@command(
    "train",
    "pcs-racing train out/trees --target regret --out out/networks/regret",
    "pcs-racing train out/trees-a out/trees-b --config study --target advantage --out"
    " out/networks/advantage",
)
def run(
    trees: Annotated[
        Sequence[Path], Option("folders of game trees, written by 'pcs-racing tree'", "DIR")
    ],
    *,
    config: Annotated[
        str | None,
        Option(f"settings: {', '.join(shipped_configs('train'))} or a YAML file", "NAME"),
    ] = None,
    changes: Annotated[
        dict[str, Any], ConfigOptions(TrainSettings, "target", "epochs", "hidden", "seed")
    ],
    name: Annotated[str | None, Option("name of the network (default: name of the folder)")] = None,
    out: Annotated[Path, Option("folder for the network and its learning curves", "DIR")],
    workers: Workers,
) -> None:
    """Train a network that predicts counterfactual regrets from observations."""
    from pcs_racing_agents.base.curves import curves_picture
    from pcs_racing_agents.base.progress import show_progress
    from pcs_racing_agents.base.style import save_picture
    from pcs_racing_agents.networks.from_trees import train_regrets
    from pcs_racing_agents.networks.metrics import score_table
    from pcs_racing_agents.networks.network_files import save_network
    from pcs_racing_agents.networks.settings import load_train_settings
    from pcs_racing_agents.networks.training import epoch_curves, write_epochs
    from pcs_racing_agents.trees import load_trees
    from pcs_racing_agents.trees.storage import stored_identity

    settings = load_train_settings(config, **changes)
    name = name or out.resolve().name
    stored = [load_trees(folder) for folder in trees]
    manifests = [part.settings for part in stored]
    _check_one_game(trees, manifests)
    index = [(part, i) for part in stored for i in range(len(part))]
    # A missing library is reported before any long work.
    require("torch", extra="learning")
    with hold_folder(out), workers.start() as executor:
        folder = output_folder(out)
        network, result, rows, scores = train_regrets(
            lambda number: index[number][0][index[number][1]],
            np.concatenate([np.asarray(part.settings["pairs"]) for part in stored]),
            stored_identity(manifests[0]),
            settings,
            name=name,
            about=_about(manifests),
            executor=executor,
            solving=show_progress("trees"),
            learning=show_progress("epochs"),
        )
        best = result.epochs[result.best]
        save_network(network, folder)
        write_epochs(result, folder / "learning_curves.csv")
        if can_draw("the learning curves"):
            title = f"{name}: {settings.target}"
            figure = curves_picture(
                epoch_curves(result), log=("loss",), mark=best.epoch, title=title
            )
            save_picture(figure, folder / "learning_curves.png")
    print(
        f"{network}\n{network.training['rows']} rows from {network.training['tracks']}; epoch"
        f" {best.epoch} of {result.epochs[-1].epoch} kept, validation loss"
        f" {best.validation_loss:.4f}\n\n{score_table(rows, scores)}\n\nnetwork: {folder}"
    )


def _check_one_game(folders: Sequence[Path], manifests: Sequence[Mapping[str, Any]]) -> None:
    """Check that all trees have equal archives (by content) and rules; tracks may differ."""

    def facts(settings: Mapping[str, Any]) -> dict[str, Any]:
        rules = {key: value for key, value in settings["rules"].items() if key != "race"}
        race = {f"race {key}": value for key, value in settings["rules"]["race"].items()}
        return {
            "archive": settings["archive"]["sha256"],
            "encoding": settings["encoding"],
            **rules,
            **race,
        }

    first = facts(manifests[0])
    for folder, settings in zip(folders, manifests, strict=True):
        for key, value in facts(settings).items():
            if value != first[key]:
                raise InputError(
                    f"{folder} and {folders[0]} hold trees of different games: {key} is"
                    f" {value!r:.60} in one and {first[key]!r:.60} in the other"
                )


def _about(manifests: Sequence[Mapping[str, Any]]) -> dict[str, str | int | float | bool]:
    rules = manifests[0]["rules"]
    return {
        "tracks": ", ".join(sorted({manifest["track"]["name"] for manifest in manifests})),
        "utility": rules["utility"],
        "step_seconds": rules["step_seconds"],
    }
