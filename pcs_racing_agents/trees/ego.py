"""Ego trees: all moves of one player against one sequence of moves of the other, at a fraction of a tree's cost.

A full tree tries all pairs of moves, ``A**(2 m)`` of them. An ego tree tries the ``A**m`` sequences of car 0 against a
sequence of car 1 that is drawn, and many roots are driven in one batch. As in full trees, histories that pass through
the same policies are driven once, and a crash ends its branch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_seed, check_whole, check_whole_array
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.game.reward import reward
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.trees.build import check_game
from pcs_racing_agents.trees.driving import drive_children
from pcs_racing_agents.trees.far import finish
from pcs_racing_agents.trees.paths import PolicyPaths, policy_paths
from pcs_racing_agents.trees.tree import check_arrays, encode_histories

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

OPPONENTS = {
    "random": "moves drawn for each root",
    "static": "keeps the policy that it starts with",
}
"""Opponents in car 1."""

KEEP = -1
"""In place of an opponent's move: keep the policy."""

MOST_ROOTS = 10**6
BLOCK = 64  # roots driven together: some thousand races in the last step


@dataclass(frozen=True, eq=False)
class EgoTrees:
    """R roots; after ``k`` moves ``A**k`` histories of car 0's moves each, in row-major order, first move first."""

    policies: Indices  #: shape (R, 2): Policies that the cars start with.
    #: shape (R,): Keys of the games: ``RaceGame.reset(seeds, policies=policies)`` starts the same ones.
    seeds: NDArray[np.uint64]
    replies: Indices  #: shape (R, m): Moves of car 1; -1 for none.
    #: shape (R, A**k): Number of car 0's policy path within its root, for ``k`` from 0 to m: histories of one number
    #: are one race.
    paths: tuple[Indices, ...]
    #: shape (R, A**k, G): Normalised coordinates of car 0's policy in step ``k``, for ``k`` below m.
    own: tuple[Floats, ...]
    #: shape (R, A**k): Lead of car 0 at the end of step ``k``, m; 0 where the race was over before.
    leads: tuple[Floats, ...]
    #: shape (R, A**k, 2, G): Normalised coordinates of each car as measured in step ``k``; 0 where the race was over
    #: before.
    estimates: tuple[NDArray[np.float32], ...]
    #: shape (R, A**k): Whether the race had ended in a crash when move ``k`` was due.
    over: tuple[NDArray[np.bool_], ...]
    payoffs: NDArray[np.float32]  #: shape (R, A**m): What the end is worth to car 0.
    driven: Indices  #: shape (R,): Segments that were driven.

    def __len__(self) -> int:
        return len(self.seeds)

    def __repr__(self) -> str:
        """Show the numbers of roots, moves and options."""
        return f"<EgoTrees: {len(self)} roots, {self.moves} moves of {self.options}>"

    @property
    def moves(self) -> int:
        """Moves of each player, m."""
        return self.replies.shape[1]

    @property
    def options(self) -> int:
        """Choices at each move, A."""
        return round(self.payoffs.shape[1] ** (1.0 / self.moves))

    def observations(self, level: int) -> NDArray[np.float32]:
        """Return the observations of car 0 before move ``level``, shape (R, A**level, D), float32.

        Where the race was over by then, the observation at its end.
        """
        if not 0 <= level < self.moves:
            raise InputError(f"move {level} is none of the trees'; it must lie in 0 to {self.moves - 1}")
        # Car 1's own policies are not kept: its half of the observations is not used.
        own = [np.stack([points, np.zeros_like(points)], axis=2) for points in self.own[: level + 1]]
        observations = encode_histories(level, self.options, self.moves, own, self.estimates, self.leads, self.over)
        return observations[:, :, 0]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the trees as arrays by name, for files."""
        arrays: dict[str, NDArray[Any]] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                arrays.update({f"{field.name}_{k}": array for k, array in enumerate(value)})
            else:
                arrays[field.name] = value
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], where: str) -> "EgoTrees":
        """Return the trees of arrays from :meth:`arrays`; messages of errors begin with ``where``."""
        try:
            moves = arrays["replies"].shape[1]
            values: dict[str, Any] = {
                field.name: tuple(arrays[f"{field.name}_{k}"] for k in range(moves + (field.name == "paths")))
                if field.name in ("paths", "own", "leads", "estimates", "over")
                else arrays[field.name]
                for field in fields(cls)
            }
        except (KeyError, IndexError) as error:
            raise InputError(f"{where} holds no ego trees: {error} is missing") from None
        trees = cls(**values)
        _check_shapes(trees.arrays(), moves, where)
        return trees


def _check_shapes(arrays: Mapping[str, NDArray[Any]], moves: int, where: str) -> None:
    """Raise an error unless the arrays have the shapes and types of ego trees."""
    payoffs, own = arrays["payoffs"].shape, arrays["own_0"].shape if moves else ()
    roots = len(arrays["seeds"]) if arrays["seeds"].ndim == 1 else 0
    options = round(payoffs[1] ** (1.0 / moves)) if moves and len(payoffs) == 2 else 0
    if roots == 0 or options == 0 or options**moves != payoffs[1] or len(own) != 3 or own[2] == 0:
        raise InputError(
            f"{where}: seeds of shape {arrays['seeds'].shape}, replies of {arrays['replies'].shape}, payoffs of "
            f"{payoffs} and own_0 of {own} are no ego trees"
        )
    axes = own[2]
    wanted: dict[str, tuple[str, tuple[int, ...]]] = {
        "policies": ("iu", (roots, 2)),
        "seeds": ("iu", (roots,)),
        "replies": ("iu", (roots, moves)),
        "payoffs": ("f", (roots, options**moves)),
        "driven": ("iu", (roots,)),
        f"paths_{moves}": ("iu", (roots, options**moves)),
    }
    for k in range(moves):
        level = (roots, options**k)
        wanted |= {f"paths_{k}": ("iu", level), f"leads_{k}": ("f", level), f"over_{k}": ("b", level)}
        wanted |= {f"own_{k}": ("f", (*level, axes)), f"estimates_{k}": ("f", (*level, 2, axes))}
    check_arrays(arrays, wanted, where)


def join_ego(batches: list[EgoTrees]) -> EgoTrees:
    """Return the roots of several batches as one."""
    if not batches:
        raise InputError("there are no ego trees to join; give at least one batch")
    arrays = [batch.arrays() for batch in batches]
    return EgoTrees.from_arrays(
        {key: np.concatenate([batch_arrays[key] for batch_arrays in arrays]) for key in arrays[0]}, "the batch"
    )


def play_ego(
    game: RaceGame,
    roots: int = 64,
    *,
    opponent: str | ArrayLike = "random",
    policies: ArrayLike | None = None,
    seed: int = 0,
    first: int = 0,
) -> EgoTrees:
    """Play ego trees of a game in which both cars drive policies of its archive.

    Start line, side, policies, noise and the opponent's moves of root ``i`` are functions of ``seed`` and ``i`` alone,
    drawn as :meth:`RaceGame.reset` draws them.

    Parameters
    ----------
    opponent : {"random", "static"} or array of int, shape (roots, m)
        See :data:`OPPONENTS`; or its moves, -1 to keep the policy.
    policies : array of int, shape (roots, 2) or (2,), optional
        Starting policies; drawn uniformly from the archive by default.
    first : int
        Number of the first root.
    """
    check_ego(game, roots, opponent, seed, first)
    count, options = len(game.archive), game.table.shape[1]
    # A generator for each root: it does not depend on how many others there are.
    generators = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2, first + i))) for i in range(roots)]
    pairs = np.stack([rng.integers(count, size=2) for rng in generators])
    drawn = np.stack([rng.integers(options, size=game.config.moves) for rng in generators])
    keys = np.array([rng.integers(2**64, dtype=np.uint64) for rng in generators])
    if policies is not None:
        pairs = _whole(policies, "policies", (roots, 2), 0, count)
    if isinstance(opponent, str):
        replies = drawn if opponent == "random" else np.full_like(drawn, KEEP)
    else:
        replies = _whole(opponent, "the opponent's moves", drawn.shape, KEEP, options)

    @cache
    def paths_from(policy: int) -> PolicyPaths:
        return policy_paths(game.table, policy, game.config.moves)

    return join_ego(
        [
            _play(game, pairs[rows], keys[rows], replies[rows], [paths_from(int(p)) for p in pairs[rows, 0]])
            for rows in (slice(at, at + BLOCK) for at in range(0, roots, BLOCK))
        ]
    )


def check_ego(game: RaceGame, roots: int, opponent: str | ArrayLike, seed: int, first: int = 0) -> None:
    """Check the arguments of :func:`play_ego`."""
    check_game(game)
    check_whole("roots", roots, 1, MOST_ROOTS)
    check_whole("first", first, 0, 2**40)
    check_seed(seed, most=2**64)
    if isinstance(opponent, str) and opponent not in OPPONENTS:
        raise UnknownNameError(f"opponent {opponent!r} is unknown; there are {', '.join(OPPONENTS)}")


def _whole(values: ArrayLike, name: str, shape: tuple[int, ...], least: int, below: int) -> Indices:
    array = check_whole_array(name, values, shape, shape[1:], least=least, most=below - 1)
    return np.array(np.broadcast_to(array, shape))


def _play(
    game: RaceGame, pairs: Indices, keys: NDArray[np.uint64], replies: Indices, paths: list[PolicyPaths]
) -> EgoTrees:
    """Play some roots in one batch; the races of a level stand root by root, path by path."""
    moves, axes = game.config.moves, len(game.characteristics)
    root = game.reset(keys, policies=pairs)
    races = root.race.copy()
    row = np.where(races.crashed, -1, np.arange(len(pairs)))  # of each path's race, -1 where it is over
    worth = np.where(races.crashed, reward(game.config, races, 0), 0.0)
    second = pairs[:, 1]  # car 1's policy
    at = [np.zeros((len(pairs), 1), np.int64)]  # path of each history, counted over all roots
    own, leads, estimates, over = [], [root.leads[:, 0]], [root.estimates[:, :, 0]], [row < 0]
    own.append(game.points[pairs[:, 0]])
    at[0][:, 0] = begins = np.arange(len(pairs))
    driven = np.ones(len(pairs), np.int64)
    for k in range(1, moves + 1):
        # Races belong to paths, not to histories: histories through the same policies share one race.
        counts = np.array([path.count(k) for path in paths])
        which = np.repeat(np.arange(len(pairs)), counts)
        above = np.concatenate([path.parent[k] for path in paths]) + begins[which]
        begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
        at.append(np.stack([path.history[k] for path in paths]) + begins[:, None])
        second = np.where(replies[:, k - 1] < 0, second, game.table[second, replies[:, k - 1]])
        policies = np.stack([np.concatenate([path.policy[k] for path in paths]), second[which]], axis=1)
        live = np.flatnonzero(row[above] >= 0)  # paths whose race has not ended in a crash
        driven += np.bincount(which[live], minlength=len(pairs))
        rows, worth = row[above], worth[above]
        if k == moves:  # no move follows: only the ends of the races matter, not what is measured
            ends, _ = finish(game, races, rows[live], policies[live], share=False)
            worth[live] = reward(game.config, ends.as_races(), k)
            break
        races, measured = drive_children(game, races, rows[live], policies[live])
        worth[live] = np.where(races.crashed, reward(game.config, races, k), 0.0)
        row = np.full(len(above), -1)
        row[live] = np.where(races.crashed, -1, np.arange(len(live)))
        own.append(game.points[policies[:, 0]])
        leads.append(np.zeros(len(above)))
        leads[k][live] = races.lead
        estimates.append(np.zeros((len(above), 2, axes)))
        estimates[k][live] = measured
        over.append(row < 0)
    # From paths to histories: each history takes the values of its path.
    return EgoTrees(
        policies=pairs,
        seeds=keys,
        replies=replies,
        paths=tuple(np.stack([path.history[k] for path in paths]) for k in range(moves + 1)),
        own=tuple(values[at[k]] for k, values in enumerate(own)),
        leads=tuple(values[at[k]] for k, values in enumerate(leads)),
        estimates=tuple(values[at[k]].astype(np.float32) for k, values in enumerate(estimates)),
        over=tuple(values[at[k]] for k, values in enumerate(over)),
        payoffs=worth[at[moves]].astype(np.float32),
        driven=driven,
    )
