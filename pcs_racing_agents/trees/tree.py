"""Game tree of one start: all races that the players' moves can lead to, as plain arrays.

Moves of an archive often lead to the same policy, and a race depends only on policies, not on the
names of the moves. So two histories of moves that pass through the same policies (a *path*) are one
race, which is driven once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats, Indices
from pcs_racing.game.observation import encode_observation

MAX_LEAVES = 10_000_000


class PolicyPaths(NamedTuple):
    """Different policy paths of one player, level by level; ``U_k`` paths after ``k`` moves."""

    policy: tuple[Indices, ...]  #: shape (U_k,): Policy at the end of each path.
    parent: tuple[Indices, ...]  #: shape (U_k,): Parent path, in the level above.
    #: shape (A**k,): Path of each history of the player's own moves; histories in row-major order,
    #: first move first.
    history: tuple[Indices, ...]

    def count(self, level: int) -> int:
        """Return the number of different paths after ``level`` moves."""
        return len(self.policy[level])


def policy_paths(table: Indices, start: int, moves: int) -> PolicyPaths:
    """Follow all sequences of ``moves`` moves from a policy.

    ``table``, shape (K, A), holds the policy that each move leads to from every policy.
    """
    policy, parent = [np.array([start], np.int64)], [np.zeros(1, np.int64)]
    history = [np.zeros(1, np.int64)]
    policies, options = table.shape
    for _ in range(moves):
        # A path is identified by the number of its parent and by the policy that the move leads to.
        reached = np.arange(len(policy[-1]))[:, None] * policies + table[policy[-1]]
        different, which = np.unique(reached, return_inverse=True)
        parent.append(different // policies)
        policy.append(different % policies)
        history.append(which.reshape(-1, options)[history[-1]].reshape(-1))
    return PolicyPaths(tuple(policy), tuple(parent), tuple(history))


def own_histories(level: int, options: int) -> tuple[Indices, Indices]:
    """Return each player's own history in every joint history of a level, shapes (A**(2 level),).

    Joint histories are in row-major order of (move of car 0, move of car 1), first step first; own
    histories in row-major order of the own moves.
    """
    first = second = np.zeros(1, np.int64)
    moves = np.arange(options)
    for _ in range(level):
        first = (first[:, None] * options + np.repeat(moves, options)).reshape(-1)
        second = (second[:, None] * options + np.tile(moves, options)).reshape(-1)
    return first, second


def check_size(options: int, moves: int) -> None:
    """Check that a tree is not too large."""
    leaves = options ** (2 * moves)
    if leaves > MAX_LEAVES:
        raise InputError(
            f"a tree of {moves} moves with {options} choices for each player has {leaves:.3g}"
            f" leaves; at most {MAX_LEAVES:,} are possible: play fewer moves, or fewer step sizes"
        )


if TYPE_CHECKING:
    from pcs_racing_agents.solvers import GameTree


class TreeStatistics(NamedTuple):
    """Cost of a tree in driven segments (all steps of the game), and savings by sharing."""

    seeds: int  #: Noise seeds of the root; all counts below are sums over them.
    driven: int  #: Driven segments.
    #: Segments of different policy paths, without segments after a crash: all are driven if no two
    #: cars are too far apart to see each other.
    live: int
    #: Segments of a tree whose branches share only their beginnings: one for each joint history of
    #: moves.
    shared: int
    replayed: int  #: Segments if every joint history of all moves were driven from the start.
    crashed: float  #: Share of the joint histories of all moves that end in a crash.
    #: Share of the joint histories of all moves that pass through the same policies as an already
    #: counted history.
    duplicates: float


@dataclass(frozen=True, eq=False)
class RaceTree:
    """Tree of all moves in one game from one start.

    It is stored by policy paths (:mod:`pcs_racing_agents.trees.tree`): ``U0_k`` and ``U1_k``
    different paths of the two players after ``k`` moves. The properties ``payoffs``, ``leads``,
    ``estimates``, ``over`` and ``policy`` expand it to all joint histories of moves,
    ``N_k = (A * A)**k`` histories after ``k`` moves. The children of history ``j`` are
    ``j * A * A + a0 * A + a1`` for moves ``a0`` of car 0 and ``a1`` of car 1.

    With steering noise the same moves end differently for each noise seed. Seeds share their
    information sets: the players see the history, but not the seed.
    """

    policies: Indices  #: shape (2,): Starting policies of the cars.
    start_s: float  #: Arc length of the start line, m.
    side: int  #: Side of car 0: 0 on the left or in front.
    #: shape (S,): Keys of the games: ``RaceGame.reset(seeds, policies=..., starts=...)`` starts the
    #: same games.
    seeds: NDArray[np.uint64]
    handicaps: Floats  #: shape (S, 2): Handicaps of the cars.
    table: Indices  #: shape (K, A): Policy that every move leads to from every policy.
    points: Floats  #: shape (K, G): Normalised coordinates of the policies as the players see them.
    #: shape (S, U0_m, U1_m): Payoffs to car 0; the payoffs to car 1 are their negatives.
    path_payoffs: NDArray[np.float32]
    #: shape (S, U0_k, U1_k): Lead of car 0 at the end of step ``k``, m, for ``k`` below ``m``; 0
    #: where the race was over before.
    path_leads: tuple[Floats, ...]
    #: shape (S, U0_k, U1_k, 2, G): Normalised coordinates of each car as measured in step ``k``; 0
    #: where the race was over before.
    path_estimates: tuple[NDArray[np.float32], ...]
    #: shape (S, U0_k, U1_k): True if the race had ended in a crash before move ``k``.
    path_over: tuple[NDArray[np.bool_], ...]
    #: shape (S,): ``driven``, ``live``, ``crashed``: Numbers behind :attr:`statistics`; ``crashed``
    #: counts joint histories of all moves.
    driven: Indices
    live: Indices
    crashed: Indices

    def __repr__(self) -> str:
        """Show the start, and the numbers of moves and seeds."""
        first, second = self.policies
        return (
            f"<RaceTree: policies {first} and {second} from {self.start_s:.2f} m, side {self.side},"
            f" {self.moves} moves of {self.options}, {len(self.seeds)} seeds>"
        )

    @property
    def moves(self) -> int:
        """Number of moves of each player, m."""
        return len(self.path_leads)

    @property
    def options(self) -> int:
        """Number of choices at each move, A."""
        return self.table.shape[1]

    @cached_property
    def paths(self) -> tuple[PolicyPaths, PolicyPaths]:
        """Policy paths of each player."""
        first, second = (
            policy_paths(self.table, int(start), self.moves) for start in self.policies
        )
        return first, second

    def where(self, level: int) -> tuple[Indices, Indices]:
        """Return the two players' policy paths in every joint history of a level, shapes (N_k,)."""
        own = own_histories(level, self.options)
        first, second = (
            paths.history[level][mine] for paths, mine in zip(self.paths, own, strict=True)
        )
        return first, second

    @cached_property
    def payoffs(self) -> NDArray[np.float32]:
        """Payoffs to car 0, shape (S, N_m)."""
        return self._spread(self.path_payoffs, self.moves)

    @cached_property
    def leads(self) -> list[Floats]:
        """Lead of car 0 at the end of step ``k``, m; for each level an array of shape (S, N_k)."""
        return [self._spread(array, k) for k, array in enumerate(self.path_leads)]

    @cached_property
    def estimates(self) -> list[NDArray[np.float32]]:
        """Coordinates of each car as measured in step ``k``; for each level an array of shape (S,
        N_k, 2, G).
        """
        return [self._spread(array, k) for k, array in enumerate(self.path_estimates)]

    @cached_property
    def over(self) -> list[NDArray[np.bool_]]:
        """True if the race had ended before move ``k``; per level an array of shape (S, N_k)."""
        return [self._spread(array, k) for k, array in enumerate(self.path_over)]

    @cached_property
    def policy(self) -> list[Indices]:
        """Policies in use in step ``k``, crash or not; shape (N_k, 2) for each level."""
        return [
            np.stack(
                [paths.policy[k][at] for paths, at in zip(self.paths, self.where(k), strict=True)],
                axis=1,
            )
            for k in range(self.moves)
        ]

    def _spread(self, array: NDArray[Any], level: int) -> NDArray[Any]:
        first, second = self.where(level)
        return array[:, first, second]

    def observations(self, level: int) -> NDArray[np.float32]:
        """Return the players' observations before move ``level``, as in ``RaceGame.observation``.

        Returns
        -------
        ndarray, shape (S, N_k, 2, D), float32
            Observations; for a race that is over, the observation at its end.
        """
        if not 0 <= level < self.moves:
            raise InputError(
                f"move {level} is none of the tree's; it must lie in 0 to {self.moves - 1}"
            )
        branches, shape = self.options**2, self.over[level].shape
        own = np.zeros((*shape, 2, self.moves + 1, self.points.shape[1]))
        estimates = np.zeros_like(own)
        leads = np.zeros((*shape, self.moves + 1))
        step = np.full(shape, level)
        # From the last step to the first: for an ended race the earliest step after its end
        # remains.
        for k in range(level, -1, -1):
            # Ancestor of each node in level k.
            above = np.repeat(np.arange(branches**k), branches ** (level - k))
            own[:, :, :, k] = self.points[self.policy[k]][above]
            estimates[:, :, :, k] = self.estimates[k][:, above]
            leads[:, :, k] = self.leads[k][:, above]
            step[self.over[k][:, above]] = k
        flat_own, flat_estimates = (
            array.reshape(-1, *array.shape[2:]) for array in (own, estimates)
        )
        handicaps = None
        if self.handicaps.any():
            handicaps = np.repeat(self.handicaps, shape[1], axis=0)
        flat = encode_observation(
            flat_own, flat_estimates, leads.reshape(-1, self.moves + 1), step.reshape(-1), handicaps
        )
        return flat.reshape(*shape, *flat.shape[1:])

    def game_tree(self) -> "GameTree":
        """Return the tree for the solvers, with payoffs averaged over the seeds.

        The seeds share their information sets: players know the history of moves, but not the noise
        to come.
        """
        from pcs_racing_agents.solvers import GameTree

        mean = self.payoffs.mean(axis=0, dtype=np.float64)
        return GameTree.from_payoffs(mean.reshape((self.options,) * (2 * self.moves)))

    @property
    def statistics(self) -> TreeStatistics:
        """Cost of the tree in driven segments."""
        seeds, ends = len(self.seeds), (self.options**2) ** self.moves
        different = self.path_payoffs.shape[1] * self.path_payoffs.shape[2]
        return TreeStatistics(
            seeds=seeds,
            driven=int(self.driven.sum()),
            live=int(self.live.sum()),
            shared=seeds * sum((self.options**2) ** k for k in range(self.moves + 1)),
            replayed=seeds * (self.moves + 1) * ends,
            crashed=float(self.crashed.mean() / ends),
            duplicates=1.0 - different / ends,
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the tree as arrays by name, for files; :func:`tree_from_arrays` reads them."""
        plain = {name: np.asarray(getattr(self, name)) for name in _PLAIN}
        levels = {
            f"{name}_{k}": array
            for name in _LEVELS
            for k, array in enumerate(getattr(self, f"path_{name}"))
        }
        return {**plain, "payoffs": self.path_payoffs, **levels}


# Trees as arrays of files

_PLAIN = (
    *("policies", "start_s", "side", "seeds", "handicaps", "table", "points"),
    *("driven", "live", "crashed"),
)
_LEVELS = ("leads", "estimates", "over")


def _check_arrays(
    arrays: Mapping[str, NDArray[Any]],
    wanted: Mapping[str, tuple[str, tuple[int, ...]]],
    where: str,
) -> None:
    """Check arrays by name from a file of any origin.

    ``wanted``: for each name the kinds of numbers ("f", "b" or "iu", as in ``dtype.kind``) and the
    shape.
    """
    for name, (kinds, shape) in wanted.items():
        array = arrays[name]
        if array.shape != shape:
            raise InputError(f"{where}: {name} has shape {array.shape}; it must have {shape}")
        if array.dtype.kind not in kinds:
            raise InputError(
                f"{where}: {name} is of type {array.dtype}; a tree has another one there"
            )
        if not np.isfinite(array).all():
            raise InputError(
                f"{where}: {name} holds NaN or infinity; every number of a tree must be finite"
            )


def tree_from_arrays(arrays: Mapping[str, NDArray[Any]], moves: int, where: str) -> RaceTree:
    """Return the tree of the arrays of :meth:`RaceTree.arrays`."""
    names = [*_PLAIN, "payoffs", *(f"{name}_{k}" for name in _LEVELS for k in range(moves))]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise InputError(f"{where} is no tree of {moves} moves: it holds no {missing[0]}")
    seeds, table, points = (arrays[name].shape for name in ("seeds", "table", "points"))
    fits = (len(seeds), len(table), len(points)) == (1, 2, 2) and table[0] == points[0]
    if not fits or 0 in (*seeds, *table, *points):
        raise InputError(
            f"{where}: seeds, table and points have shapes {seeds}, {table} and {points}; they do"
            " not fit"
        )
    whole: dict[str, tuple[str, tuple[int, ...]]] = dict.fromkeys(
        ("seeds", "driven", "live", "crashed"), ("iu", seeds)
    )
    whole |= {
        "policies": ("iu", (2,)),
        "start_s": ("f", ()),
        "side": ("iu", ()),
        "handicaps": ("f", (*seeds, 2)),
        "table": ("iu", table),
    }
    _check_arrays(arrays, whole | {"points": ("f", points)}, where)
    check_size(table[1], moves)
    for name in ("table", "policies"):
        if (arrays[name] < 0).any() or (arrays[name] >= table[0]).any():
            raise InputError(f"{where} names a policy that it does not hold; there are {table[0]}")
    levels: dict[str, Any] = {
        f"path_{name}": tuple(arrays[f"{name}_{k}"] for k in range(moves)) for name in _LEVELS
    }
    plain: dict[str, Any] = {name: arrays[name] for name in _PLAIN}
    plain.update(start_s=float(plain["start_s"]), side=int(plain["side"]))
    tree = RaceTree(path_payoffs=arrays["payoffs"], **plain, **levels)
    # The number of paths of a level follows from the table: the shapes of its arrays are known only
    # here.
    count = [(*seeds, *(paths.count(k) for paths in tree.paths)) for k in range(moves + 1)]
    of_levels: dict[str, tuple[str, tuple[int, ...]]] = {"payoffs": ("f", count[moves])}
    for k in range(moves):
        of_levels[f"leads_{k}"] = ("f", count[k])
        of_levels[f"estimates_{k}"] = ("f", (*count[k], 2, points[1]))
        of_levels[f"over_{k}"] = ("b", count[k])
    _check_arrays(arrays, of_levels, where)
    return tree
