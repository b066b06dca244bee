"""Behaviour of policies: characteristics of each in many segments of races against the same opponents."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.track import Track
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import Run, run_races
from pcs_racing_agents.policies.evaluate import (
    PolicyTask,
    Scenarios,
    draw_scenarios,
    join,
    race_policies,
    race_segments,
)
from pcs_racing_agents.policies.policy_pool import race_scores
from studies.axes.learned import LearnedCharacteristics, register_learned

Floats = NDArray[np.float64]

_BLOCK = 8

LearnedTask = tuple[LearnedCharacteristics | None, PolicyTask]
Race = Callable[[PolicyTask, int | None], Arrays]


def measure_behaviour(
    policies: Sequence[Policy],
    opponents: Sequence[Policy],
    tracks: Sequence[Track | str],
    config: RaceConfig,
    inputs: Sequence[str],
    *,
    starts: int = 2,
    segment_seconds: float = 8.0,
    seed: int = 0,
    name: str = "behaviour",
    **run: Unpack[Run],
) -> Floats:
    """Race policies against all opponents from both sides, and measure every segment.

    Parameters
    ----------
    policies, opponents : sequence of Policy
        All of one planner.
    config : RaceConfig
        Its duration is a multiple of ``segment_seconds``.
    inputs : sequence of str
        Names of characteristics.
    starts : int
        Start lines for each opponent and circuit.
    segment_seconds : float
        Length of a segment, s.
    seed : int
        Root of start lines and noise.
    name : str
        Of the group of tasks in the job.

    Returns
    -------
    ndarray, shape (T, N, M, I)
        Inputs of every policy in each of M segments on every circuit; NaN in segments that a race did not reach.
    """
    planner = common_planner([*policies, *opponents])
    scenarios = draw_scenarios(
        tracks,
        config,
        parameters_of(opponents),
        inputs,
        planner=planner.name,
        starts=starts,
        segment_seconds=segment_seconds,
        seed=seed,
    )
    raced = run_blocks(scenarios, parameters_of(policies), None, race_segments, name, **run)
    values = raced["values"]
    # Every circuit has the same number of races, circuit after circuit.
    return np.moveaxis(values.reshape(len(policies), len(tracks), -1, len(inputs)), 1, 0)


def measure_payoffs(
    policies: Sequence[Policy],
    opponents: Sequence[Policy],
    tracks: Sequence[Track | str],
    config: RaceConfig,
    *,
    starts: int = 8,
    seed: int = 0,
    name: str = "payoffs",
    **run: Unpack[Run],
) -> Floats:
    """Race policies against all opponents from both sides, and count races won.

    Parameters
    ----------
    policies, opponents, tracks, config, starts, seed, name
        As for :func:`measure_behaviour`.

    Returns
    -------
    ndarray, shape (T, N, O)
        Score minus one half; a tie and a crash that pays nobody count one half.
    """
    planner = common_planner([*policies, *opponents])
    scenarios = draw_scenarios(
        tracks,
        config,
        parameters_of(opponents),
        ["speed"],
        planner=planner.name,
        starts=starts,
        segment_seconds=config.duration,
        seed=seed,
    )
    raced = run_blocks(scenarios, parameters_of(policies), None, race_policies, name, **run)
    score = race_scores(raced["winner"])
    won = np.zeros((len(tracks), len(policies), len(opponents)))
    for track, opponent in np.ndindex(len(tracks), len(opponents)):
        among = (scenarios.track == track) & (scenarios.opponent == opponent)
        won[track, :, opponent] = score[:, among].mean(axis=1) - 0.5
    return won


def run_blocks(
    scenarios: Scenarios,
    parameters: Floats,
    learned: LearnedCharacteristics | None,
    race: Race,
    name: str,
    **run: Unpack[Run],
) -> Arrays:
    """Race blocks of policies as tasks, and join the results along the policies."""
    tasks: list[LearnedTask] = [
        (learned, (scenarios, parameters[first : first + _BLOCK])) for first in range(0, len(parameters), _BLOCK)
    ]
    return join(run_races(name, partial(race_learned, race=race), tasks, **run))


def race_learned(task: LearnedTask, race: Race = race_policies, threads: int | None = None) -> Arrays:
    """Race some policies after learned characteristics have become known in this process."""
    learned, races = task
    if learned is not None:
        register_learned(learned)
    return race(races, threads)


def common_planner(policies: Sequence[Policy]) -> Planner:
    """Return the planner that all policies belong to."""
    planners = {policy.planner.name: policy.planner for policy in policies}
    if len(planners) != 1:
        raise InputError(f"the policies belong to planners {', '.join(planners)}; they must belong to one")
    return next(iter(planners.values()))


def parameters_of(policies: Sequence[Policy]) -> Floats:
    """Return the parameters of policies of one planner, shape (N, P)."""
    return np.array([policy.parameters for policy in policies], np.float64)
