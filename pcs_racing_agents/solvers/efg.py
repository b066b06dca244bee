"""Trees as Gambit's extensive form files (.efg), which OpenSpiel and Gambit read."""

import os
from collections.abc import Iterator, Sequence
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing_agents.solvers.game_tree import GameTree

MOST_LEAVES = 2_000_000


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
    write_atomically(target, lambda file: file.write(text.encode()))
    return target


def efg_text(
    tree: GameTree,
    *,
    title: str = "pcs-racing",
    move_names: Sequence[tuple[Sequence[str], Sequence[str]]] | None = None,
) -> str:
    """Return a tree in Gambit's format: at every node car 0 moves, then car 1 without observing it.

    A player with a single move has no node there. Infosets are named by :func:`infoset_name`.
    Chance that no player observes is left out: the payoffs are then expected payoffs.

    Parameters
    ----------
    move_names : sequence of (sequence of str, sequence of str), optional
        Names of the moves of each car at each level; ``0``, ``1``, ... by default.
    """
    tree = tree.averaged
    if tree.payoffs.size > MOST_LEAVES:
        raise InputError(
            f"the tree has {tree.payoffs.size} leaves; as text, {MOST_LEAVES} are the most"
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


def infoset_name(level: int, row: int) -> str:
    """Return the name of an infoset in the file: its level, and its row in a strategy."""
    return f"{level}:{row}"


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
        return f'p "" {player + 1} {number} "{infoset_name(k, row)}" {actions[2 * k + player]} 0'

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
