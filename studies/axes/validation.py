"""How well coordinates are estimated from a few segments of races, for held-out policies and circuits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.headroom import jackknife_error
from studies.axes.ridge import PENALTIES, fit_ridge, input_scales, standardise, term_values

Floats = NDArray[np.float64]

DRAWS = 16
"""Means over a few segments that are drawn for each policy and circuit."""


class Accuracy(NamedTuple):
    """How accurate estimates are: the share of the variance of coordinates that they explain."""

    r2: Floats  #: shape (C,): 1 - squared error / variance; below 0 if the mean would be a better estimate.
    error: Floats  #: shape (C,): Standard error over policies (jackknife).


def draw_rows(values: Floats, segments: int, seed: int) -> Floats:
    """Draw means over a few segments of every policy on every circuit.

    Parameters
    ----------
    values : ndarray, shape (T, N, M, K)
        Of every segment; NaN where there was none.
    segments : int
        How many segments a mean is over.

    Returns
    -------
    ndarray, shape (T, N, DRAWS, K)
    """
    tracks, policies, _, terms = values.shape
    rows = np.empty((tracks, policies, DRAWS, terms))
    for track, policy in np.ndindex(tracks, policies):
        known = values[track, policy]
        known = known[~np.isnan(known).any(axis=1)]
        if len(known) < segments:
            raise InputError(f"policy {policy} has {len(known)} segments on circuit {track}; {segments} are needed")
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(track, policy, segments)))
        for draw in range(DRAWS):
            rows[track, policy, draw] = known[rng.permutation(len(known))[:segments]].mean(axis=0)
    return rows


def explained(estimates: Floats, targets: Floats) -> Accuracy:
    """Return how accurate estimates of policies' coordinates are.

    Parameters
    ----------
    estimates : ndarray, shape (T, N, D, C)
        D estimates on every circuit.
    targets : ndarray, shape (N, C) or (T, N, C)
        Of all circuits together or of each one; variances are then those within circuits.
    """
    wanted = np.broadcast_to(targets, (len(estimates), *targets.shape[-2:]))
    wrong = np.square(estimates - wanted[:, :, None]).mean(axis=2).sum(axis=0)

    def share(kept: NDArray[np.intp]) -> Floats:
        spread = np.square(wanted[:, kept] - wanted[:, kept].mean(axis=1, keepdims=True)).sum(axis=(0, 1))
        return np.asarray(1.0 - wrong[kept].sum(axis=0) / spread)

    everyone = np.arange(wanted.shape[1])
    without = np.array([share(np.delete(everyone, i)) for i in everyone])
    errors = np.array([jackknife_error(column) for column in without.T])
    return Accuracy(share(everyone), errors)


def cross_validate(
    values: Floats, targets: Floats, *, degree: int, segments: int, folds: int, seed: int, judged: Sequence[int]
) -> tuple[list[float], dict[int, Accuracy], Floats]:
    """Choose penalties, and score the estimates of held-out policies on held-out circuits.

    Policies are divided into folds. In each split one fold of the policies and one circuit are left out of the fit, and
    these policies are judged on this circuit; with a single circuit only the policies are left out.

    Parameters
    ----------
    values : ndarray, shape (T, N, M, I)
        Inputs in every segment.
    targets : ndarray, shape (N, C)
    degree : int
        Of products of inputs.
    segments : int
        Rows of the regression are means over so many.
    seed : int
        Of folds and rows.
    judged : sequence of int
        Numbers of segments from which to estimate.

    Returns
    -------
    penalties : list of C floats
    scores : dict of int to Accuracy
        By number of segments.
    estimates : ndarray, shape (N, C)
        Of every policy when it was left out, the mean over circuits and rows of the largest number of segments.
    """
    tracks, policies = values.shape[:2]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    fold_of = rng.permutation(np.arange(policies) % folds)
    fitted = {count: np.empty((len(PENALTIES), tracks, policies, DRAWS, targets.shape[1])) for count in judged}
    wanted = np.broadcast_to(targets[:, None], (policies, DRAWS, targets.shape[1]))
    for track in range(tracks):
        others = np.array([t for t in range(tracks) if t != track] or [track])
        for fold in range(folds):
            out, kept = np.flatnonzero(fold_of == fold), np.flatnonzero(fold_of != fold)
            known = values[np.ix_(others, kept)]
            scales = input_scales(known)
            rows = draw_rows(term_values(standardise(known, *scales), degree), segments, seed)
            left_out = term_values(standardise(values[[track]][:, out], *scales), degree)
            tests = {count: draw_rows(left_out, count, seed)[0] for count in judged}
            y = np.broadcast_to(wanted[kept], (len(others), len(kept), DRAWS, targets.shape[1]))
            for i, penalty in enumerate(PENALTIES):
                regression = fit_ridge(
                    rows.reshape(-1, rows.shape[-1]), y.reshape(-1, y.shape[-1]), [penalty] * y.shape[-1]
                )
                for count in judged:
                    fitted[count][i, track, out] = regression.predict(tests[count])
    # Penalties by the error at the number of segments that the fit is for, or the nearest that is judged.
    nearest = min(judged, key=lambda count: abs(count - segments))
    wrong = np.square(fitted[nearest] - wanted).mean(axis=(1, 2, 3))
    best = wrong.argmin(axis=0)
    chosen = {count: np.stack([fitted[count][k, ..., c] for c, k in enumerate(best)], axis=-1) for count in judged}
    scores = {count: explained(estimates, targets) for count, estimates in chosen.items()}
    return [PENALTIES[k] for k in best], scores, chosen[max(judged)].mean(axis=(0, 2))
