"""Training of a network on game trees: solve, make rows, train, and evaluate on held-out trees."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.base.executors import in_other_processes, run_tasks
from pcs_racing_agents.base.jobs import Progress
from pcs_racing_agents.networks.metrics import (
    RowScore,
    TreeScore,
    blind_plays,
    follow,
    score_rows,
    score_trees,
)
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import (
    Rows,
    draw_pairs,
    get_target,
    join_rows,
    pair_number,
    solve_for,
    tree_rows,
)
from pcs_racing_agents.networks.training import TrainingResult, TrainSettings, train_network

if TYPE_CHECKING:
    from pcs_racing_agents.trees import RaceTree


class TrainedOnTrees(NamedTuple):
    """Network trained on game trees."""

    network: RegretNetwork  #: Network; its ``training`` includes the scores on the held-out trees.
    result: TrainingResult
    #: Scores of choices on the rows of the held-out trees, or of the validation pairs without
    #: held-out trees.
    rows: RowScore
    #: :class:`TreeScore` of the network and other strategies on each held-out tree,
    #: shape (trees, 2); empty without held-out trees.
    scores: dict[str, NDArray[np.float64]]


def train_regrets(
    tree_at: "Callable[[int], RaceTree]",
    pairs: ArrayLike,
    identity: GameIdentity,
    settings: TrainSettings,
    *,
    name: str,
    about: dict[str, str | int | float | bool] | None = None,
    executor: Executor | None = None,
    solving: Progress | None = None,
    learning: Progress | None = None,
) -> TrainedOnTrees:
    """Train a network on game trees and evaluate it on held-out trees.

    Parameters
    ----------
    tree_at : callable
        Returns tree ``i``; called when the tree is needed, once or (for held-out trees) twice. A
        tree is skipped if the race is over before the first move, since it has no rows.
    pairs : array of int, shape (trees, 2)
        Starting policies of each tree.
    about : dict, optional
        Further facts about the training for the network: texts and numbers by name.
    executor : Executor, optional
        Executor that solves the trees and, if it has another process, trains the network. It
        changes no result.
    solving, learning : callable, optional
        Called as ``progress(done, total, label)`` after every tree and every epoch (in this
        process).
    """
    numbers, target = pair_number(pairs), get_target(settings.target)
    held_out = _hold_out(numbers, settings)
    rows: dict[int, Rows] = {}
    trees_in_turn = (tree_at(i) for i in range(len(held_out)))
    solved = run_tasks(partial(_solve, settings), trees_in_turn, executor, "solving trees")
    for done, (i, block) in enumerate(solved, start=1):
        if block is not None:
            rows[i] = block
        if solving is not None:
            solving(done, len(held_out), f"solved for {settings.target}")
    training = join_rows([rows[i] for i in sorted(rows) if not held_out[i]])
    test = [i for i in sorted(rows) if held_out[i]]
    # Torch has one random state and one thread count per process: threads would disturb each other.
    elsewhere = in_other_processes(executor)
    learn = partial(
        train_network,
        training,
        identity,
        name=name,
        clipped=target.clipped,
        relative=target.relative,
        progress=learning if elsewhere is None else None,
    )
    ((_, (network, result)),) = run_tasks(learn, [settings], elsewhere, "learning")
    # Without held-out trees the pairs of early stopping are used; their scores are slightly biased.
    test_rows = (
        join_rows([rows[i] for i in test])
        if test
        else training.take(np.isin(training.pair, result.validation_pairs))
    )
    scores, trees = score_rows(network, test_rows), {}
    summary = {
        "trees": len(held_out),
        "test_trees": len(test),
        **dict(network.training),
        **(about or {}),
    }
    summary["test_agreement"] = float(f"{scores.agreement:.4g}")
    if test:
        trees = score_trees(
            {name: follow(network), **blind_plays(identity.moves)}, (tree_at(i) for i in test)
        )
        for key, value in zip(TreeScore._fields, trees[name].mean(axis=0), strict=True):
            summary[f"test_{key}"] = float(f"{value:.4g}")
    return TrainedOnTrees(replace(network, training=summary), result, scores, trees)


def _hold_out(numbers: NDArray[np.int64], settings: TrainSettings) -> NDArray[np.bool_]:
    """Return a mask of held-out trees, shape (trees,), drawn by numbers of starting pairs."""
    different, minimum = len(np.unique(numbers)), 3 if settings.test_share > 0.0 else 2
    if different < minimum:
        raise InputError(
            f"the trees come from {different} starting pairs; it takes {minimum}: some to learn"
            f" from, some to stop by{', and some to judge by' if minimum == 3 else ''}"
        )
    if settings.test_share == 0.0:
        return np.zeros(len(numbers), np.bool_)
    drawn = draw_pairs(
        numbers, settings.test_share, np.random.SeedSequence(settings.seed, spawn_key=(3,))
    )
    return np.isin(numbers, drawn[: different - 2])


def _solve(settings: TrainSettings, race_tree: "RaceTree") -> Rows | None:
    """Return the rows of a tree; None if the race is over before the first move."""
    if np.all(race_tree.over[0]):
        return None
    target = settings.target
    solution = solve_for(race_tree.game_tree(), target, iterations=settings.iterations)
    return tree_rows(
        race_tree, solution, target, rows_per_step=settings.rows_per_step, seed=settings.seed
    )
