"""From folders of trees to a trained network and what it is worth: solve, make rows, train, judge."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.errors import InputError
from pcs_racing_agents.approximator.identity import GameIdentity
from pcs_racing_agents.approximator.metrics import RowScore, TreeScore, constant_plays, follow, score_rows, score_trees
from pcs_racing_agents.approximator.network import RegretNetwork
from pcs_racing_agents.approximator.rows import Rows, draw_pairs, join_rows, pair_number
from pcs_racing_agents.approximator.settings import TrainSettings, settings_for_trees
from pcs_racing_agents.approximator.targets import get_target, solve_for
from pcs_racing_agents.approximator.training import Fit, train_network
from pcs_racing_agents.approximator.tree_rows import PlayedTree, tree_rows
from pcs_racing_agents.jobs import Progress

__all__ = ["Trained", "train_on_trees", "trees_identity"]


class Trained(NamedTuple):
    """A network trained on trees.

    Attributes
    ----------
    network : RegretNetwork
        Its scores on the held-out trees are among what it knows of its training.
    fit : Fit
    rows : list of RowScore
        Choices on the rows of the held-out trees, or of the validation pairs where no tree is held out.
    trees : dict of str to ndarray, shape (trees, 4)
        What the network and other strategies lose on the held-out trees, :class:`TreeScore`; empty if none are.
    """

    network: RegretNetwork
    fit: Fit
    rows: list[RowScore]
    trees: dict[str, NDArray[np.float64]]


def trees_identity(settings: Any) -> GameIdentity:
    """Return the game that stored trees belong to, of :attr:`pcs_racing_agents.trees.StoredTrees.settings`."""
    epsilon = settings["rules"]["epsilon"]
    return GameIdentity(
        elements=tuple(settings["encoding"]),
        moves=tuple(settings["move_names"]),
        epsilon=tuple(epsilon) if isinstance(epsilon, list | tuple) else (epsilon,),
        archive=settings["archive"]["name"],
        archive_sha256=settings["archive"]["sha256"],
        preset=settings["preset"],
    )


def train_on_trees(
    tree_at: Callable[[int], PlayedTree],
    pairs: ArrayLike,
    identity: GameIdentity,
    settings: TrainSettings,
    *,
    name: str,
    about: dict[str, str | int | float | bool] | None = None,
    solving: Progress | None = None,
    learning: Progress | None = None,
) -> Trained:
    """Train a network on trees and judge it on others.

    Parameters
    ----------
    tree_at : callable
        Returns tree ``i``; asked when it is needed, once or (of trees held out) twice. A tree in which the race is over
        before the first move teaches nothing and is passed over.
    pairs : array of int, shape (trees, 2)
        Starting policies of each tree.
    identity : GameIdentity
        The game that they belong to.
    settings : TrainSettings
    name : str
        Of the network.
    about : dict, optional
        What else the network should know of its training, texts and numbers by name.
    solving, learning : callable, optional
        Called as ``progress(done, total, what)`` after every tree and every epoch.

    Raises
    ------
    InputError
        If the trees come from too few starting pairs: 2, or 3 with some held out.
    """
    settings = settings_for_trees(settings)
    numbers = pair_number(pairs)
    held_out = np.zeros(len(numbers), np.bool_)
    different, least = len(np.unique(numbers)), 3 if settings.test_share > 0.0 else 2
    if different < least:
        raise InputError(
            f"the trees come from {different} starting pairs; it takes {least}: some to learn from, some to stop by"
            f"{', and some to judge by' if least == 3 else ''}"
        )
    if settings.test_share > 0.0:
        chosen = draw_pairs(numbers, settings.test_share, np.random.SeedSequence(settings.seed, spawn_key=(3,)))
        held_out = np.isin(numbers, chosen[: different - 2])
    stay = len(identity.moves) - 1 if identity.moves[-1] == "stay" else None
    learned: list[Rows] = []
    judged: list[Rows] = []
    test: list[int] = []
    for i, out in enumerate(held_out):
        race_tree = tree_at(i)
        if not np.all(race_tree.over[0]):
            tree = race_tree.game_tree()
            solution = solve_for(tree, settings.target, iterations=settings.iterations, variant=settings.variant)
            rows = tree_rows(
                race_tree,
                solution,
                settings.target,
                opponent=settings.opponent,
                stay=stay,
                row_weights=settings.row_weights or "uniform",
                rows_per_step=settings.rows_per_step,
                seed=settings.seed,
            )
            (judged if out else learned).append(rows)
            if out:
                test.append(i)
        if solving is not None:
            solving(i + 1, len(held_out), f"solved for {settings.target}")
    known = join_rows(learned)
    clipped = get_target(settings.target).clipped
    network, fit = train_network(known, identity, settings, name=name, clipped=clipped, progress=learning)
    kept_back = join_rows(judged) if judged else known.take(np.isin(known.pair, fit.validation_pairs))
    scores, trees = score_rows(network, kept_back), {}
    summary = {"trees": len(held_out), "test_trees": len(test), **dict(network.training), **(about or {})}
    summary["test_agreement"] = float(f"{scores[0].agreement:.4g}")
    if test:
        trees = score_trees({name: follow(network), **constant_plays(identity.moves)}, (tree_at(i) for i in test))
        for key, value in zip(TreeScore._fields, trees[name].mean(axis=0), strict=True):
            summary[f"test_{key}"] = float(f"{value:.4g}")
    return Trained(replace(network, training=summary), fit, scores, trees)
