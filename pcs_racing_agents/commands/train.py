"""``pcs-racing train``: a network that tells from what a driver saw what each of its moves is worth."""

import argparse
import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcs_racing.errors import InputError
from pcs_racing.files import write_atomically
from pcs_racing_agents.commands.options import Commands, add_command, output_folder
from pcs_racing_agents.configuration import shipped_configs

if TYPE_CHECKING:
    from pcs_racing_agents.approximator.from_trees import Trained

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "train",
        "train the regret approximator on game trees",
        "pcs-racing train out/trees --target regret --out out/networks/regret",
        "pcs-racing train out/trees-a out/trees-b --config paper --target advantage --out out/networks/advantage",
    )
    parser.add_argument("trees", nargs="+", type=Path, metavar="DIR", help="folders that 'pcs-racing tree' wrote")
    parser.add_argument(
        "--target", help="what to learn: regret (the paper; the default), normalised, advantage or static-q"
    )
    configs = ", ".join(shipped_configs("train"))
    parser.add_argument("--config", metavar="NAME", help=f"settings: a YAML file or one of {configs or 'none shipped'}")
    parser.add_argument("--epochs", type=int, metavar="N", help="at most so many epochs")
    parser.add_argument("--hidden", type=int, nargs="+", metavar="N", help="widths of the hidden layers")
    parser.add_argument("--seed", type=int, metavar="N", help="root of the split, the first weights and the draws")
    parser.add_argument("--name", help="name of the network (default: that of the folder)")
    parser.add_argument("--no-tensorboard", action="store_true", help="write no curves for TensorBoard")
    parser.add_argument("--no-picture", action="store_true", help="draw no learning curves")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the network and its curves")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Train, print what the network is worth, and write it."""
    from pcs_racing_agents.approximator.curves import write_curves, write_picture, write_tensorboard
    from pcs_racing_agents.approximator.from_trees import train_on_trees, trees_identity
    from pcs_racing_agents.approximator.metrics import score_table
    from pcs_racing_agents.approximator.settings import load_train_settings
    from pcs_racing_agents.jobs import show_progress
    from pcs_racing_agents.trees import load_trees

    changes = {key: getattr(arguments, key) for key in ("target", "epochs", "seed")}
    changes["hidden"] = tuple(arguments.hidden) if arguments.hidden else None
    settings = load_train_settings(
        arguments.config, **{key: value for key, value in changes.items() if value is not None}
    )
    stored = [load_trees(folder) for folder in arguments.trees]
    identities = [trees_identity(trees.settings) for trees in stored]
    for trees, identity in zip(stored, identities, strict=True):
        if identity._replace(archive="") != identities[0]._replace(archive=""):
            keys = [key for key, a, b in zip(identity._fields, identity, identities[0], strict=True) if a != b]
            raise InputError(f"{trees.folder} and {stored[0].folder} hold trees of different games: {keys[0]} differs")
    _check_packages(arguments)
    folder = output_folder(arguments.out)
    name = arguments.name or folder.resolve().name
    tracks = sorted({trees.settings["track"]["name"] for trees in stored})
    places = [(trees, i) for trees in stored for i in range(len(trees))]
    trained = train_on_trees(
        lambda number: places[number][0][places[number][1]],
        np.concatenate([np.asarray(trees.settings["pairs"]) for trees in stored]),
        identities[0],
        settings,
        name=name,
        about={"tracks": ", ".join(tracks)},
        solving=show_progress("trees"),
        learning=show_progress("epochs"),
    )
    trained.network.save(folder)
    write_curves(trained.fit, folder / "learning_curves.csv")
    _write_scores(trained, folder / "scores.csv")
    if not arguments.no_tensorboard:
        write_tensorboard(trained.fit, folder / "tensorboard")
    if not arguments.no_picture:
        write_picture(trained.fit, folder / "learning_curves.png", f"{name}: {settings.target}")
    best = trained.fit.epochs[trained.fit.best]
    print(
        f"{trained.network}\n{trained.network.training['rows']} rows of {trained.network.training['trees']} trees on "
        f"{', '.join(tracks)}; epoch {best.epoch} of {trained.fit.epochs[-1].epoch} kept, validation loss "
        f"{best.validation_loss:.4f}\n\n{score_table(trained.rows, trained.trees)}\n\nnetwork: {folder}"
    )


def _check_packages(arguments: argparse.Namespace) -> None:
    """Say what is missing before any work is done."""
    from importlib.util import find_spec

    wanted = [("torch", "learning", True), ("tensorboard", "learning", not arguments.no_tensorboard)]
    wanted += [("matplotlib", "plots", not arguments.no_picture)]
    for package, extra, needed in wanted:
        if needed and find_spec(package) is None:
            raise ModuleNotFoundError(f'training needs {package}: pip install "pcs-racing[{extra}]"')


def _write_scores(trained: "Trained", file: Path) -> None:
    """Write what the network and others lose on each held-out tree."""
    from pcs_racing_agents.approximator.metrics import TreeScore

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["strategy", "tree", *TreeScore._fields])
    for name, scores in trained.trees.items():
        for i, row in enumerate(scores):
            writer.writerow([name, i, *(f"{value:.7g}" for value in row)])
    write_atomically(file, lambda stream: stream.write(text.getvalue().encode("utf-8")))
