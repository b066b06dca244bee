"""Training of a network on ego trees, backwards from the last move.

The value of a move depends on what follows. At the last move nothing does; a network learns from it. At the move
before, the branches continue with that network's choices, and so on: fitted Q-iteration over a finite horizon (Ernst et
al., 2005). So no target contains knowledge that a driver could not have. Values of ``"best"`` take the best moves in
hindsight: that knows the opponent's moves and the noise to come, so it is an upper bound.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.networks.from_trees import TrainedOnTrees, hold_out
from pcs_racing_agents.networks.metrics import Play, constant_plays, follow, score_rows
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import Rows, pair_number
from pcs_racing_agents.networks.settings import TrainSettings, settings_for_trees
from pcs_racing_agents.networks.training import TrainingResult, train_network
from pcs_racing_agents.results.text_table import aligned
from pcs_racing_agents.trees.ego import EgoTrees

Floats = NDArray[np.float64]

Continuation = str | Callable[[NDArray[np.float32]], ArrayLike]


def ego_values(trees: EgoTrees, continuation: Continuation = "best") -> list[tuple[Floats, Floats]]:
    """Return the values of all moves and situations under a continuation.

    Parameters
    ----------
    continuation : "best" or callable
        Car 0's further moves: the best in hindsight, or with the probabilities ``continuation(observations (n, D)) ->
        (n, A)``.

    Returns
    -------
    list of (ndarray (R, A**k, A), ndarray (R, A**k))
        For each step ``k`` the value of each move, and the return of the continuation from there.
    """
    if isinstance(continuation, str) and continuation != "best":
        raise InputError(f'continuation is {continuation!r}; it must be "best" or a function of observations')
    value = np.asarray(trees.payoffs, np.float64)
    values: list[tuple[Floats, Floats]] = []
    for level in range(trees.moves - 1, -1, -1):
        q = value.reshape(len(trees), -1, trees.options)
        if callable(continuation):
            observations = trees.observations(level)
            policy = np.asarray(continuation(observations.reshape(-1, observations.shape[-1])), np.float64)
            fits = policy.shape == (q.size // trees.options, trees.options) and np.isfinite(policy).all()
            if not fits or (policy < 0.0).any() or not np.allclose(policy.sum(axis=1), 1.0, atol=1e-4):
                raise InputError(
                    f"the continuation returned shape {policy.shape} for {q.size // trees.options} observations; it "
                    f"must return probabilities of {trees.options} moves, which sum up to 1"
                )
            value = (q * policy.reshape(q.shape)).sum(axis=-1)
        else:
            value = q.max(axis=-1)
        values.append((q, value))
    return values[::-1]


def ego_rows(trees: EgoTrees, continuation: Continuation = "best") -> Rows:
    """Return training rows: car 0's observations, and the values of its moves, where the race goes on."""
    blocks = []
    for level, (q, _) in enumerate(ego_values(trees, continuation)):
        # Situations that histories of the same policies share are one row. Its weight is the probability to get there
        # with moves at random: that of as many histories as go along its path.
        paths = trees.paths[level]
        first = np.zeros(paths.shape, np.bool_)
        weight = np.zeros(paths.shape)
        for r, numbers in enumerate(paths):
            _, begin, times = np.unique(numbers, return_index=True, return_counts=True)
            first[r, begin] = True
            weight[r, begin] = times / paths.shape[1]
        at = np.nonzero(first & ~trees.over[level])
        pair = pair_number(trees.policies)[at[0]]
        blocks.append((trees.observations(level)[at], q[at], weight[at], pair, np.full(len(pair), level, np.int64)))
    observations, targets, weights, pair, step = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    if len(targets) == 0:
        raise InputError("every race is over before the first move; no ego tree gives a row")
    return Rows(observations, targets, weights, pair, step)


TARGET = "static-q"
BEST = "best in hindsight"


def train_on_ego(
    trees: EgoTrees,
    identity: GameIdentity,
    settings: TrainSettings,
    *,
    name: str,
    about: dict[str, str | int | float | bool] | None = None,
    learning: Progress | None = None,
) -> TrainedOnTrees:
    """Train a network on ego trees and evaluate it on held-out roots.

    With ``settings.continuation = "best"`` there is one training, on targets in which the best follows every move; it
    knows the opponent's moves and the noise to come. With "learned" there is one for every move, from the last to the
    first.

    Parameters
    ----------
    settings : TrainSettings
        Its target must be "static-q"; its weights and numbers of rows per tree play no role.
    about : dict, optional
        What else the network should know of its training, texts and numbers by name.
    learning : callable, optional
        Called as ``progress(epoch, epochs, label)``.
    """
    check_ego_target(settings)
    settings = settings_for_trees(settings)
    numbers = pair_number(trees.policies)
    held_out = hold_out(numbers, settings, 3, "roots")
    learned = take_roots(trees, ~held_out)

    def fit(continuation: str | Play, first: int) -> tuple[RegretNetwork, TrainingResult]:
        rows = ego_rows(learned, continuation)
        return train_network(rows.take(rows.step >= first), identity, settings, name=name, progress=learning)

    if settings.continuation == "best":
        network, result = fit("best", 0)
    else:
        network, result = fit("best", trees.moves - 1)  # nothing follows the last move
        for first in reversed(range(trees.moves - 1)):
            network, result = fit(follow(network), first)
    judged, roots = ego_rows(take_roots(trees, held_out) if held_out.any() else learned, follow(network)), {}
    if not held_out.any():
        judged = judged.take(np.isin(judged.pair, result.validation_pairs))
    scores = score_rows(network, judged)
    summary = {"roots": len(trees), "test_roots": int(held_out.sum()), **dict(network.training), **(about or {})}
    summary["test_agreement"] = float(f"{scores[0].agreement:.4g}")
    if held_out.any():
        plays = {name: follow(network), **constant_plays(identity.moves)}
        roots = score_ego(plays, take_roots(trees, held_out))
        summary["test_utility"] = float(f"{roots[name].mean():.4g}")
    return TrainedOnTrees(replace(network, training=summary), result, scores, roots)


def check_ego_target(settings: TrainSettings) -> None:
    """Check that the target is one that ego trees give."""
    if settings.target != TARGET:
        raise InputError(f"target is {settings.target!r}; ego trees have one player and give {TARGET!r} alone")


def take_roots(trees: EgoTrees, indices: ArrayLike) -> EgoTrees:
    """Return some roots, by index or by a mask over roots."""
    rows = np.asarray(indices)
    return type(trees).from_arrays({key: array[rows] for key, array in trees.arrays().items()}, "the roots")


def score_ego(plays: dict[str, Play], trees: EgoTrees) -> dict[str, NDArray[np.float64]]:
    """Return the utility of strategies in each root against its opponent, shape (R,) each.

    Random moves, and the best moves in hindsight, are added for comparison.
    """

    def random(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return np.full((len(observations), trees.options), 1.0 / trees.options)

    strategies: dict[str, str | Play] = {**plays, "random moves": random, BEST: "best"}
    return {name: ego_values(trees, play)[0][1][:, 0] for name, play in strategies.items()}


def ego_score_table(rows: str, roots: dict[str, NDArray[np.float64]]) -> str:
    """Return a table of choices, followed by the mean utility of the strategies, as text."""
    if not roots:
        return rows
    count = len(next(iter(roots.values())))
    errors = {name: values.std(ddof=1) / np.sqrt(count) if count > 1 else np.nan for name, values in roots.items()}
    table = aligned([name, f"{values.mean():.3f} ({errors[name]:.3f})"] for name, values in roots.items())
    head = f"utility in {count} held-out roots (standard error over roots):"
    return "\n".join([rows, "", head, *(f"  {line}" for line in table)])
