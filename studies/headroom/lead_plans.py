"""Payoffs of lead plans: one policy while ahead, another one while behind, without a look at the
opponent's policy.

A lead plan reacts to what every driver sees, who is in front. It is the simplest way to drive
differently in different races, so an agent that observes its opponent must beat the best lead plan
and not only the best fixed policy.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.races import RaceSetup, advance, start_races, winners
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Run, run_races
from pcs_racing_agents.policies.policy_pool import PolicyPool, race_scores

Floats = NDArray[np.float64]
Plan = tuple[int, int]


@dataclass(frozen=True, eq=False)
class LeadPlanValue:
    """The value of reacting to who is in front, in races won."""

    #: Mean payoff of the best lead plan minus that of the best fixed policy, cross-fitted.
    value: float
    opponents_error: float  #: Standard error of ``value`` over opponents.
    #: Mean over opponents of the payoff of the best lead plan against this opponent minus that of
    #: the best lead plan for all, cross-fitted: what is left for those who know the opponent.
    headroom: float
    headroom_error: float  #: Standard error of ``headroom`` over opponents.
    best: Plan  #: Policy ahead and policy behind of the best lead plan over all folds.


def make_lead_plans(policies: int, members: Sequence[int]) -> list[Plan]:
    """Return plans (policy ahead, policy behind): every policy all the time, then all pairs of
    different members.
    """
    fixed = [(k, k) for k in range(policies)]
    return [
        *fixed,
        *((ahead, behind) for ahead in members for behind in members if ahead != behind),
    ]


def plan_members(policies: int, count: int) -> list[int]:
    """Return the numbers of the policies that lead plans are made of, evenly spaced in a pool."""
    if check_whole("lead-plans", count, 0, policies) == 1:
        raise InputError(
            "lead-plans is 1; a plan of its own needs 2 policies, and 0 means no plans"
        )
    return [int(k) for k in np.linspace(0, policies - 1, count).round()] if count else []


def lead_plan_payoffs(
    pool: PolicyPool, plans: Sequence[Plan], *, step_seconds: float = 8.0, **run: Unpack[Run]
) -> Floats:
    """Race every lead plan against every policy of a pool.

    Parameters
    ----------
    pool : PolicyPool
        The opponents, the policies of the plans, and the races.
    plans : sequence of (int, int)
        Policy while ahead, policy while behind.
    step_seconds : float
        The lead is looked at when the race begins and after each of these steps, s; a multiple of
        0.1 s. It is that of a game of four moves.
    **run
        As for :func:`pcs_racing_agents.policies.policy_pool.pool_payoffs`; progress counts plans.

    Returns
    -------
    ndarray, shape (T, F, L, N)
        Score of the plan against the opponent minus one half, both slots together.
    """
    ticks = 10 * check_whole("step_seconds times 10", round(step_seconds * 10.0), 1)
    for plan in plans:
        if not all(0 <= policy < len(pool.policies) for policy in plan):
            raise InputError(
                f"a lead plan is {plan}; the pool holds policies 0 to {len(pool.policies) - 1}"
            )
    if len({policy.planner.name for policy in pool.policies}) > 1:
        raise InputError(
            "the pool holds policies of several planners; a lead plan can't change the planner in a"
            " race"
        )
    tasks = [(pool, track, plan, ticks) for track in range(len(pool.tracks)) for plan in plans]
    results = run_races("lead-plans", _race_plan, tasks, **run)
    payoffs = np.array([result["payoffs"] for result in results])
    return np.moveaxis(
        payoffs.reshape(len(pool.tracks), len(plans), len(pool.policies), pool.folds), 3, 1
    )


def lead_plan_value(payoffs: ArrayLike, plans: Sequence[Plan]) -> LeadPlanValue:
    """Estimate the value of the best lead plan, cross-fitted.

    Parameters
    ----------
    payoffs : array_like, shape (F, L, N)
        Of F >= 2 folds, for N >= 2 opponents.
    plans : sequence of (int, int)
        Those with the same policy ahead and behind are the fixed policies.
    """
    folds = np.asarray(payoffs, np.float64)
    if folds.ndim != 3 or folds.shape[0] < 2 or folds.shape[1] != len(plans) or folds.shape[2] < 2:
        raise InputError(
            f"payoffs have shape {folds.shape}; it must be (folds, {len(plans)} plans, opponents)"
        )
    fixed = np.array([ahead == behind for ahead, behind in plans])
    if not fixed.any():
        raise InputError(
            "there is no plan with the same policy ahead and behind; the best fixed policy is one"
            " of them"
        )
    total, opponents = folds.sum(axis=0), np.arange(folds.shape[2])
    gains, left = [], []
    for judged in folds:
        training = total - judged
        strength = training.sum(axis=1)
        best, best_fixed = strength.argmax(), np.where(fixed, strength, -np.inf).argmax()
        gains.append(judged[best] - judged[best_fixed])
        left.append(judged[training.argmax(axis=0), opponents] - judged[best])
    gain, rest = np.mean(gains, axis=0), np.mean(left, axis=0)
    return LeadPlanValue(
        value=float(gain.mean()),
        opponents_error=float(gain.std(ddof=1) / np.sqrt(len(gain))),
        headroom=float(rest.mean()),
        headroom_error=float(rest.std(ddof=1) / np.sqrt(len(rest))),
        best=plans[int(total.sum(axis=1).argmax())],
    )


def _race_plan(task: tuple[PolicyPool, int, Plan, int], threads: int | None = None) -> Arrays:
    """Race a lead plan against all policies of a pool on one circuit: payoffs, shape (N, F)."""
    pool, number, (ahead, behind), ticks = task
    track, starts = pool.starts(number)
    planner = pool.policies[0].planner
    setup = RaceSetup(track, pool.config, (planner, planner))
    own = pad_parameters([pool.policies[ahead], pool.policies[behind]], setup.theta_size)
    scores = np.empty((len(pool.policies), pool.races))
    for j, opponent in enumerate(pool.policies):
        state = start_races(setup, starts, pool.noise(number, ahead, behind, j))
        theta = np.empty((pool.races, 2, setup.theta_size))
        theta[:, 1] = pad_parameters([opponent], setup.theta_size)[0]
        for first in range(0, pool.config.ticks, ticks):
            leads = state.progress[:, 0] > state.progress[:, 1]
            theta[:, 0] = own[np.where(leads, 0, 1)]
            advance(
                setup,
                state,
                theta,
                min(ticks, pool.config.ticks - first),
                threads=threads,
                ittc=False,
            )
        scores[j] = race_scores(winners(pool.config, state))
    return {"payoffs": pool.by_fold(scores).mean(axis=-1)}
