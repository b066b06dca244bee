"""Evaluation of a network: agreement with targets, and value lost by choices on held-out trees.

A small error of the values can cost much, and a large error nothing; only the resulting move
counts.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.base.tables import Column, aligned, table_rows
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import Rows, best_moves
from pcs_racing_agents.solvers import (
    ExactResult,
    GameTree,
    Profile,
    best_response,
    play_value,
    solve_exact,
    uniform_profile,
)

if TYPE_CHECKING:
    from pcs_racing_agents.trees import RaceTree

Play = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""Function from observations (R, D) to probabilities of the moves, shape (R, A)."""


class RowScore(NamedTuple):
    """Comparison of a network's choices with the targets of rows, each with its weight."""

    rows: int
    agreement: float  #: Share of rows whose chosen move has the highest target.
    #: Same share for random moves (above 1 / A where several moves are equally good).
    chance: float
    constant: float  #: Same share for the best constant move on these rows.
    shortfall: float  #: Mean of the highest target minus the target of the chosen move.


CHOICES = (
    Column("rows"),
    Column("agreement", format=".1%"),
    Column("chance", "random", ".1%"),
    Column("constant", "best constant", ".1%"),
    Column("shortfall", format=".4g"),
)
"""Columns of the table of choices."""


class TreeScore(NamedTuple):
    """Value of a strategy on one tree, mean of both roles, in units of the utility."""

    #: Value of the game minus the strategy's value against an opponent that knows it: half its
    #: NashConv.
    lost_to_best_response: float
    #: Value of the game minus the strategy's value against an opponent that plays its equilibrium.
    lost_to_equilibrium: float


def score_rows(network: RegretNetwork, rows: Rows) -> RowScore:
    """Compare choices with targets."""
    choice, best = network.choose(rows.observations), best_moves(rows.targets)
    each = np.arange(len(rows))
    shortfall = rows.targets.max(axis=1) - rows.targets[each, choice]
    share = rows.weights / rows.weights.sum()
    return RowScore(
        rows=len(rows),
        agreement=float(share @ best[each, choice]),
        chance=float(share @ best.mean(axis=1)),
        constant=float((share @ best).max()),
        shortfall=float(share @ shortfall.astype(np.float64)),
    )


def follow(network: RegretNetwork) -> Play:
    """Return the strategy that makes the network's choice with certainty.

    For target "nash" the strategy draws from the network's probabilities.
    """

    def play(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        choice = np.eye(len(network.moves))[network.choose(observations)]
        if network.target != "nash":
            return choice
        odds = np.maximum(network.unclipped(observations).astype(np.float64), 0.0)
        total = odds.sum(axis=-1, keepdims=True)
        return np.where(total > 0.0, odds / np.where(total > 0.0, total, 1.0), choice)

    return play


def blind_plays(moves: Sequence[str]) -> dict[str, Play]:
    """Return the strategies of one constant move each and of random moves, by name."""
    odds = {f"always {move}": row for move, row in zip(moves, np.eye(len(moves)), strict=True)}
    odds["random moves"] = np.full(len(moves), 1.0 / len(moves))
    return {name: lambda seen, row=row: np.tile(row, (len(seen), 1)) for name, row in odds.items()}  # type: ignore[misc]


def play_profile(play: Play, race_tree: "RaceTree") -> Profile:
    """Return a strategy as a profile: both roles, every node of every seed, shape (S * N_k, A)
    each.
    """
    profile = []
    for k in range(race_tree.game_tree().depth):
        observations = race_tree.observations(k)
        size = observations.shape[-1]
        both = [
            np.asarray(play(observations[:, :, player].reshape(-1, size)), np.float64)
            for player in (0, 1)
        ]
        profile.append((both[0], both[1]))
    return profile


def score_tree(profile: Profile, race_tree: "RaceTree", exact: ExactResult) -> TreeScore:
    """Evaluate a strategy (:func:`play_profile`) on a tree with its exact solution.

    With several noise seeds the strategy gets the observations of each seed. The best response
    and the equilibrium know the moves made so far but not the seed.
    """
    tree = race_tree.game_tree()
    payoffs = np.asarray(race_tree.payoffs, np.float64)
    seeds = len(payoffs)
    each = GameTree.from_payoffs(
        payoffs.reshape(seeds, *(count for pair in tree.moves for count in pair)),
        np.full(seeds, 1.0 / seeds),
    )
    # The observations of the strategy differ by seed: each node is its own infoset. The opponent
    # knows the moves but not the seed: nodes of all seeds are one infoset.
    own = [np.arange(each.nodes(k)) for k in range(each.depth)]
    shared = [np.tile(np.arange(tree.nodes(k)), seeds) for k in range(each.depth)]
    losses = []
    for player, labels in enumerate(((own, shared), (shared, own))):
        game = each.with_infosets(list(zip(*labels, strict=True)))
        sign = 1.0 - 2.0 * player
        # The player's half of the profile is the strategy; the opponent supplies the other half.
        anybody = _with_opponent(profile, uniform_profile(game), player)
        rival = _with_opponent(profile, exact.profile, player)
        best = best_response(game, anybody, 1 - player).value
        losses.append((sign * exact.value + best, sign * (exact.value - play_value(game, rival))))
    return TreeScore(*np.mean(losses, axis=0).tolist())


def _with_opponent(profile: Profile, other: Profile, player: int) -> Profile:
    """Return a profile: one player follows the first profile, the opponent the second."""
    mine, theirs = (profile, other) if player == 0 else (other, profile)
    return [(first[0], second[1]) for first, second in zip(mine, theirs, strict=True)]


def score_trees(
    plays: dict[str, Play], race_trees: "Iterable[RaceTree]"
) -> dict[str, NDArray[np.float64]]:
    """Evaluate strategies on several trees, shape (trees, 2) each in the order of
    :class:`TreeScore`.
    """
    scores: dict[str, list[TreeScore]] = {name: [] for name in plays}
    for race_tree in race_trees:
        exact = solve_exact(race_tree.game_tree())
        for name, play in plays.items():
            scores[name].append(score_tree(play_profile(play, race_tree), race_tree, exact))
    return {name: np.array(rows, np.float64) for name, rows in scores.items()}


def score_table(rows: RowScore, trees: dict[str, NDArray[np.float64]]) -> str:
    """Return scores as text: choices against targets, then strategies on the trees."""
    lines = aligned(table_rows(CHOICES, [rows]), left=0)
    lines = ["choices on held-out rows:", *(f"  {line}" for line in lines)]
    if not trees:
        return "\n".join(lines)
    count = len(next(iter(trees.values())))
    table = [["strategy", "lost to a best response", "lost to equilibrium"]]
    for name, scores in trees.items():
        # One tree has no error.
        errors = scores.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else [np.nan] * 2
        pairs = zip(scores.mean(axis=0), errors, strict=True)
        table.append([name, *(f"{mean:.3f} ({error:.3f})" for mean, error in pairs)])
    title = f"utility on {count} held-out trees, mean of both roles (standard error over trees):"
    return "\n".join([*lines, "", title, *(f"  {line}" for line in aligned(table, left=1))])
