"""Evaluation of a network: agreement with targets, and value lost by choices on held-out trees.

A small error of the values can cost much, and a large error nothing; only the resulting move
counts.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.rows import Rows
from pcs_racing_agents.networks.targets import PlayedTree, best_moves
from pcs_racing_agents.solvers import (
    ExactResult,
    GameTree,
    Profile,
    best_response,
    play_value,
    solve_exact,
    uniform_profile,
)

Play = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""Function from observations (R, D) to probabilities of the moves, shape (R, A)."""


class RowScore(NamedTuple):
    """Comparison of a network's choices with the targets of rows."""

    step: int  #: Number of moves made so far; -1 for all rows together, each with its weight.
    rows: int
    agreement: float  #: Weighted share of rows whose chosen move has the highest target.
    #: Same share for random moves (above 1 / A where several moves are equally good).
    chance: float
    constant: float  #: Same share for the best constant move on these rows.
    shortfall: float  #: Weighted mean of the highest target minus the target of the chosen move.
    #: Weighted mean squared error of the network's values (clipped values if it clips).
    error: float


class TreeScore(NamedTuple):
    """Value of a strategy on one tree, mean of both roles, in units of the utility."""

    #: Value of the game minus the strategy's value against an opponent that knows it: half its
    #: NashConv.
    lost_to_best_response: float
    #: Value of the game minus the strategy's value against an opponent that plays its equilibrium.
    lost_to_equilibrium: float
    #: Absolute difference between the value of the game and the value of car 0 if both cars follow
    #: the strategy.
    off_in_self_play: float
    against_random: float  #: Value against an opponent with random moves.


def score_rows(network: RegretNetwork, rows: Rows) -> list[RowScore]:
    """Compare choices with targets: first on all rows, then on the rows of each step."""
    values = network(rows.observations)
    choice = network.choose(rows.observations, rows.mask)
    best = best_moves(rows.targets, rows.mask)
    targets = np.maximum(rows.targets, 0.0) if network.clipped else rows.targets
    shortfall = (
        np.where(rows.mask, rows.targets, -np.inf).max(axis=1)
        - rows.targets[np.arange(len(rows)), choice]
    )
    error = np.sum(rows.mask * (values - targets) ** 2, axis=1) / rows.mask.sum(axis=1)
    chance = np.sum(best & rows.mask, axis=1) / rows.mask.sum(axis=1)
    result = []
    for step in (-1, *np.unique(rows.step)):
        included = (rows.step == step) | (step < 0)
        share = rows.weights[included] / (rows.weights[included].sum() or 1.0)
        result.append(
            RowScore(
                step=int(step),
                rows=int(included.sum()),
                agreement=float(share @ best[included, choice[included]]),
                chance=float(share @ chance[included]),
                constant=float((share @ best[included]).max()),
                shortfall=float(share @ shortfall[included].astype(np.float64)),
                error=float(share @ error[included].astype(np.float64)),
            )
        )
    return result


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


def constant_plays(moves: Sequence[str]) -> dict[str, Play]:
    """Return the strategies of one constant move each, by name."""

    def always(i: int) -> Play:
        return lambda observations: np.tile(np.eye(len(moves))[i], (len(observations), 1))

    return {f"always {move}": always(i) for i, move in enumerate(moves)}


def play_profile(play: Play, race_tree: PlayedTree) -> Profile:
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


def score_tree(
    profile: Profile, race_tree: PlayedTree, exact: ExactResult | None = None
) -> TreeScore:
    """Evaluate a strategy (:func:`play_profile`) on a tree, with its exact solution if known.

    With several noise seeds the strategy gets the observations of each seed. The best response
    and the equilibrium know the moves made so far but not the seed.
    """
    tree = race_tree.game_tree()
    exact = solve_exact(tree) if exact is None else exact
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
    both_see = each.with_infosets(list(zip(own, own, strict=True)))
    losses = np.zeros((2, 3))
    for player in (0, 1):
        value = exact.value if player == 0 else -exact.value
        labels = (own, shared) if player == 0 else (shared, own)
        game = each.with_infosets(list(zip(*labels, strict=True)))
        # The player's half of the profile is the strategy; the opponent supplies the other half.
        uniform = uniform_profile(game)

        def against(other: Profile, player: int = player) -> Profile:
            mine, theirs = (profile, other) if player == 0 else (other, profile)
            return [(first[0], second[1]) for first, second in zip(mine, theirs, strict=True)]

        sign = 1.0 if player == 0 else -1.0
        losses[player] = (
            value + best_response(game, against(uniform), 1 - player).value,
            value - sign * play_value(game, against(exact.profile)),
            sign * play_value(game, against(uniform)),
        )
    self_play = abs(play_value(both_see, profile) - exact.value)
    to_best, to_equilibrium, random = losses.mean(axis=0)
    return TreeScore(float(to_best), float(to_equilibrium), float(self_play), float(random))


def score_trees(
    plays: dict[str, Play], race_trees: Iterable[PlayedTree]
) -> dict[str, NDArray[np.float64]]:
    """Evaluate strategies on several trees, shape (trees, 4) each in the order of
    :class:`TreeScore`.

    The equilibrium of each tree and random moves are added for comparison.
    """
    scores: dict[str, list[TreeScore]] = {
        name: [] for name in (*plays, "equilibrium", "random moves")
    }
    for race_tree in race_trees:
        tree = race_tree.game_tree()
        exact, seeds = solve_exact(tree), len(race_tree.payoffs)
        profiles = {name: play_profile(play, race_tree) for name, play in plays.items()}
        for name, one_seed in (
            ("equilibrium", exact.profile),
            ("random moves", uniform_profile(tree)),
        ):
            profiles[name] = [
                (np.tile(first, (seeds, 1)), np.tile(second, (seeds, 1)))
                for first, second in one_seed
            ]
        for name, profile in profiles.items():
            scores[name].append(score_tree(profile, race_tree, exact))
    return {
        name: np.array(rows, np.float64).reshape(-1, len(TreeScore._fields))
        for name, rows in scores.items()
    }


def score_table(rows: Sequence[RowScore], trees: dict[str, NDArray[np.float64]]) -> str:
    """Return scores as text: choices against targets by step, then the utility of strategies on the
    trees.
    """
    table = [["step", "rows", "agreement", "random", "best constant", "shortfall"]]
    for score in rows:
        shares = [f"{share:.1%}" for share in (score.agreement, score.chance, score.constant)]
        step = "all" if score.step < 0 else str(score.step + 1)
        table.append([step, str(score.rows), *shares, f"{score.shortfall:.4g}"])
    lines = ["choices on held-out rows:", *(f"  {line}" for line in aligned(table, left=0))]
    if trees:
        count = len(next(iter(trees.values())))
        lines += [
            "",
            f"utility on {count} held-out trees, mean of both roles (standard error over trees):",
        ]
        table = [
            [
                "strategy",
                "lost to a best response",
                "lost to equilibrium",
                "off in self-play",
                "against random",
            ]
        ]
        for name, scores in trees.items():
            error = (
                scores.std(axis=0, ddof=1) / np.sqrt(count)
                if count > 1
                else np.full(scores.shape[1], np.nan)
            )
            table.append(
                [
                    name,
                    *(
                        f"{m:.3f} ({e:.3f})"
                        for m, e in zip(scores.mean(axis=0), error, strict=True)
                    ),
                ]
            )
        lines += [f"  {line}" for line in aligned(table, left=1)]
    return "\n".join(lines)
