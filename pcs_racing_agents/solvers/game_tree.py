"""Game tree as dense arrays: simultaneous moves, level by level, with payoffs at the leaves.

All nodes of a level are in one array, in row-major order of their history. So every algorithm on
the tree is a few array operations per level, and a strategy is one array per level and player.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats

Integers = NDArray[np.int64]

CHANCE_TOLERANCE = 1e-9
MAX_PAYOFF = 1e100  # max payoff: sums and products stay finite


@dataclass(frozen=True, eq=False)
class GameTree:
    """A two-player zero-sum game of ``m`` simultaneous moves each; make it with
    :meth:`from_payoffs`.

    Level ``k`` (0 to m - 1) has ``roots * N_k`` nodes, one for each outcome of chance and each
    joint history; child ``(a, b)`` of node ``j`` is node ``(j * A_k + a) * B_k + b`` of the next
    level. A player can not distinguish the nodes of one *information set* (infoset), so its
    strategy is an array with a row per infoset.
    """

    #: shape (roots, leaves): Payoff of each leaf to car 0; car 1 gets minus the payoff. Read-only.
    payoffs: Floats
    #: Numbers of moves ``(A_k, B_k)`` of car 0 and car 1 at each level.
    moves: tuple[tuple[int, int], ...]
    chance: Floats  #: shape (roots,): Probability of each root.
    #: Row of every node for each level and player, shape (roots * N_k,). Infosets are numbered in
    #: the order of their first nodes.
    infosets: tuple[tuple[Integers, Integers], ...]

    @classmethod
    def from_payoffs(cls, payoffs: ArrayLike, chance: ArrayLike | None = None) -> "GameTree":
        """Make a tree with all past moves observed by both players.

        Parameters
        ----------
        payoffs : array, shape (A_0, B_0, A_1, B_1, ...)
            Payoff to car 0 for each sequence of moves, in the order car 0, car 1, car 0, ... With
            ``chance``, the first axis is its outcome: (S, A_0, B_0, ...).
        chance : array, shape (S,), optional
            Probabilities of outcomes (such as seeds of the noise) that no player observes; they are
            at least 0 and sum up to 1. See :meth:`with_infosets` for outcomes that a player
            observes.
        """
        table = _real(payoffs, "payoffs")
        if chance is None:
            table = table[None]
        weights = np.ones(1) if chance is None else _real(chance, "chance")
        if table.ndim < 3 or table.ndim % 2 == 0 or 0 in table.shape:
            raise InputError(
                f"payoffs have shape {np.shape(payoffs)}; they need an axis for each move, car 0"
                f" and car 1 alternately{'' if chance is None else ', after one for chance'}, and"
                " none may be empty"
            )
        if weights.shape != table.shape[:1]:
            raise InputError(
                f"chance has shape {weights.shape}; payoffs of {len(table)} roots need"
                f" ({len(table)},)"
            )
        wrong = np.argwhere(~(np.abs(table) <= MAX_PAYOFF))
        if len(wrong):
            place = tuple(int(i) for i in wrong[0][0 if chance is not None else 1 :])
            raise InputError(
                f"payoff {place} is {table[tuple(wrong[0])]}; it must lie within +-{MAX_PAYOFF:g}"
            )
        if not (weights >= 0.0).all() or abs(weights.sum() - 1.0) > CHANCE_TOLERANCE:
            raise InputError(
                f"chance is {weights.tolist()}; probabilities are at least 0 and sum up to 1"
            )
        roots, moves = len(table), tuple(zip(table.shape[1::2], table.shape[2::2], strict=True))
        histories = [int(np.prod(table.shape[1 : 2 * k + 1])) for k in range(len(moves))]
        # The same joint history is the same infoset for every outcome of chance: no player observes
        # it.
        rows = [np.tile(np.arange(count), roots) for count in histories]
        flat = np.array(table.reshape(roots, -1), order="C")
        return cls(
            _fixed(flat),
            moves,
            _fixed(weights / weights.sum()),
            tuple((_fixed(r), _fixed(r)) for r in rows),
        )

    def with_infosets(self, labels: Sequence[tuple[ArrayLike, ArrayLike]]) -> "GameTree":
        """Return the tree with other infosets: a player can not distinguish nodes of equal label.

        ``labels``: for each level, the label of every node for car 0 and for car 1, whole numbers
        of shape (roots * N_k,) or (roots, N_k).
        """
        self._check_levels(labels, "labels")
        infosets: list[tuple[Integers, Integers]] = []
        for k, pair in enumerate(labels):
            rows = []
            for player in (0, 1):
                array = np.asarray(pair[player])
                if (
                    array.dtype.kind not in "iub"
                    or array.size != self.nodes(k)
                    or array.ndim not in (1, 2)
                ):
                    raise InputError(
                        f"labels of level {k}, car {player} have shape {array.shape} and type"
                        f" {array.dtype}; they must be {self.nodes(k)} whole numbers, one for each"
                        " node"
                    )
                rows.append(_numbered(array.reshape(-1)))
                if k:
                    self._check_recall(
                        k, player, rows[player], self._past(k, player, infosets[k - 1][player])
                    )
            infosets.append((rows[0], rows[1]))
        return replace(self, infosets=tuple(infosets))

    def __copy__(self) -> "GameTree":
        """Return the tree itself: it never changes."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "GameTree":
        """Return the tree itself: it never changes."""
        return self

    # Sizes

    @property
    def depth(self) -> int:
        """Number of moves of each player, m."""
        return len(self.moves)

    @property
    def roots(self) -> int:
        """Number of outcomes of chance."""
        return len(self.chance)

    def nodes(self, level: int) -> int:
        """Return the number of nodes of a level; level m are the leaves."""
        return self.roots * int(np.prod([a * b for a, b in self.moves[:level]], dtype=np.int64))

    def rows(self, level: int, player: int) -> int:
        """Return the number of a player's infosets at a level: the rows of its strategy."""
        return self._row_counts[level][player]

    @cached_property
    def _row_counts(self) -> list[tuple[int, int]]:
        return [(int(first.max()) + 1, int(second.max()) + 1) for first, second in self.infosets]

    # Properties

    @cached_property
    def perfect(self) -> bool:
        """True if every infoset holds one node.

        Both players then observe everything except the other player's simultaneous move.
        """
        return all(
            self.rows(k, player) == self.nodes(k) for k in range(self.depth) for player in (0, 1)
        )

    @cached_property
    def hides_chance(self) -> bool:
        """True if both players observe all past moves and nothing of chance.

        Their infosets are then the joint histories.
        """
        return all(
            np.array_equal(rows, np.tile(np.arange(self.nodes(k) // self.roots), self.roots))
            for k, pair in enumerate(self.infosets)
            for rows in pair
        )

    @cached_property
    def averaged(self) -> "GameTree":
        """Tree with expected payoffs, if chance is hidden; else the tree itself.

        Profiles keep their rows.
        """
        if self.roots == 1 or not self.hides_chance:
            return self
        shape = [size for pair in self.moves for size in pair]
        return GameTree.from_payoffs(
            np.einsum("r,r...->...", self.chance, self.payoffs).reshape(shape)
        )

    # Checks

    def _check_levels(self, pairs: Sequence[tuple[ArrayLike, ArrayLike]], name: str) -> None:
        if len(pairs) != self.depth or any(len(pair) != 2 for pair in pairs):
            raise InputError(
                f"{name} must be {self.depth} pairs, one for each level: of car 0 and of car 1"
            )

    def _past(self, level: int, player: int, before: Integers) -> Integers:
        """Return a number per node for the player's infoset and own move one level up."""
        a, b = self.moves[level - 1]
        child = np.arange(self.nodes(level))
        own = (child // b) % a if player == 0 else child % b
        return before[child // (a * b)] * (a, b)[player] + own

    def _check_recall(self, level: int, player: int, rows: Integers, past: Integers) -> None:
        representative = past[np.unique(rows, return_index=True)[1]]
        mixed = np.flatnonzero(representative[rows] != past)
        if len(mixed):
            raise InputError(
                f"labels of level {level}, car {player}: node {int(mixed[0])} shares its label with"
                " a node that the car reaches otherwise; labels need perfect recall"
            )


def _numbered(labels: Integers) -> Integers:
    """Return labels replaced by 0, 1, 2, ... in the order of their first occurrence."""
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return _fixed(order[place])


def _real(values: ArrayLike, name: str) -> Floats:
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{name} do not form an array: their rows differ in length") from None
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name} have type {array.dtype}; they must be real numbers")
    return array.astype(np.float64)


def _fixed(array: Any) -> Any:
    array.flags.writeable = False
    return array
