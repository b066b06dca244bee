"""Conversion of trees to games of OpenSpiel, and of strategies in both directions.

Two roads: :func:`efg_game` hands the tree to OpenSpiel's C++ as an extensive form file, which is fast;
:func:`python_game` makes a simultaneous-move game in Python with names, information states and tensors, which is what
learning algorithms want.
"""

import functools
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.efg import efg_text
from pcs_racing_agents.solvers.evaluation import Profile, check_profile
from pcs_racing_agents.solvers.game_tree import GameTree

GAME_NAME = "python_pcs_racing_tree"
"""Short name of the game in OpenSpiel; its parameter ``tree`` is a name given to :func:`register_tree`."""

EXAMPLE = "example"
EXAMPLE_SEED = 5

Tensors = Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]

_trees: dict[str, tuple[GameTree, Tensors | None]] = {}


def efg_game(tree: GameTree) -> Any:
    """Return a tree as a game of OpenSpiel's C++ (``pyspiel.load_efg_game``): car 0 moves first, unseen by car 1."""
    return _pyspiel().load_efg_game(efg_text(tree))


def efg_policy(tree: GameTree, profile: Profile) -> dict[str, list[tuple[int, float]]]:
    """Return a profile as OpenSpiel's functions take it for :func:`efg_game`: information state to (move, share)."""
    game = tree.averaged
    keys = _efg_keys(game)
    policy = {}
    for k, pair in enumerate(check_profile(tree, profile)):
        for player in (0, 1):
            for row, shares in enumerate(pair[player].tolist()):
                if (player, k, row) in keys:
                    policy[keys[player, k, row]] = list(enumerate(shares))
    return policy


def efg_profile(tree: GameTree, policy: Mapping[str, Sequence[tuple[int, float]]]) -> Profile:
    """Return a tabular policy of :func:`efg_game` (``policy.policy_table()``, say) as a profile."""
    game = tree.averaged
    keys = _efg_keys(game)
    profile = []
    for k, moves in enumerate(game.moves):
        pair = []
        for player in (0, 1):
            strategy = np.zeros((game.rows(k, player), moves[player]))
            for row in range(len(strategy)):
                key = keys.get((player, k, row))
                if key is None:
                    strategy[row] = 1.0
                    continue
                if key not in policy:
                    raise InputError(f"the policy lacks the information state {key!r} of car {player}, level {k}")
                for move, share in policy[key]:
                    strategy[row, move] = share
            pair.append(strategy)
        profile.append((pair[0], pair[1]))
    return profile


def _efg_keys(game: GameTree) -> dict[tuple[int, int, int], str]:
    """OpenSpiel's string for each (player, level, row) that has a decision."""
    keys, numbers = {}, [0, 0]
    for k, moves in enumerate(game.moves):
        for player in (0, 1):
            if moves[player] > 1:
                for row in range(game.rows(k, player)):
                    numbers[player] += 1
                    keys[player, k, row] = f"{player}-{player}-{numbers[player]}-{k}:{row}"
    return keys


def python_game(tree: GameTree, observations: Tensors | None = None) -> Any:
    """Return a tree as a Python game of OpenSpiel with simultaneous moves.

    Algorithms for sequential games take ``pyspiel.convert_to_turn_based(game)``.

    Parameters
    ----------
    tree : GameTree
        Chance that no player sees is averaged out.
    observations : sequence of (ndarray, ndarray), optional
        What the two cars see at each of their infosets, shapes (rows, D), for the tensors. By default a tensor is made
        of the step, the player and, for each past step, the own move and what was seen: the other's move, or the
        number of the infoset in binary where past moves are not all seen.
    """
    digest = hashlib.sha256(repr(tree.moves).encode())
    arrays: list[NDArray[Any]] = [tree.payoffs, tree.chance, *(rows for pair in tree.infosets for rows in pair)]
    for array in [*arrays, *(array for pair in observations or () for array in pair)]:
        digest.update(np.ascontiguousarray(array).tobytes())
    name = digest.hexdigest()[:16]
    register_tree(name, tree, observations)
    register_game()
    return _pyspiel().load_game(GAME_NAME, {"tree": name})


def register_tree(name: str, tree: GameTree, observations: Tensors | None = None) -> None:
    """Let ``pyspiel.load_game(GAME_NAME, {"tree": name})`` find a tree."""
    game = tree.averaged
    if observations is not None:
        shapes = [[np.shape(array) for array in pair] for pair in observations]
        sizes = {shape[-1] for pair in shapes for shape in pair if len(shape) == 2}
        rows = [[(game.rows(k, player),) for player in (0, 1)] for k in range(game.depth)]
        if [[shape[:-1] for shape in pair] for pair in shapes] != rows or len(sizes) != 1:
            raise InputError(
                f"observations have shapes {shapes}; each pair needs a row for every infoset of its level, {rows}, and "
                "all rows the same length"
            )
    _trees[name] = (game, observations)


@functools.cache
def register_game() -> None:
    """Make the game known to OpenSpiel as :data:`GAME_NAME`; without parameters it is a small example."""
    _pyspiel()
    from pcs_racing_agents.solvers.openspiel_game import register

    rng = np.random.default_rng(EXAMPLE_SEED)
    register_tree(EXAMPLE, GameTree.from_payoffs(rng.uniform(-1.0, 1.0, (2, 2, 2, 2))))
    register(GAME_NAME, EXAMPLE, _tree)


def _tree(name: str) -> tuple[GameTree, Tensors | None]:
    if name not in _trees:
        raise InputError(f"no tree is registered as {name!r}; call register_tree first")
    return _trees[name]


def _pyspiel() -> Any:
    try:
        import pyspiel
    except ModuleNotFoundError:
        raise ModuleNotFoundError('this needs OpenSpiel: pip install "pcs-racing[games]"') from None
    return pyspiel
