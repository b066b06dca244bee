"""Choice of diverse policies of an archive: determinantal point processes.

A k-DPP draws a set Y of k items with probability proportional to det(L_Y), the squared volume
spanned by the items' features: the more similar two items are, the less often they appear together
(A. Kulesza and B. Taskar, Determinantal point processes for machine learning, 2012).
"""

import numpy as np

from pcs_racing.base.errors import check_whole
from pcs_racing.base.typing import Floats, Indices
from pcs_racing.game.archive import PolicyArchive

SCALE = 0.2  # distance over which policies count as similar, in normalised units


def select_diverse(archive: PolicyArchive, k: int, rng: np.random.Generator | int = 0) -> Indices:
    """Choose ``k`` policies of an archive that lie far apart in its normalised coordinates.

    Parameters
    ----------
    k : int
        Number of policies to choose, 1 to the size of the archive.
    rng : numpy.random.Generator or int
        Generator or seed of the random choice.

    Returns
    -------
    ndarray of int, shape (k,)
        Indices of the policies, ascending, all different.
    """
    check_whole("k", k, 1, len(archive))
    kernel = similarity(archive.normalised)
    return np.sort(sample_kdpp(kernel, k, np.random.default_rng(rng)))


def similarity(points: Floats, scale: float = SCALE) -> Floats:
    """Return the kernel exp(-distance^2 / (2 scale^2)) between points (K, G), shape (K, K).

    The diagonal is raised by a millionth. So the matrix has full rank even if points coincide, and
    up to K items can be drawn.
    """
    squares = np.sum((points[:, None] - points[None]) ** 2, axis=-1)
    return np.asarray(np.exp(-0.5 * squares / scale**2) + 1e-6 * np.eye(len(points)), np.float64)


def sample_kdpp(kernel: Floats, k: int, rng: np.random.Generator) -> Indices:
    """Draw a set of ``k`` items from a k-DPP (Kulesza and Taskar, algorithms 1 and 8), shape (k,).

    The kernel, shape (K, K), is symmetric, without negative eigenvalues and with at least ``k``
    positive eigenvalues.
    """
    values, vectors = np.linalg.eigh(kernel)
    with np.errstate(divide="ignore"):
        logs = np.log(np.maximum(values, 0.0))
    table = log_elementary_symmetric(logs, k)
    basis: list[int] = []
    # Choice of eigenvectors: n is included with its share of all sets of the first n.
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
        # Exactly 0, despite rounding: no item may be drawn twice.
        weights[items[:i]] = 0.0
        items[i] = rng.choice(len(weights), p=weights / weights.sum())
        # Eliminated column: division by the largest entry minimises rounding errors.
        pivot = int(np.argmax(np.abs(space[items[i]])))
        column = space[:, pivot] / space[items[i], pivot]
        space = np.delete(space - np.outer(column, space[items[i]]), pivot, axis=1)
        # Orthonormal basis of the subspace orthogonal to the item.
        space = np.linalg.qr(space)[0]
    return items


def log_elementary_symmetric(logs: Floats, k: int) -> Floats:
    """Return logarithms of elementary symmetric polynomials, shape (k + 1, N + 1).

    Entry (l, n) belongs to the sum of the products of all sets of ``l`` of the first ``n`` values
    (Kulesza and Taskar, algorithm 7). The values are logarithms, since products of many small
    values underflow.
    """
    table = np.full((k + 1, len(logs) + 1), -np.inf)
    table[0] = 0.0
    for n, log in enumerate(logs, start=1):
        table[1:, n] = np.logaddexp(table[1:, n - 1], log + table[:-1, n - 1])
    return table
