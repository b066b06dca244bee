"""Evaluation of policies by races: the ``eval`` of Algorithm 1, in tasks for any worker.

Races for a comparison have the same tracks, starts, opponents and noise for every policy. Every
policy meets every pair of start line and opponent, from both sides of the grid, on every track. All
draws happen once per run, so that policies differ by their driving and not by chance.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import SUMS
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import run_races

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scenarios:
    """The R races of every policy."""

    #: Tracks, or their names or folders, which workers on other machines load themselves.
    tracks: tuple[Track | str, ...]
    config: RaceConfig  #: Rules and duration.
    planner: str  #: Planner of the policies and of their opponents, except for rivals.
    characteristics: tuple[str, ...]
    segment_seconds: float  #: Length of the segments averaged in coordinates, s.
    opponents: Floats  #: shape (O, P): Parameters of the opponents.
    #: Policies of other planners, numbered after the opponents; format of :func:`parse_policy`.
    rivals: tuple[str, ...]
    track: NDArray[np.int64]  #: shape (R,): Index of the track of each race, ascending.
    start_s: Floats  #: shape (R,): Start line, m.
    #: shape (R,): Side of the start; 0 if the policy starts on the left or in front.
    side: NDArray[np.int64]
    seed: NDArray[np.uint64]  #: shape (R,): Noise key.
    opponent: NDArray[np.int64]  #: shape (R,): Index of the opponent; rivals start at O.

    def __len__(self) -> int:
        return len(self.track)


def draw_scenarios(
    tracks: Sequence[Track | str],
    config: RaceConfig,
    opponents: Floats,
    characteristics: Sequence[str],
    *,
    planner: str = "lattice",
    rivals: Sequence[str] = (),
    starts: int = 2,
    segment_seconds: float = 8.0,
    seed: int = 0,
) -> Scenarios:
    """Draw races on every track: all pairs of start lines and opponents, from both sides.

    Parameters
    ----------
    opponents : ndarray, shape (O, P)
    rivals : sequence of str
        Policies of other planners, met in the same way as the opponents.
    starts : int
        Number of start lines on each track, 1 to 1000.
    segment_seconds : float
        Length of a segment, s; the duration of the race must be a multiple.
    seed : int
        Root seed of start lines and noise.

    Returns
    -------
    Scenarios
        ``len(tracks) * starts * (len(opponents) + len(rivals)) * 2`` races.
    """
    segments = round(config.duration / segment_seconds) if segment_seconds > 0.0 else 0
    if segments < 1 or abs(segments * segment_seconds - config.duration) > 1e-9:
        raise InputError(
            f"a race of {config.duration:g} s is no multiple of segment_seconds,"
            f" {segment_seconds:g} s"
        )
    family = get_planner(planner)
    opponents = check_policies("opponents", opponents, family)
    for rival in rivals:
        parse_policy(rival)
    if len(tracks) == 0:
        raise InputError("there are no tracks; name at least one")
    get_characteristics(characteristics)
    rules = replace(config, start_lines=starts)
    line, opponent, side = (
        indices.ravel() for indices in np.mgrid[:starts, : len(opponents) + len(rivals), :2]
    )
    start_s, seeds = [], []
    for index, track in enumerate(tracks):
        # Each track has its own root: another track in the list changes no race on this track.
        root = np.random.SeedSequence(seed, spawn_key=(index,))
        lines, noise = root.spawn(2)
        start_s.append(start_lines(as_track(track), rules, lines)[line])
        seeds.append(race_seeds(int(noise.generate_state(1, np.uint64)[0]), len(line)))
    return Scenarios(
        tracks=tuple(tracks),
        config=config,
        planner=planner,
        characteristics=tuple(characteristics),
        segment_seconds=float(segment_seconds),
        opponents=opponents,
        rivals=tuple(rivals),
        track=np.repeat(np.arange(len(tracks)), len(line)),
        start_s=np.concatenate(start_s),
        side=np.tile(side, len(tracks)),
        seed=np.concatenate(seeds),
        opponent=np.tile(opponent, len(tracks)),
    )


def check_policies(name: str, parameters: ArrayLike, planner: Planner) -> Floats:
    """Return parameters of at least one policy of a planner, shape (K, P)."""
    policies = check_array(name, parameters, (None, len(planner.parameters)))
    if len(policies) == 0:
        raise InputError(
            f"there are no {name}; give at least one policy of planner {planner.name!r}"
        )
    return policies


RACES_AT_ONCE = 4096  # bounded memory

PolicyTask: TypeAlias = tuple[Scenarios, Floats]
"""Scenarios, and parameters of the policies to race, shape (k, P)."""


class Evaluation(NamedTuple):
    """Coordinates, own crashes and wins of K policies."""

    #: shape (K, G): Mean over all segments of races, in the characteristics' units.
    coordinates: Floats
    #: shape (K,): Share of the races that ended by a crash of the policy's own fault.
    own_crash: Floats
    spread: Floats  #: shape (K, G): Standard error of the coordinates over draws of the races.
    won: Floats  #: shape (K,): Share of races won by the policy.
    score: Floats  #: shape (K,): Score against rivals (win 1, tie 1/2); 1 without rivals.


def race_policies(task: PolicyTask, threads: int | None = None) -> Arrays:
    """Race some policies in some scenarios; a policy's result does not depend on the others of the
    task.

    The arrays are ``totals`` (k, R, G): sums over the segments begun in each race;
    ``segments`` (k, R): number of segments begun; ``own_crash`` (k, R): True if the race ended by a
    crash of the policy's own fault; ``crashed`` (k, R): True if the race ended by a crash;
    ``winner`` (k, R): 0 the policy, 1 its opponent, -1 none; ``rival`` (k, R): True if the opponent
    is a rival.
    """
    raced = race_segments(task, threads)
    values, progress, sums, time = (
        raced.pop(name) for name in ("values", "progress", "sums", "time")
    )
    begun = ~np.isnan(values[..., 0])
    totals = np.zeros((*values.shape[:2], values.shape[3]))
    # A fixed order of segments gives the same sums for every shape of the task.
    for k in range(values.shape[2]):
        totals += np.where(begun[:, :, k, None], values[:, :, k], 0.0)
    segments = begun.sum(axis=2)
    for g, axis in enumerate(get_characteristics(task[0].characteristics)):
        if axis.pooled:
            for k in range(len(values)):
                whole = Segment(progress[k], sums[k], time[k], task[0].segment_seconds)
                totals[k, :, g] = _pooled(axis, whole, segments[k])
    return {"totals": totals, "segments": segments.astype(np.int16), **raced}


def _pooled(axis: Characteristic, races: Segment, segments: NDArray[np.int64]) -> Floats:
    """Return totals of the races of one policy, shape (R,), for a pooled value.

    The sum of the totals, divided by the sum of the ``segments``, is the pooled value. The totals
    differ by the contribution of each race (from the value without this race), so that their spread
    is the spread of the pooled value: the jackknife.
    """

    def value(progress: Floats, sums: Floats, time: Floats) -> Floats:
        return axis.evaluate(Segment(progress, sums, time, races.duration))[:, 0]

    parts = (races.progress, races.sums, races.time)
    everything = [part.sum(axis=0, keepdims=True) for part in parts]
    pooled = value(*everything)[0]
    without = value(*(whole - part for whole, part in zip(everything, parts, strict=True)))
    influence = (without.mean() - without) * (1.0 - 1.0 / len(without))
    return np.asarray(segments * pooled + influence * segments.sum())


def race_segments(task: PolicyTask, threads: int | None = None) -> Arrays:
    """Race some policies in some scenarios, and measure every segment of every race.

    ``values`` (k, R, S, G) are the characteristics of the policy in each of the S segments of a
    race; NaN in segments that the race did not begin. ``progress`` (k, R, 2), ``sums`` (k, R, 2, 9)
    and ``time`` (k, R) describe whole races; see :func:`race_policies` for the other arrays.
    """
    scenarios, parameters = task
    axes = get_characteristics(scenarios.characteristics)
    planner = get_planner(scenarios.planner)
    count, races = len(parameters), len(scenarios)
    number = round(scenarios.config.duration / scenarios.segment_seconds)
    values = np.full((count, races, number, len(axes)), np.nan)
    winner = np.zeros((count, races), np.int8)
    own_crash, crashed = np.zeros((count, races), np.bool_), np.zeros((count, races), np.bool_)
    progress, sums, time = (
        np.zeros((count, races, 2)),
        np.zeros((count, races, 2, len(SUMS))),
        np.zeros((count, races)),
    )
    length = round(scenarios.segment_seconds * 100.0)
    families = opponent_families(scenarios, planner)
    for (index, source), (family, members) in product(enumerate(scenarios.tracks), families):
        setup = RaceSetup(as_track(source), scenarios.config, (planner, family))
        numbers = np.flatnonzero(
            (scenarios.track == index) & np.isin(scenarios.opponent, list(members))
        )
        drivers = pad_parameters(list(members.values()), setup.theta_size)
        own = np.pad(parameters, ((0, 0), (0, setup.theta_size - parameters.shape[1])))
        place = {opponent: row for row, opponent in enumerate(members)}
        step = max(1, RACES_AT_ONCE // len(numbers))
        for first in range(0, count, step):
            egos = np.arange(first, min(first + step, count))
            ego, which = (indices.ravel() for indices in np.meshgrid(egos, numbers, indexing="ij"))
            state = start_races(
                setup,
                Starts(scenarios.start_s[which], scenarios.side[which]),
                scenarios.seed[which],
            )
            against = drivers[[place[one] for one in scenarios.opponent[which].tolist()]]
            theta = np.ascontiguousarray(np.stack([own[ego], against], axis=1))
            for k in range(number):
                # A segment is measured from the state before it and the state after it.
                before = state.copy()
                advance(setup, state, theta, length, threads=threads)
                segment = Segment.between(before, state, scenarios.segment_seconds)
                begun = segment.time > 0.0
                measured = measure(segment, axes)[:, 0]
                if not np.isfinite(measured[begun]).all():
                    row, axis = np.argwhere(~np.isfinite(measured) & begun[:, None])[0]
                    raise InputError(
                        f"characteristic {axes[axis].name!r} is {measured[row, axis]} in race"
                        f" {which[row]} of policy {ego[row]}; it must be finite"
                    )
                # A crashed race does not continue: its remaining segments are missing, not 0.
                values[ego, which, k] = np.where(begun[:, None], measured, np.nan)
            own_crash[ego, which] = state.fault[:, 0] == 1
            crashed[ego, which] = state.crashed
            winner[ego, which] = winners(scenarios.config, state)
            whole = Segment.so_far(state, scenarios.segment_seconds)
            progress[ego, which], sums[ego, which], time[ego, which] = (
                whole.progress,
                whole.sums,
                whole.time,
            )
    rival = np.broadcast_to(scenarios.opponent >= len(scenarios.opponents), (count, races))
    judged = {"own_crash": own_crash, "crashed": crashed, "winner": winner, "rival": rival}
    return {"values": values, "progress": progress, "sums": sums, "time": time, **judged}


def opponent_families(
    scenarios: Scenarios, planner: Planner
) -> list[tuple[Planner, dict[int, Policy]]]:
    """Return the planners of the opponents, each with its opponents by number."""
    families: dict[str, tuple[Planner, dict[int, Policy]]] = {}
    drivers = [Policy(planner, theta, "opponent") for theta in scenarios.opponents]
    for number, driver in enumerate([*drivers, *map(parse_policy, scenarios.rivals)]):
        families.setdefault(driver.planner.name, (driver.planner, {}))[1][number] = driver
    return list(families.values())


def summarise(raced: Arrays) -> Evaluation:
    """Return means, shares and standard errors of the results of :func:`race_policies`.

    A coordinate is a ratio: the sum over all segments divided by their number. Its standard error
    follows from the residuals of the races (linearised; the segments of a race count as one
    observation).
    """
    totals, segments = raced["totals"], raced["segments"].astype(np.float64)
    races = totals.shape[1]
    coordinates = totals.sum(axis=1) / segments.sum(axis=1)[:, None]
    residuals = totals - coordinates[:, None] * segments[..., None]
    spread = (
        np.sqrt(races / max(races - 1, 1) * (residuals**2).sum(axis=1))
        / segments.sum(axis=1)[:, None]
    )
    won, rival = raced["winner"] == 0, raced["rival"]
    points = np.where(rival, won + 0.5 * ((raced["winner"] < 0) & ~raced["crashed"]), 0.0)
    score = np.where(rival.any(axis=1), points.sum(axis=1) / np.maximum(rival.sum(axis=1), 1), 1.0)
    return Evaluation(coordinates, raced["own_crash"].mean(axis=1), spread, won.mean(axis=1), score)


def evaluate(
    scenarios: Scenarios,
    parameters: Floats,
    *,
    executor: Executor | None = None,
    block: int = 8,
) -> Evaluation:
    """Race every policy, shape (K, P), in every scenario.

    Blocks of policies race on the executor. Without an executor they race in this thread, which
    shares the races among the cores.
    """
    parameters = check_policies("parameters", parameters, get_planner(scenarios.planner))
    tasks = [
        (scenarios, parameters[first : first + block]) for first in range(0, len(parameters), block)
    ]
    return summarise(join(run_races("evaluation", race_policies, tasks, executor=executor)))


def join(results: Sequence[Arrays]) -> Arrays:
    """Join the results of tasks along the policies."""
    return {key: np.concatenate([result[key] for result in results]) for key in results[0]}
