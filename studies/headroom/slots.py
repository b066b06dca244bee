"""Headroom for a driver that knows its place on the grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.headroom import checked_payoffs, cross_fitted


@dataclass(frozen=True, eq=False)
class SlotHeadroom:
    """The value of knowing the opponent's policy for a driver that knows its place on the grid, in
    races won.
    """

    #: Mean over slots and opponents of the best response's payoff minus that of the best fixed
    #: policy of the slot, cross-fitted.
    value: float
    #: The same, minus the best fixed policies of the evaluation races themselves: a lower bound.
    low: float
    opponents_error: float  #: Standard error over opponents.
    slots: tuple[float, float]  #: ``value`` on the left or in front, and on the right or behind.
    #: Value of knowing the slot and not the opponent, cross-fitted: a policy for each slot over one
    #: for both.
    slot_alone: float


def slot_headroom(payoffs: ArrayLike) -> SlotHeadroom:
    """Estimate the headroom within a slot of the grid, cross-fitted.

    Most of what a policy scores may depend on its slot, and every driver knows it without looking
    at the opponent.

    Parameters
    ----------
    payoffs : array_like, shape (F, 2, N, N)
        Payoff in each of F >= 2 folds and each slot of the row's policy
        (:func:`pcs_racing_agents.policies.policy_pool.slot_payoffs`); the mean over slots is
        antisymmetric.
    """
    slots = np.asarray(payoffs, np.float64)
    if slots.ndim != 4 or slots.shape[1] != 2:
        raise InputError(
            f"payoffs have shape {slots.shape}; it must be (folds, 2, policies, policies)"
        )
    both = checked_payoffs(slots.mean(axis=1))
    estimates = [cross_fitted(slots[:, slot]) for slot in (0, 1)]
    gains = np.mean([gain for _, _, gain in estimates], axis=0)
    total, alone = slots.sum(axis=0), []
    for judged, judged_both in zip(slots, both, strict=True):
        best = (total - judged).sum(axis=-1).argmax(axis=-1)  # of each slot
        fixed = (both.sum(axis=0) - judged_both).sum(axis=-1).argmax()
        alone.append(
            np.mean([judged[slot, best[slot]].mean() for slot in (0, 1)])
            - judged_both[fixed].mean()
        )
    return SlotHeadroom(
        value=float(gains.mean()),
        low=float(np.mean([low for _, low, _ in estimates])),
        opponents_error=float(gains.std(ddof=1) / np.sqrt(len(gains))),
        slots=(estimates[0][0], estimates[1][0]),
        slot_alone=float(np.mean(alone)),
    )
