"""Conversion of trees to games of OpenSpiel, and of strategies in both directions.

:func:`efg_game` passes a tree to OpenSpiel's C++ as an extensive form file. Algorithms in Python
take that game, too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.efg import efg_text
from pcs_racing_agents.solvers.evaluation import Profile, check_profile
from pcs_racing_agents.solvers.game_tree import GameTree


def efg_game(tree: GameTree) -> Any:
    """Return a tree as a game of OpenSpiel's C++ (``pyspiel.load_efg_game``).

    Car 0 moves first; car 1 does not observe its move.
    """
    return _pyspiel().load_efg_game(efg_text(tree))


def efg_policy(tree: GameTree, profile: Profile) -> dict[str, list[tuple[int, float]]]:
    """Return a profile in the form of OpenSpiel's functions for :func:`efg_game`.

    The form is information state to (move, share).
    """
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
    """Return a tabular policy of :func:`efg_game` (as ``policy.policy_table()``) as a profile."""
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
                    raise InputError(
                        f"the policy lacks the information state {key!r} of car {player}, level {k}"
                    )
                for move, share in policy[key]:
                    strategy[row, move] = share
            pair.append(strategy)
        profile.append((pair[0], pair[1]))
    return profile


def _efg_keys(game: GameTree) -> dict[tuple[int, int, int], str]:
    """Return OpenSpiel's string for each (player, level, row) with a decision."""
    keys, numbers = {}, [0, 0]
    for k, moves in enumerate(game.moves):
        for player in (0, 1):
            if moves[player] > 1:
                for row in range(game.rows(k, player)):
                    numbers[player] += 1
                    keys[player, k, row] = f"{player}-{player}-{numbers[player]}-{k}:{row}"
    return keys


def _pyspiel() -> Any:
    try:
        import pyspiel
    except ModuleNotFoundError:
        raise ModuleNotFoundError('this needs OpenSpiel: pip install "pcs-racing[games]"') from None
    return pyspiel
