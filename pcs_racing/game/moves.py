"""Moves between the policies of an archive: more or less of one characteristic.

A move requests the point a step farther along one normalised axis and leads to the nearest policy
of the archive. It starts from the policy in use, not from the point requested by an earlier move.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, as_array, is_flag
from pcs_racing.base.typing import Indices
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.race.config import EPSILON, check_epsilon

STAY = "stay"
"""Name of the last move, which keeps the policy."""

MAX_NAMES = 24  # max number of moves that an error lists by name


def move(
    archive: PolicyArchive, index: ArrayLike, axis: int, sign: ArrayLike, epsilon: float
) -> Indices:
    """Return the index of the policy that a move leads to; policies and signs broadcast against
    each other.

    The move starts from policy ``index`` and asks for more (``sign`` 1) or less (-1) of the
    characteristic ``axis``, by ``epsilon`` in normalised units.
    """
    targets = archive.normalised[np.asarray(index)]
    targets[..., axis] += np.asarray(sign) * epsilon
    return archive.nearest(targets)


def move_table(archive: PolicyArchive, epsilon: float | Sequence[float] = EPSILON) -> Indices:
    """Return the policy that every move leads to from every policy, shape (K, M).

    The moves of the first epsilon come first: characteristic 0 more, characteristic 0 less,
    characteristic 1 more, and so on; then the moves of the next epsilon; "stay", the move that
    keeps the policy, comes last.
    """
    policies = np.arange(len(archive))
    columns = [
        move(archive, policies, axis, sign, step)
        for step in check_epsilon(epsilon)
        for axis in range(len(archive.characteristics))
        for sign in (1, -1)
    ]
    return np.stack([*columns, policies], axis=1)


def move_names(
    archive: PolicyArchive, epsilon: float | Sequence[float] = EPSILON
) -> tuple[str, ...]:
    """Return names of the moves in the order of :func:`move_table`.

    They are ``"aggressiveness +"`` (with several epsilons ``"aggressiveness + 0.5"``) and, as the
    last one, ``"stay"``.
    """
    steps = check_epsilon(epsilon)
    names = [
        f"{axis} {sign}" if len(steps) == 1 else f"{axis} {sign} {step:g}"
        for step in steps
        for axis in archive.characteristics
        for sign in "+-"
    ]
    return (*names, STAY)


def no_op_share(archive: PolicyArchive, epsilon: float | Sequence[float] = EPSILON) -> float:
    """Return the share of all (policy, move) pairs that lead back to the policy itself, without
    "stay".
    """
    switches = move_table(archive, epsilon)[:, :-1]
    return float(np.mean(switches == np.arange(len(archive))[:, None]))


def duplicate_share(archive: PolicyArchive, epsilon: float | Sequence[float] = EPSILON) -> float:
    """Return the share of all (policy, move) pairs with the same target as an earlier move, without
    "stay".
    """
    return float(np.mean(duplicate_moves(move_table(archive, epsilon)[:, :-1])))


def duplicate_moves(table: Indices) -> NDArray[np.bool_]:
    """Return which moves of a table, shape (K, M), are duplicates.

    A duplicate leads to the same policy as an earlier move from the same policy.
    """
    same = table[:, :, None] == table[:, None, :]
    return np.triu(same, 1).any(axis=1)


def check_moves(
    moves: Any,
    names: Sequence[str],
    shape: tuple[int, ...],
    axes: tuple[str, ...] = (),
    *,
    rows: Indices | None = None,
    player: str = "",
) -> Indices:
    """Return moves, indices in ``names``, as whole numbers: the only check of the moves of a game.

    Errors locate a wrong move by the names of the axes of its shape, such as ``("game", "car")``,
    by the game of each entry of the first axis (``rows``), and by the player.
    """
    given = as_array(moves)
    if isinstance(moves, list | tuple) and any(is_flag(move) for move in moves):
        given = given.astype(np.bool_)  # among whole numbers numpy would take them for 0 and 1
    fits = given.shape == shape and given.dtype.kind in "iu"
    wrong = (given < 0) | (given >= len(names)) if fits else np.True_
    if not wrong.any():
        return given.astype(np.int64)
    by = f"{player}: " if player else ""
    listed = f" ({', '.join(names)})" if len(names) <= MAX_NAMES else ""
    known = f"from 0 to {len(names) - 1}{listed}"
    if not fits:
        wanted = f"whole numbers of shape {shape}" if shape else "a whole number"
        found = f"{moves!r:.60}, of shape {given.shape} and type {given.dtype}"
        raise InputError(f"{by}moves are {found}; they must be {wanted}, {known}")
    at = tuple(int(i) for i in np.argwhere(wrong)[0])
    index = at if rows is None else (int(rows[at[0]]), *at[1:])
    where = ", ".join(f"{axis} {i}" for axis, i in zip(axes, index, strict=False))
    raise InputError(
        f"{by}{f'{where}: ' if where else ''}move {given[at]} is not one of the moves {known}"
    )
