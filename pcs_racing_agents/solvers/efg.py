"""Trees as Gambit's extensive form files (.efg), which OpenSpiel and Gambit read."""

import os
from collections.abc import Iterator, Sequence
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
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
    write_atomically(target, efg_text(tree, title=title, move_names=move_names))
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
    if [(len(set(first)), len(set(second))) for first, second in names] != list(tree.moves):
        raise InputError(
            f"the names of the moves must differ and fit the tree, whose moves are {tree.moves}"
        )
    actions = [[" ".join(map(_quoted, player)) for player in pair] for pair in names]
    head = f'EFG 2 R {_quoted(title)} {{ "car_0" "car_1" }}\n'
    return head + "\n".join(_lines(tree, actions)) + "\n"


def _lines(tree: GameTree, actions: list[list[str]]) -> Iterator[str]:
    """Yield all nodes, each before its children."""
    counted = [
        [tree.rows(k, player) * (tree.moves[k][player] > 1) for player in (0, 1)]
        for k in range(tree.depth)
    ]
    # OpenSpiel requires numbers of infosets without gaps.
    numbers = np.cumsum([[0, 0], *counted], axis=0)

    def decision(k: int, player: int, node: int) -> str:
        row = int(tree.infosets[k][player][node])
        number = numbers[k, player] + row + 1
        return f'p "" {player + 1} {number} "{k}:{row}" {{ {actions[k][player]} }} 0'

    def below(k: int, node: int) -> Iterator[str]:
        if k == tree.depth:
            payoff = float(tree.payoffs.flat[node]) + 0.0
            yield f't "" {node + 1} "" {{ {_decimal(payoff)} {_decimal(-payoff)} }}'
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
    return np.format_float_positional(value, trim="0")


def _shares(tree: GameTree) -> list[str]:
    """Return probabilities with a sum of exactly 1, as Gambit requires."""
    context = Context(prec=17, rounding=ROUND_HALF_EVEN)
    shares = [
        context.create_decimal_from_float(p).quantize(Decimal("1e-17"))
        for p in tree.chance.tolist()
    ]
    # The remainder of rounding goes to the max share, with the min relative change.
    shares[int(tree.chance.argmax())] += 1 - sum(shares)
    return [f"{share:f}" for share in shares]


def _quoted(name: object) -> str:
    text = str(name)
    if '"' in text or "\n" in text or "\\" in text:
        raise InputError(f"{text!r} can't be a name: it holds a quote, backslash or line break")
    return f'"{text}"'
