"""Targets of networks: for every node of a solved tree and every player, a number for each move.

The targets differ in what they assume of the opponent and in how they compare nodes:

- cumulative regrets are the paper's target; they shrink with the opponent's probability of coming to a node, so that
  nodes which it avoids hardly count;
- normalised regrets have the same size at every node;
- equilibrium advantages ask the exact solution instead of CFR;
- "static" values play best against an opponent that does not look at the race;
- and "nash" is no value but the equilibrium strategy itself.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.solvers import CFRResult, ExactResult, GameTree, best_response, cfr, solve_exact

Floats = NDArray[np.float64]
Solution = CFRResult | ExactResult
"""What :func:`solve_for` returns."""


class Target(NamedTuple):
    """A kind of target."""

    meaning: str
    clipped: bool  #: Whether values below 0 are learned and shown as 0.
    solver: str  #: What it is made from: "cfr" or "exact".


TARGETS = {
    "regret": Target("cumulative counterfactual regret, clipped at 0 (the paper)", True, "cfr"),
    "normalised": Target("cumulative regret, divided by its largest magnitude at the node: -1 to 1", False, "cfr"),
    "advantage": Target("gain or loss of a move against the equilibrium, if both follow it afterwards", False, "exact"),
    "static-q": Target("utility of a move followed by best play, against a static opponent", False, "exact"),
    "nash": Target("probability of the move in an equilibrium, from which the agent draws", False, "exact"),
}
"""Kinds of targets that trees give."""

OPPONENTS = {
    "fixed-sequence": "moves by a sequence drawn uniformly beforehand, of which only the past is seen",
    "never-switch": "stays with its policy; only where 'stay' is a move",
}
"""Static opponents of the target "static-q"."""

ROW_WEIGHTS = {
    "uniform": "every node counts the same, so that the last step makes up nearly everything",
    "random": "as often as random moves lead there: every step counts the same",
    "reach": "as often as play leads there in which both follow the solution or a random move, evenly at each step",
}
"""How much the nodes of a tree count."""


def get_target(name: str) -> Target:
    """Return a kind of target by name."""
    if name not in TARGETS:
        raise UnknownNameError(f"unknown target {name!r}; trees give {', '.join(TARGETS)}")
    return TARGETS[name]


def best_moves(targets: NDArray[np.floating], mask: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Which moves have the highest target of their row, shape (R, A); equal up to rounding counts as highest."""
    values = np.asarray(targets, np.float64)
    if mask is not None:
        values = np.where(mask, values, -np.inf)
    highest = values.max(axis=-1, keepdims=True)
    return values >= highest - 1e-6 * np.maximum(np.abs(highest), 1.0)


def solve_for(tree: GameTree, target: str, *, iterations: int = 1000, variant: str = "vanilla") -> Solution:
    """Solve a tree with the solver of a target.

    Parameters
    ----------
    iterations, variant
        Of CFR, if the target is made of regrets.
    """
    if get_target(target).solver == "cfr":
        return cfr(tree, iterations, variant=variant)
    return solve_exact(tree)


def node_targets(
    tree: GameTree, solution: Solution, target: str, *, opponent: str = "fixed-sequence", stay: int | None = None
) -> list[tuple[Floats, Floats]]:
    """Return the targets of all infosets.

    Parameters
    ----------
    solution : CFRResult or ExactResult
        What :func:`solve_for` returned for the tree and target.
    opponent : str
        For "static-q": one of :data:`OPPONENTS`.
    stay : int, optional
        Index of the move "stay", where there is one.

    Returns
    -------
    list of (ndarray, ndarray)
        For each level those of car 0, shape (rows, A), and car 1, shape (rows, B), each from its own point of view and
        never clipped; NaN in rows about which the solution says nothing (CFR that never came there).
    """
    kind = get_target(target)
    wanted = CFRResult if kind.solver == "cfr" else ExactResult
    if not isinstance(solution, wanted):
        raise InputError(f"target {target!r} needs a {wanted.__name__}; the solution is a {type(solution).__name__}")
    if isinstance(solution, CFRResult):
        if target == "regret":
            return list(solution.regrets)
        return [
            (_normalised(r0, reach0), _normalised(r1, reach1))
            for (r0, r1), (reach0, reach1) in zip(solution.regrets, solution.opponent_reach, strict=True)
        ]
    if target == "advantage":
        return list(solution.advantages)
    if target == "nash":
        return list(solution.profile)
    profile = _static_profile(tree, opponent, stay)
    q = [best_response(tree, profile, player).q for player in (0, 1)]
    return list(zip(*q, strict=True))


def _static_profile(tree: GameTree, opponent: str, stay: int | None) -> list[tuple[Floats, Floats]]:
    """Return the profile of two static opponents."""
    if opponent not in OPPONENTS:
        raise UnknownNameError(f"unknown static opponent {opponent!r}; there are {', '.join(OPPONENTS)}")
    if opponent == "never-switch" and stay is None:
        raise InputError("opponent 'never-switch' needs trees with the move 'stay'; take 'fixed-sequence'")
    profile = []
    for k, moves in enumerate(tree.moves):
        both = []
        for player, count in enumerate(moves):
            play = np.full(count, 1.0 / count) if opponent == "fixed-sequence" else np.eye(count)[stay]
            both.append(np.tile(play, (tree.rows(k, player), 1)))
        profile.append((both[0], both[1]))
    return profile


def _normalised(regrets: Floats, reach: Floats) -> Floats:
    """Return rows divided by their largest magnitude: 0 where all regrets are, NaN where the opponent never came."""
    size = np.abs(regrets).max(axis=1, keepdims=True)
    return np.where(reach[:, None] > 0.0, regrets / np.where(size > 0.0, size, 1.0), np.nan)
