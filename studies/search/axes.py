"""Characteristics of strong policies: which two say most about how they differ."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import load_race_config
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.races import RaceSetup, advance, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState
from pcs_racing.track.loading import as_track
from pcs_racing_agents.policies.evaluate import Scenarios, draw_scenarios, race_policies, summarise

Floats = NDArray[np.float64]

NAMES = ("speed", "reaction", "restraint", "smoothness", "blocking", "cornering", "aggressiveness")
WATCHED = ("distance", "side", "passing")
"""Further characteristics, sampled twice a second: mean distance to a car ahead within 6 m, m; mean
distance across the track from a car within 2 m, m; time of the first lead from behind, s.
"""
NEAR, BESIDE, SAMPLE = 6.0, 2.0, 50  # m, m, ticks


def axis_rows(
    theta: Floats, rivals: Sequence[str], tracks: Sequence[str], *, margin: float = 0.1
) -> list[tuple[str, ...]]:
    """Return correlations of characteristics over policies within a margin of the best score.

    The last two columns are the standard deviation between policies, and the mean standard error of
    a policy's value over races.
    """
    scenarios = draw_scenarios(
        "lattice",
        tracks,
        load_race_config("contest", duration=40.0),
        rivals=rivals,
        characteristics=NAMES,
        segment_seconds=8.0,
        starts=4,
        seed=77,
    )
    found = summarise(race_policies((scenarios, theta)))
    strong = found.score >= np.sort(found.score)[-3:].mean() - margin
    seen = watched(scenarios, theta[strong])
    values = np.column_stack([found.coordinates[strong], np.nanmean(seen, axis=1)])
    error = np.nanstd(seen, axis=1) / np.sqrt(np.isfinite(seen).sum(axis=1))
    errors = np.column_stack([found.spread[strong], error])
    together = np.corrcoef(values.T)
    names = [one.name for one in get_characteristics(NAMES)] + list(WATCHED)
    rows = [
        (name, *(f"{x:+.2f}" for x in together[k]), f"{s:.4f}", f"{e:.4f}")
        for k, (name, s, e) in enumerate(
            zip(names, values.std(axis=0), np.sqrt((errors**2).mean(axis=0)), strict=True)
        )
    ]
    head = (f"{strong.sum()} of {len(theta)} policies", *names, "between", "error")
    return [head, *rows]


def watched(scenarios: Scenarios, theta: Floats) -> Floats:
    """Return the watched characteristics of K policies in each race, (K, R, 3); NaN without any."""
    values = np.full((len(theta), len(scenarios), len(WATCHED)), np.nan)
    own = get_planner("lattice")
    for t, track in enumerate(scenarios.tracks):
        for o, text in enumerate(scenarios.rivals):
            rival = parse_policy(text)
            races = np.flatnonzero((scenarios.track == t) & (scenarios.opponent == o))
            setup = RaceSetup(as_track(track), scenarios.config, (own, rival.planner))
            starts = Starts(scenarios.start_s[races], scenarios.side[races])
            for k, policy in enumerate(theta):
                cars = [
                    np.pad(policy, (0, setup.theta_size - len(policy))),
                    pad_parameters([rival], setup.theta_size)[0],
                ]
                both = np.ascontiguousarray(np.broadcast_to(cars, (len(races), *np.shape(cars))))
                state = start_races(setup, starts, scenarios.seed[races])
                values[k, races] = _watch(setup, state, both)
    return values


def _watch(setup: RaceSetup, state: RaceState, theta: Floats) -> Floats:
    length = setup.track.length
    distance: list[Floats] = []
    side: list[Floats] = []
    first = np.full(len(theta), np.nan)
    began_behind = state.progress[:, 0] < state.progress[:, 1]
    for step in range(setup.config.ticks // SAMPLE):
        before = state.tick.copy()
        advance(setup, state, theta, SAMPLE, ittc=False)
        runs = state.tick > before
        gap = state.progress[:, 1] - state.progress[:, 0]
        apart = np.abs(gap - length * np.rint(gap / length))
        distance.append(np.where(runs & (gap > 0.0) & (apart < NEAR), apart, np.nan))
        across = np.abs(state.frenet[:, 0, 1] - state.frenet[:, 1, 1])
        side.append(np.where(runs & (apart < BESIDE), across, np.nan))
        leads = began_behind & (gap < 0.0) & np.isnan(first)
        first[leads] = (step + 1) * SAMPLE / 100.0
    return np.column_stack(
        [_mean(distance), _mean(side), np.where(began_behind & np.isnan(first), 40.0, first)]
    )


def _mean(samples: list[Floats]) -> Floats:
    """Return the mean of each race's samples; NaN without any."""
    values = np.array(samples)
    count = np.isfinite(values).sum(axis=0)
    return np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)
