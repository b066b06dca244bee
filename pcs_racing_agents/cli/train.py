"""``pcs-racing train``: train a network that predicts counterfactual regrets from observations."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError, require
from pcs_racing_agents.cli.commands import Option, SettingOptions, command
from pcs_racing_agents.cli.options import Workers, output_folder
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.jobs.folders import hold_folder
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.results.csv_files import write_csv

if TYPE_CHECKING:
    from pcs_racing_agents.networks import RegretNetwork
    from pcs_racing_agents.networks.training import TrainingResult


class _Outcome(NamedTuple):
    """A trained network, its training, and its scores as text and as rows of a table."""

    network: "RegretNetwork"
    result: "TrainingResult"
    table: str
    scores: list[dict[str, str | float]]


_Learn = Callable[[Executor | None], _Outcome]


@command(
    "train",
    "pcs-racing train out/trees --target regret --out out/networks/regret",
    "pcs-racing train out/trees-a out/trees-b --config study --target advantage --out out/networks/advantage",
    "pcs-racing train out/ego --out out/networks/static-q",
)
def run(
    trees: Annotated[Sequence[Path], Option("folders of game trees or ego trees, written by 'pcs-racing tree'", "DIR")],
    *,
    config: Annotated[
        str | None, Option(f"settings: {', '.join(shipped_configs('train'))} or a YAML file", "NAME")
    ] = None,
    changes: Annotated[dict[str, Any], SettingOptions(TrainSettings, "target", "epochs", "hidden", "seed")],
    name: Annotated[str | None, Option("name of the network (default: that of the folder)")] = None,
    no_tensorboard: Annotated[bool, Option("do not write learning curves for TensorBoard")] = False,
    no_picture: Annotated[bool, Option("do not draw the learning curves")] = False,
    out: Annotated[Path, Option("folder for the network and its learning curves", "DIR")],
    workers: Workers,
) -> None:
    """Train a network that predicts counterfactual regrets, or another value of each move, from observations."""
    from pcs_racing_agents.networks.network_files import save_network
    from pcs_racing_agents.networks.settings import load_train_settings
    from pcs_racing_agents.networks.training import epoch_curves, write_epochs
    from pcs_racing_agents.pictures.curves import curves_picture, write_tensorboard
    from pcs_racing_agents.pictures.style import save_picture

    ego = [_holds_ego_trees(folder) for folder in trees]
    if any(ego):
        # Against one sequence of moves there are no counterfactual regrets, only values.
        changes.setdefault("target", "static-q")
    settings = load_train_settings(config, **changes)
    name = name or out.resolve().name
    if not any(ego):
        learn = _from_trees(trees, settings, name)
    elif all(ego):
        learn = _from_ego(trees, settings, name)
    else:
        raise InputError(f"{trees[ego.index(True)]} holds ego trees, others do not; give folders of one kind")
    # A missing library is told before any long work.
    require("torch", *(("tensorboard",) if not no_tensorboard else ()), extra="learning")
    if not no_picture:
        require("matplotlib", extra="plots")
    with hold_folder(out), workers.start() as executor:
        folder = output_folder(out)
        network, result, table, scores = learn(executor)
        best = result.epochs[result.best]
        save_network(network, folder)
        write_epochs(result, folder / "learning_curves.csv")
        _write_scores(scores, folder / "scores.csv")
        if not no_tensorboard:
            values = (epoch._asdict() for epoch in result.epochs)
            steps = [(row.pop("epoch"), {key.replace("_", "/", 1): row[key] for key in row}) for row in values]
            write_tensorboard(folder / "tensorboard", {"": steps})
        if not no_picture:
            title = f"{name}: {settings.target}"
            figure = curves_picture(epoch_curves(result), log=("loss",), mark=best.epoch, title=title)
            save_picture(figure, folder / "learning_curves.png")
    print(
        f"{network}\n{network.training['rows']} rows from {network.training['tracks']}; epoch {best.epoch} of "
        f"{result.epochs[-1].epoch} kept, validation loss {best.validation_loss:.4f}\n\n{table}\n\nnetwork: {folder}"
    )


def _from_trees(folders: Sequence[Path], settings: TrainSettings, name: str) -> _Learn:
    """Open folders of game trees; return the function that trains on them."""
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.networks.from_trees import train_on_trees
    from pcs_racing_agents.networks.metrics import TreeScore, score_table
    from pcs_racing_agents.trees import load_trees
    from pcs_racing_agents.trees.storage import stored_identity

    stored = [load_trees(folder) for folder in folders]
    manifests = [trees.settings for trees in stored]
    _check_one_game(folders, manifests)
    index = [(trees, i) for trees in stored for i in range(len(trees))]

    def learn(executor: Executor | None) -> _Outcome:
        trained = train_on_trees(
            lambda number: index[number][0][index[number][1]],
            np.concatenate([np.asarray(trees.settings["pairs"]) for trees in stored]),
            stored_identity(manifests[0]),
            settings,
            name=name,
            about=_about(manifests),
            executor=executor,
            solving=show_progress("trees"),
            learning=show_progress("epochs"),
        )
        scores = [
            {"strategy": strategy, "tree": i, **TreeScore(*row)._asdict()}
            for strategy, rows in trained.scores.items()
            for i, row in enumerate(rows.tolist())
        ]
        return _Outcome(trained.network, trained.result, score_table(trained.rows, trained.scores), scores)

    return learn


def _from_ego(folders: Sequence[Path], settings: TrainSettings, name: str) -> _Learn:
    """Open folders of ego trees; return the function that trains on them."""
    from pcs_racing_agents.jobs.progress import show_progress
    from pcs_racing_agents.jobs.tasks import in_other_processes, run_task
    from pcs_racing_agents.networks.from_ego import check_ego_target, ego_score_table, train_on_ego
    from pcs_racing_agents.networks.metrics import score_table
    from pcs_racing_agents.trees import load_ego_trees
    from pcs_racing_agents.trees.ego import join_ego
    from pcs_racing_agents.trees.storage import EGO_KIND, read_settings, stored_identity

    check_ego_target(settings)
    manifests = [read_settings(folder, EGO_KIND) for folder in folders]
    _check_one_game(folders, manifests)
    trees = join_ego([load_ego_trees(folder) for folder in folders])

    def learn(executor: Executor | None) -> _Outcome:
        # torch's random generator belongs to the process: in a thread of this one other work would draw from it.
        elsewhere = in_other_processes(executor)
        train = partial(
            train_on_ego,
            identity=stored_identity(manifests[0]),
            settings=settings,
            name=name,
            about=_about(manifests),
            learning=show_progress("epochs") if elsewhere is None else None,
        )
        trained = run_task(train, trees, elsewhere, "learning")
        table = ego_score_table(score_table(trained.rows, {}), trained.scores)
        scores = [
            {"strategy": strategy, "root": i, "utility": value}
            for strategy, values in trained.scores.items()
            for i, value in enumerate(values.tolist())
        ]
        return _Outcome(trained.network, trained.result, table, scores)

    return learn


def _holds_ego_trees(folder: Path) -> bool:
    from pcs_racing_agents.trees.storage import EGO_KIND, read_settings

    try:
        read_settings(folder, EGO_KIND)
    except InputError:
        # Other content, or none, is reported where the folder is opened.
        return False
    return True


def _check_one_game(folders: Sequence[Path], manifests: Sequence[Mapping[str, Any]]) -> None:
    """Check that all trees have the same archive (by content) and the same rules; tracks may differ."""

    def facts(settings: Mapping[str, Any]) -> dict[str, Any]:
        rules = {key: value for key, value in settings["rules"].items() if key != "race"}
        race = {f"race {key}": value for key, value in settings["rules"]["race"].items()}
        return {"archive": settings["archive"]["sha256"], "encoding": settings["encoding"], **rules, **race}

    first = facts(manifests[0])
    for folder, settings in zip(folders, manifests, strict=True):
        for key, value in facts(settings).items():
            if value != first[key]:
                raise InputError(
                    f"{folder} and {folders[0]} hold trees of different games: {key} is {value!r:.60} in one and "
                    f"{first[key]!r:.60} in the other"
                )


def _about(manifests: Sequence[Mapping[str, Any]]) -> dict[str, str | int | float | bool]:
    rules = manifests[0]["rules"]
    return {
        "tracks": ", ".join(sorted({manifest["track"]["name"] for manifest in manifests})),
        "utility": rules["utility"],
        "step_seconds": rules["step_seconds"],
    }


def _write_scores(scores: list[dict[str, str | float]], file: Path) -> None:
    """Write the scores of the network and of other strategies on the trees held out from training."""
    rows = [list(scores[0]) if scores else ["strategy"]]
    rows += [[f"{value:.7g}" if isinstance(value, float) else str(value) for value in row.values()] for row in scores]
    write_csv(rows, file)
