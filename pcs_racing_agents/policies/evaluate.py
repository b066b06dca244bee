"""Evaluation of policies by races: the ``eval`` of Algorithm 1, in tasks for any worker.

Races for a comparison have the same tracks, starts, opponents and noise for every policy. Every
policy meets every pair of start line and opponent, from both sides of the grid, on every track. All
draws happen once per run, so that policies differ by their driving and not by chance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, TypeAlias, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats, Indices
from pcs_racing.envs.random_circuits import RandomCircuits, find_speeds, random_circuit
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.game.reward import reward, sum_winners
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, race_keys, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track
from pcs_racing_agents.base.jobs import Arrays, Run, run_races

GENERATED = "generated-"
"""Beginning of the name of a circuit that is generated where it is raced; its number follows."""


@dataclass(frozen=True, eq=False)
class Scenarios:
    """The R races of every policy."""

    tracks: tuple[str, ...]  #: Names or folders, which workers load or generate themselves.
    config: Rules  #: Rules and duration.
    planner: str  #: Planner of the policies and of their opponents, except for rivals.
    characteristics: tuple[str, ...]
    segment_seconds: float  #: Length of the segments averaged in coordinates, s.
    opponents: Floats  #: shape (O, P): Parameters of the opponents.
    #: Policies of other planners, numbered after the opponents; texts for :func:`pcs_racing.racer`.
    rivals: tuple[str, ...]
    track: Indices  #: shape (R,): Index of the track of each race, ascending.
    start_s: Floats  #: shape (R,): Start line, m.
    side: Indices  #: shape (R,): Side of the start; 0 if the policy starts on the left or in front.
    seed: NDArray[np.uint64]  #: shape (R,): Noise key.
    opponent: Indices  #: shape (R,): Index of the opponent; rivals start at O.

    def __len__(self) -> int:
        return len(self.track)


class Evaluation(NamedTuple):
    """Coordinates, own crashes and scores of K policies."""

    #: shape (K, G): Mean over all segments of races, in the characteristics' units.
    coordinates: Floats
    #: shape (K,): Share of the races that ended by a crash of the policy's own fault.
    own_crash: Floats
    spread: Floats  #: shape (K, G): Standard error of the coordinates over draws of the races.
    score: Floats  #: shape (K,): Mean score (win 1, tie 1/2).


def circuit(source: str, rules: Rules) -> Track:
    """Return a circuit by its name or folder, or generate it with speeds found for the rules."""
    number = source.removeprefix(GENERATED)
    if number == source or not number.isdecimal():
        return as_track(source)
    return _generated(int(number), replace(rules, duration=None))


@cache
def _generated(number: int, rules: Rules) -> Track:
    return find_speeds(random_circuit(RandomCircuits(), number), rules)


def draw_scenarios(
    planner: str,
    tracks: Sequence[str],
    rules: Rules,
    *,
    opponents: Floats | None = None,
    rivals: Sequence[str] = (),
    characteristics: Sequence[str] = ("speed",),
    segment_seconds: float | None = None,
    starts: int,
    seed: int,
) -> Scenarios:
    """Draw races on every track: all pairs of start lines and opponents, from both sides.

    Parameters
    ----------
    planner : str
        Planner of the policies and of the opponents.
    rules : Rules
        Rules and duration of the races.
    opponents : ndarray, shape (O, P), optional
        Parameters of policies, met in addition to the rivals.
    rivals : sequence of str
        Policies of any planner; format of :func:`pcs_racing.racer`.
    segment_seconds : float, optional
        Length of the segments whose mean is a coordinate, s; the whole race by default.
    starts : int
        Number of start lines on each track.
    seed : int
        Root seed of start lines and noise.

    Returns
    -------
    Scenarios
        ``tracks * starts * (opponents + rivals) * 2`` races.
    """
    if opponents is None:
        opponents = np.zeros((0, len(get_planner(planner).parameters)))
    count = len(opponents) + len(rivals)
    line, opponent, side = (indices.ravel() for indices in np.mgrid[:starts, :count, :2])
    start_s, seeds = [], []
    for index, track in enumerate(tracks):
        # Each track has its own root: another track in the list changes no race on this track.
        lines, noise = np.random.SeedSequence(seed, spawn_key=(index,)).spawn(2)
        places = start_lines(circuit(track, rules), replace(rules, start_lines=starts), lines)
        start_s.append(places[line])
        key = int(noise.generate_state(1, np.uint64)[0])
        seeds.append(race_keys(rules, key, np.arange(len(line))))
    return Scenarios(
        tracks=tuple(tracks),
        config=rules,
        planner=planner,
        characteristics=tuple(characteristics),
        segment_seconds=rules.seconds if segment_seconds is None else segment_seconds,
        opponents=opponents,
        rivals=tuple(rivals),
        track=np.repeat(np.arange(len(tracks)), len(line)),
        start_s=np.concatenate(start_s),
        side=np.tile(side, len(tracks)),
        seed=np.concatenate(seeds),
        opponent=np.tile(opponent, len(tracks)),
    )


PolicyTask: TypeAlias = tuple[Scenarios, Floats]
"""Scenarios, and parameters of the policies to race, shape (k, P)."""


def race_in_blocks(
    name: str, scenarios: Scenarios, parameters: Floats, block: int, **run: Unpack[Run]
) -> Arrays:
    """Race policies as tasks of this name, ``block`` policies each; see :func:`race_policies`."""
    tasks = [(scenarios, parameters[k : k + block]) for k in range(0, len(parameters), block)]
    results = run_races(name, race_policies, tasks, **run)
    return {key: np.concatenate([result[key] for result in results]) for key in results[0]}


def race_policies(task: PolicyTask, threads: int | None = None) -> Arrays:
    """Race some policies in some scenarios; a policy's result does not depend on the others of the
    task.

    The arrays are ``totals`` (k, R, G): sums of the characteristics over the segments begun in each
    race; ``segments`` (k, R): number of segments begun; ``own_crash`` (k, R): True if the race
    ended by a crash of the policy's own fault; ``crashed`` (k, R): True if the race ended by a
    crash; ``winner`` (k, R): 0 the policy, 1 its opponent, -1 none.
    """
    scenarios, parameters = task
    raced: Arrays = {}
    for setup, races, opponents in _meetings(scenarios):
        own = np.pad(parameters, ((0, 0), (0, setup.theta_size - parameters.shape[1])))
        ego, row = (indices.ravel() for indices in np.indices((len(own), len(races))))
        theta = np.ascontiguousarray(np.stack([own[ego], opponents[row]], axis=1))
        for key, values in _drive(setup, scenarios, races[row], theta, threads).items():
            empty = np.zeros((len(own), len(scenarios), *values.shape[1:]), values.dtype)
            raced.setdefault(key, empty)[ego, races[row]] = values
    progress, sums, time = (raced.pop(key) for key in ("progress", "sums", "time"))
    for g, axis in enumerate(get_characteristics(scenarios.characteristics)):
        for k in range(len(parameters) if axis.pooled else 0):
            whole = Segment(progress[k], sums[k], time[k], scenarios.segment_seconds)
            raced["totals"][k, :, g] = _pooled(axis, whole, raced["segments"][k])
    return raced


def _meetings(scenarios: Scenarios) -> Iterator[tuple[RaceSetup, Indices, Floats]]:
    """Yield the races of each track and planner of opponents: setup, numbers of the races, and the
    opponent's parameters in each of them.
    """
    own = get_planner(scenarios.planner)
    drawn = [Policy(own, theta, "opponent") for theta in scenarios.opponents]
    opponents = [*drawn, *map(policy_racer, scenarios.rivals)]
    families = {policy.planner.name: policy.planner for policy in opponents}
    for index, source in enumerate(scenarios.tracks):
        for family in families.values():
            members = [k for k, one in enumerate(opponents) if one.planner.name == family.name]
            setup = RaceSetup(circuit(source, scenarios.config), scenarios.config, (own, family))
            races = np.flatnonzero(
                (scenarios.track == index) & np.isin(scenarios.opponent, members)
            )
            theta = pad_parameters([opponents[k] for k in members], setup.theta_size)
            yield setup, races, theta[np.searchsorted(members, scenarios.opponent[races])]


def _drive(
    setup: RaceSetup, scenarios: Scenarios, race: Indices, theta: Floats, threads: int | None
) -> Arrays:
    """Drive races of these numbers, and measure the first car; arrays with an entry per race."""
    axes = get_characteristics(scenarios.characteristics)
    state = start_races(
        setup, Starts(scenarios.start_s[race], scenarios.side[race]), scenarios.seed[race]
    )
    seconds = scenarios.segment_seconds
    totals = np.zeros((len(race), len(axes)))
    segments = np.zeros(len(race), np.int16)
    for _ in range(round(scenarios.config.seconds / seconds)):
        # A segment is measured from the state before it and the state after it.
        before = state.copy()
        advance(setup, state, theta, round(seconds * 100.0), threads=threads)
        segment = Segment.between(before, state, seconds)
        # A crashed race does not continue: its remaining segments are missing, not 0.
        begun = segment.time > 0.0
        values = measure(segment, axes)[:, 0]
        wrong = ~np.isfinite(values) & begun[:, None]
        if wrong.any():
            row, axis = np.argwhere(wrong)[0]
            raise InputError(
                f"characteristic {axes[axis].name!r} is {values[row, axis]} in race {race[row]};"
                " it must be finite"
            )
        totals += np.where(begun[:, None], values, 0.0)
        segments += begun
    winner, crashed = winners(scenarios.config, state), state.crashed
    if scenarios.config.legs == 2:
        # Legs are neighbours. Each has the winner of its series, and no leg was a no-contest.
        leads = reward(scenarios.config, state, np.zeros(len(race), np.int64))
        winner = np.repeat(sum_winners(scenarios.config, leads[::2] + leads[1::2]), 2)
        crashed = np.zeros(len(race), np.bool_)
    whole = Segment.so_far(state, seconds)
    return {
        "totals": totals,
        "segments": segments,
        "own_crash": state.fault[:, 0] == 1,
        "crashed": crashed,
        "winner": winner,
        "progress": whole.progress,
        "sums": whole.sums,
        "time": whole.time,
    }


def _pooled(axis: Characteristic, races: Segment, segments: Indices) -> Floats:
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


def race_points(raced: Arrays) -> Floats:
    """Return the points of each race, shape (K, R): 1 for a win, 1/2 for a tie, else 0."""
    tie = (raced["winner"] < 0) & ~raced["crashed"]
    return np.asarray((raced["winner"] == 0) + 0.5 * tie, np.float64)


def summarise(raced: Arrays) -> Evaluation:
    """Return means, shares and standard errors of the results of :func:`race_policies`.

    A coordinate is a ratio: the sum over all segments divided by their number. Its standard error
    follows from the residuals of the races (linearised; the segments of a race count as one
    observation).
    """
    totals, segments = raced["totals"], raced["segments"].astype(np.float64)
    races, begun = totals.shape[1], segments.sum(axis=1)[:, None]
    coordinates = totals.sum(axis=1) / begun
    residuals = totals - coordinates[:, None] * segments[..., None]
    spread = np.sqrt(races / max(races - 1, 1) * (residuals**2).sum(axis=1)) / begun
    score = race_points(raced).mean(axis=1)
    return Evaluation(coordinates, raced["own_crash"].mean(axis=1), spread, score)
