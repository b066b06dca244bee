"""Units of a comparison: scores of races, the matching of two arms' races, and codes of their clusters."""

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]


def score(won: ArrayLike, tied: ArrayLike) -> Floats:
    """Return the score of races: 1 for a win, 0.5 for a tie, 0 for the rest (a crash without a winner is no tie).

    Parameters
    ----------
    won, tied : array_like of bool, shape (U,)
    """
    wins, ties = np.asarray(won, dtype=bool), np.asarray(tied, dtype=bool)
    if wins.shape != ties.shape:
        raise InputError(f"won has shape {wins.shape} and tied {ties.shape}; they must be the same races")
    both = wins & ties
    if both.any():
        raise InputError(f"race {int(np.argmax(both.ravel()))} is won and tied; it can be only one of them")
    return wins + 0.5 * ties


def match_units(units_a: Sequence[Hashable], units_b: Sequence[Hashable]) -> Ints:
    """Return the order of the units of arm b that matches those of arm a: ``units_b[order[i]] == units_a[i]``.

    Parameters
    ----------
    units_a, units_b : sequence of hashable
        Identity of each race, for instance ``(ego, opponent, start_s, side)``.

    Returns
    -------
    ndarray of int, shape (U,)
    """
    indices: list[dict[Hashable, int]] = []
    for arm, units in (("a", units_a), ("b", units_b)):
        index = {unit: i for i, unit in enumerate(units)}
        if len(index) < len(units):
            twice = next(unit for i, unit in enumerate(units) if index[unit] != i)
            raise InputError(f"arm {arm} raced unit {twice!r} more than once; every unit must be there once")
        indices.append(index)
    for arm, own, others in (("b", indices[0], indices[1]), ("a", indices[1], indices[0])):
        missing = [unit for unit in own if unit not in others]
        if missing:
            raise InputError(
                f"arm {arm} did not race unit {missing[0]!r} ({len(missing)} missing); both must race the same units"
            )
    return np.array([indices[1][unit] for unit in units_a], dtype=np.intp)


def check_values(name: str, values: ArrayLike) -> Floats:
    """Return finite numbers of shape (U,), U at least 1, or raise InputError naming the first that is none."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers, one for each race") from None
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"{name} has shape {array.shape}; it must be one number for each race")
    wrong = ~np.isfinite(array)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"{name}[{at}] is {array[at]}; it must be a finite number")
    return array


def check_arms(a: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    """Return the scores of two arms, or raise InputError if their lengths differ."""
    first, second = check_values("a", a), check_values("b", b)
    if first.shape != second.shape:
        raise InputError(f"a has {len(first)} scores and b {len(second)}; both arms must have raced the same units")
    return first, second


def cluster_codes(labels: ArrayLike, values: Floats, kind: str) -> tuple[Ints, int]:
    """Return labels as numbers from 0, shape (U,), and how many different ones there are; InputError below 2."""
    try:
        array = np.asarray(labels)
    except ValueError:
        raise InputError(f"{kind} labels must be text or numbers, one for each race") from None
    if array.shape != values.shape:
        raise InputError(f"{kind} labels have shape {array.shape}; there must be one for each of {len(values)} races")
    if array.dtype.kind not in "biufUS" or (array.dtype.kind == "f" and not np.isfinite(array).all()):
        raise InputError(f"{kind} labels must be text or finite numbers, not {array.dtype}")
    unique, codes = np.unique(array, return_inverse=True)
    if len(unique) < 2:
        raise InputError(
            f"there is 1 {kind} variant, {unique[0]!s}; a test needs at least 2, since it looks at how they differ"
        )
    return codes.astype(np.intp), len(unique)


def pool_codes(ego: ArrayLike, opponent: ArrayLike) -> tuple[Ints, Ints]:
    """Return checked labels of both roles as numbers from 0, equal for the same policy in both, shape (U,) each."""
    first, second = np.asarray(ego), np.asarray(opponent)
    if (first.dtype.kind in "US") != (second.dtype.kind in "US"):
        raise InputError(f"ego labels are {first.dtype} and opponent labels {second.dtype}; one pool has one kind")
    _, codes = np.unique(np.concatenate([first, second]), return_inverse=True)
    both = codes.astype(np.intp)
    return both[: len(first)], both[len(first) :]
