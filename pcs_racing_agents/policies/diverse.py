"""The choice of a few diverse policies of an archive: determinantal point processes and their greedy maximum.

A k-DPP draws a set Y of k items with probability proportional to det(L_Y), the squared volume spanned by the items'
features: the more similar two items are, the less often they appear together (A. Kulesza and B. Taskar, Determinantal
point processes for machine learning, 2012).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_choice, check_number, check_whole
from pcs_racing.game.archive import PolicyArchive

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

METHODS = {
    "kdpp": "random, similar ones seldom together",
    "map": "the set found by adding the item that enlarges the determinant most; not random",
    "random": "random, all sets equally likely",
}


def select_diverse(
    archive: PolicyArchive,
    k: int,
    method: str = "kdpp",
    rng: np.random.Generator | int = 0,
    *,
    scale: float = 0.2,
) -> Indices:
    """Choose ``k`` policies of an archive that lie far apart in its normalised coordinates.

    Parameters
    ----------
    k : int
        1 to the number of policies.
    method : {"kdpp", "map", "random"}
        See :data:`METHODS`.
    rng : numpy.random.Generator or int
        Where the random choice comes from.
    scale : float
        Distance over which policies count as similar, in normalised units (:func:`similarity`); above 0.

    Returns
    -------
    ndarray of int, shape (k,)
        Indices of the policies, ascending, all different.
    """
    check_whole("k", k, 1, len(archive))
    check_choice("method", method, METHODS)
    generator = np.random.default_rng(rng)
    if method == "random":
        indices = generator.choice(len(archive), int(k), replace=False)
    elif method == "map":
        indices = greedy_map(similarity(archive.normalised, scale), int(k))
    else:
        indices = sample_kdpp(similarity(archive.normalised, scale), int(k), generator)
    return np.sort(indices).astype(np.int64)


def similarity(points: ArrayLike, scale: float) -> Floats:
    """Kernel exp(-distance^2 / (2 scale^2)) between points (K, G), shape (K, K).

    A millionth is added to the diagonal: points that coincide then still make a matrix of full rank, so that as many
    items can be drawn as there are.
    """
    check_number("scale", scale, above=0.0)
    points = np.asarray(points, np.float64)
    squares = np.sum((points[:, None] - points[None]) ** 2, axis=-1)
    return np.asarray(np.exp(-0.5 * squares / scale**2) + 1e-6 * np.eye(len(points)), np.float64)


def sample_kdpp(kernel: Floats, k: int, rng: np.random.Generator) -> Indices:
    """Draw a set of ``k`` items from a k-DPP (Kulesza and Taskar, algorithms 1 and 8), shape (k,).

    The kernel, shape (K, K), is symmetric, with no negative eigenvalue and at least ``k`` positive ones.
    """
    values, vectors = np.linalg.eigh(kernel)
    with np.errstate(divide="ignore"):
        logs = np.log(np.maximum(values, 0.0))
    table = log_elementary_symmetric(logs, k)
    basis: list[int] = []
    # Which eigenvectors: the n-th is in with its share of all sets of those up to n.
    for n in range(len(values), 0, -1):
        left = k - len(basis)
        if left == 0:
            break
        if np.log(rng.uniform()) < logs[n - 1] + table[left - 1, n - 1] - table[left, n]:
            basis.append(n - 1)
    space = vectors[:, basis]
    items = np.empty(k, np.int64)
    for i in range(k):
        weights = np.sum(space**2, axis=1)
        # Exactly 0, which rounding would not give: no item may be drawn twice.
        weights[items[:i]] = 0.0
        items[i] = rng.choice(len(weights), p=weights / weights.sum())
        # The column that is eliminated: the largest entry divides, so that rounding stays small.
        pivot = int(np.argmax(np.abs(space[items[i]])))
        column = space[:, pivot] / space[items[i], pivot]
        space = np.delete(space - np.outer(column, space[items[i]]), pivot, axis=1)
        # An orthonormal basis of what is orthogonal to the item.
        space = np.linalg.qr(space)[0]
    return items


def log_elementary_symmetric(logs: Floats, k: int) -> Floats:
    """Logarithms of elementary symmetric polynomials, shape (k + 1, N + 1).

    Entry (l, n) belongs to the sum over all sets of ``l`` of the first ``n`` values of their products (Kulesza and
    Taskar, algorithm 7); the values are given as logarithms, since products of many small ones underflow.
    """
    table = np.full((k + 1, len(logs) + 1), -np.inf)
    table[0] = 0.0
    for n, log in enumerate(logs, start=1):
        table[1:, n] = np.logaddexp(table[1:, n - 1], log + table[:-1, n - 1])
    return table


def greedy_map(kernel: Floats, k: int) -> Indices:
    """Items chosen one by one, each the one that enlarges det(L_Y) most, shape (k,), in the order chosen.

    The gain of an item is its squared distance from the span of those chosen; it is updated as in an incremental
    Cholesky factorisation. Of equal items the one with the lowest index is taken.
    """
    gains = np.diag(kernel).astype(np.float64)
    rows = np.zeros((k, len(kernel)))
    items = np.empty(k, np.int64)
    for i in range(k):
        items[i] = np.argmax(gains)
        best = items[i]
        # The next row of the Cholesky factor; a gain may be 0 where points coincide.
        rows[i] = (kernel[best] - rows[:i, best] @ rows[:i]) / np.sqrt(max(gains[best], 1e-300))
        gains = gains - rows[i] ** 2
        gains[items[: i + 1]] = -np.inf
    return items
