"""Trees as Gambit's extensive form files (.efg), and as games of OpenSpiel.

OpenSpiel and Gambit read such files. :func:`efg_game` passes a tree to OpenSpiel's C++ as a text of
this form; algorithms in Python take that game, too.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.solvers.evaluation import Profile, check_profile
from pcs_racing_agents.solvers.game_tree import GameTree

MAX_LEAVES = 2_000_000


def write_efg(
    tree: GameTree,
    path: str | os.PathLike[str],
    *,
    title: str = "pcs-racing",
    move_names: Sequence[tuple[Sequence[str], Sequence[str]]] | None = None,
) -> Path:
    """Write :func:`efg_text` to a file with the suffix ``.efg``, entirely or not at all."""
    target = Path(path)
    if target.suffix != ".efg":
        raise InputError(f"can't write {target}: its name must end in .efg")
    text = efg_text(tree, title=title, move_names=move_names)
    write_atomically(target, text)
    return target


def efg_text(
    tree: GameTree,
    *,
    title: str = "pcs-racing",
    move_names: Sequence[tuple[Sequence[str], Sequence[str]]] | None = None,
) -> str:
    """Return a tree in Gambit's format: at every node car 0 moves, then car 1 without observing it.

    A player with a single move has no node there. An infoset has the name ``level:row``.
    Chance that no player observes is left out: the payoffs are then expected payoffs.

    Parameters
    ----------
    move_names : sequence of (sequence of str, sequence of str), optional
        Names of the moves of each car at each level; ``0``, ``1``, ... by default.
    """
    tree = tree.averaged
    if tree.payoffs.size > MAX_LEAVES:
        raise InputError(
            f"the tree has {tree.payoffs.size} leaves; as text, {MAX_LEAVES} are the max"
        )
    names = move_names if move_names is not None else [(range(a), range(b)) for a, b in tree.moves]
    if [(len(first), len(second)) for first, second in names] != list(tree.moves):
        raise InputError(
            f"the names of the moves do not fit the tree, whose moves are {list(tree.moves)}"
        )
    quoted = [[_quoted(str(name)) for name in player] for pair in names for player in pair]
    if any(len(set(player)) < len(player) for player in quoted):
        raise InputError("two moves of a player bear the same name")
    head = f'EFG 2 R {_quoted(title)} {{ "car_0" "car_1" }}\n'
    actions = [f"{{ {' '.join(player)} }}" for player in quoted]
    return head + "\n".join(_lines(tree, actions)) + "\n"


def _lines(tree: GameTree, actions: list[str]) -> Iterator[str]:
    """Yield all nodes, each before its children."""
    m = tree.depth
    counted = [
        [tree.rows(k, player) * (tree.moves[k][player] > 1) for player in (0, 1)] for k in range(m)
    ]
    # OpenSpiel requires numbers of infosets without gaps.
    numbers = np.cumsum([[0, 0], *counted], axis=0)
    rows = [(first.tolist(), second.tolist()) for first, second in tree.infosets]
    leaves = [_decimal(value) for value in tree.payoffs.reshape(-1).tolist()]

    def decision(k: int, player: int, node: int) -> str:
        row = rows[k][player][node]
        number = int(numbers[k, player]) + row + 1
        return f'p "" {player + 1} {number} "{k}:{row}" {actions[2 * k + player]} 0'

    def below(k: int, node: int) -> Iterator[str]:
        if k == m:
            payoff = leaves[node]
            other = payoff[1:] if payoff.startswith("-") else f"-{payoff}"
            yield f't "" {node + 1} "" {{ {payoff} {other} }}'
            return
        first, second = tree.moves[k]
        if first > 1:
            yield decision(k, 0, node)
        for a in range(first):
            if second > 1:
                yield decision(k, 1, node)
            for b in range(second):
                yield from below(k + 1, (node * first + a) * second + b)

    if tree.roots > 1:
        outcomes = " ".join(f'"{i}" {share}' for i, share in enumerate(_shares(tree)))
        yield f'c "" 1 "chance" {{ {outcomes} }} 0'
    for root in range(tree.roots):
        yield from below(0, root)


def _decimal(value: float) -> str:
    """Return all digits of a number, never with an exponent."""
    return np.format_float_positional(value + 0.0, trim="0")


def _shares(tree: GameTree) -> list[str]:
    """Return probabilities with a sum of exactly 1, as Gambit requires."""
    if (tree.chance == tree.chance[0]).all():
        return [f"1/{tree.roots}"] * tree.roots
    context = Context(prec=17, rounding=ROUND_HALF_EVEN)
    shares = [
        context.create_decimal_from_float(p).quantize(Decimal("1e-17"))
        for p in tree.chance.tolist()
    ]
    # The remainder of rounding goes to the max share, with the min relative change.
    shares[int(tree.chance.argmax())] += 1 - sum(shares)
    return [f"{share:f}" for share in shares]


def _quoted(text: str) -> str:
    if '"' in text or "\n" in text or "\\" in text:
        raise InputError(f"{text!r} can't be a name: it holds a quote, backslash or line break")
    return f'"{text}"'


# OpenSpiel


def efg_game(tree: GameTree) -> Any:
    """Return a tree as a game of OpenSpiel's C++ (``pyspiel.load_efg_game``).

    Car 0 moves first; car 1 does not observe its move.
    """
    try:
        import pyspiel
    except ModuleNotFoundError:
        raise ModuleNotFoundError('this needs OpenSpiel: pip install "pcs-racing[games]"') from None
    return pyspiel.load_efg_game(efg_text(tree))


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
