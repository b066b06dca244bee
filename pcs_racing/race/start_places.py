"""Valid start places of a track, found by driving away from all places.

A place is valid if pairs of lattice policies (slow and fast, sensible and random) get away from it:
on either side, and averaged with its neighbours, hardly any race is over within the first seconds.
Neither policy could avoid such a crash by better driving afterwards, so it would be pure noise in a
table.

Side by side, most places favour one side: with any policy the car on that side leads after the
first seconds, and it mostly wins against an equal policy. Valid places are stored by the side that
they favour. Start lines are drawn from both kinds, in a ratio without an overall gain for either
side.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import BareField, advance
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.start_grid import (
    PLACE_EVERY,
    Starts,
    Stretches,
    place_on_grid,
    places_of,
    stretches_of,
)
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track

Places = dict[str, Stretches]

FIRST_SECONDS = 2.5  # s; a race that is over by then was decided by its start
PACES = (
    (0.5, 0.5),
    (0.0, 0.0),
    (1.0, 1.0),
    (0.2, 0.8),
    (0.8, 0.2),
    (0.0, 1.0),
    (1.0, 0.0),
    (0.4, 0.5),
    (0.9, 1.0),
)
RANDOM_PAIRS = 7
REPEATS = 3  # races of every pair, each with other noise
EQUALS = [k for k, (ego, rival) in enumerate(PACES) if abs(ego - rival) < 0.15]
# Max shares of races over within the first seconds; the first limit with enough places is used.
ALLOWED = (0.01, 0.02, 0.03)
ENOUGH, ENOUGH_OF_A_SIDE = 40, 12  # min numbers of places
BALANCE_PLACES, BALANCE_PAIRS = 30, 8  # max places and pairs of paces for the gain of a side
CRASH_PAIRS = 1500  # pairs of policies whose crashes are counted, in two races each
MIN_PLACES = 8  # min number of places for a spacing
NEIGHBOURS = 1  # places before and after a place that are averaged with it
BATCH = 64  # places driven at once


@cache
def _pairs() -> Floats:
    """Return the parameter vectors of the pairs that start at every place, shape (pairs, 2, P)."""
    generator = np.random.default_rng(0)
    paces = [[REFERENCE.policy({"pace": pace}).parameters for pace in pair] for pair in PACES]
    # `pace_behind` keeps its default: the first seconds are too short for it, and the start places
    # of tracks do not change.
    drawn = [
        [REFERENCE.sample(generator, fixed=("pace_behind",)) for _ in range(2)]
        for _ in range(RANDOM_PAIRS)
    ]
    return np.array(paces + drawn)


def _race_from(
    track: Track,
    rules: Rules,
    settings: KernelSettings,
    spacing: float,
    places: Floats,
    pairs: Floats,
    first_key: int,
    threads: int | None = None,
) -> tuple[RaceState, Floats]:
    """Race every pair from every place and side; return the ends, and the left car's lead, m.

    The keys of the races' noise are ``first_key`` and the numbers after it; any distinct keys would
    do.
    """
    # Every pair starts from both sides alternately, so that a strong policy does not count as a
    # gain of the side.
    starts = Starts(
        np.repeat(places, 2 * len(pairs)), np.tile(np.arange(2), len(places) * len(pairs))
    )
    theta = np.tile(np.repeat(pairs, 2, axis=0), (len(places), 1, 1))
    state = _race(track, rules, settings, spacing, starts, theta, first_key, threads)
    return state, np.where(starts.side == 0, state.lead, -state.lead)


def _race(
    track: Track,
    rules: Rules,
    settings: KernelSettings,
    spacing: float,
    starts: Starts,
    theta: Floats,
    first_key: int,
    threads: int | None = None,
) -> RaceState:
    """Drive a race from each start with the parameters of its policies, shape (races, 2, P)."""
    cars = (F1TENTH, F1TENTH)
    rules = replace(rules, laps=None)  # the settings say how long a race is
    state = place_on_grid(
        track, rules, spacing, settings.speed_low, cars, starts, REFERENCE.memory_total
    )
    state.seed[:] = np.arange(first_key, first_key + len(starts), dtype=np.uint64)
    field, ticks = BareField(track, settings, (REFERENCE, REFERENCE), cars), settings.end_tick
    advance(field, state, np.ascontiguousarray(theta), ticks, threads=threads, ittc=False)
    return state


def crashes_of_pairs(
    track: Track,
    rules: Rules,
    settings: KernelSettings,
    spacing: float,
    fit: Places,
    left_share: float,
) -> float:
    """Return the share of whole races that crash, of pairs of drawn paces from both sides of places
    everywhere.
    """
    # As start lines are drawn: so many from the places that favour the left.
    left = round(CRASH_PAIRS * left_share) if len(fit) == 2 else CRASH_PAIRS
    some = []
    for stretches, count in zip(fit.values(), (left, CRASH_PAIRS - left), strict=False):
        every = places_of(stretches)
        some.append(every[np.linspace(0, len(every) - 1, count).astype(np.intp)])
    places = np.concatenate(some)
    paces = np.random.default_rng(2).uniform(size=(CRASH_PAIRS, 2))
    theta = np.array(
        [[REFERENCE.policy({"pace": pace}).parameters for pace in pair] for pair in paces]
    )
    starts = Starts(np.repeat(places, 2), np.tile(np.arange(2), CRASH_PAIRS))
    state = _race(track, rules, settings, spacing, starts, np.repeat(theta, 2, axis=0), 0)
    return float(state.crashed.mean())


def drive_away(
    track: Track,
    rules: Rules,
    settings: KernelSettings,
    spacing: float,
    *,
    threads: int | None = None,
) -> tuple[Floats, Floats]:
    """Race pairs of policies from every place of a track, on either side, for the first seconds.

    The cars are ``spacing`` metres apart across the track; the places are 0, `PLACE_EVERY`, 2
    `PLACE_EVERY` ... m.

    Returns two arrays of shape (places,). The first is the share of races over within the first
    seconds, 1 where the cars do not fit. The second is a balance of the races between equal
    policies: the share with the car on the left (or in front) ahead at their end, minus the share
    with the other car ahead, from -1 to 1.
    """
    places = np.arange(0.0, track.length, PLACE_EVERY)
    # With noise, one race of a pair says little.
    pairs = np.concatenate([_pairs()] * (REPEATS if settings.noise_sd > 0.0 else 1))
    each = 2 * len(pairs)
    settings = settings._replace(end_tick=round(100.0 * FIRST_SECONDS))
    crashes, favour = np.empty(len(places)), np.empty(len(places))
    for first in range(0, len(places), BATCH):
        some = places[first : first + BATCH]
        state, left = _race_from(
            track, rules, settings, spacing, some, pairs, first * each, threads
        )
        crashes[first : first + BATCH] = state.crashed.reshape(len(some), each).mean(axis=1)
        lead = np.sign(left).reshape(len(some), len(pairs), 2)
        favour[first : first + BATCH] = lead[:, EQUALS].mean(axis=(1, 2))
    return crashes, favour


def fit_places(
    track: Track, rules: Rules, settings: KernelSettings, spacings: Sequence[float]
) -> tuple[float, Places, float]:
    """Find the valid start places of a track, with the first feasible of several spacings (m).

    Returns three values. The first is the spacing, the distance of the cars across the track. The
    second maps each favoured side ("left" and "right", or "front" for starts one behind the other)
    to the stretches of its places, arc lengths of the first and the last place, m, ascending. The
    third is the share of start lines on places that favour the left, 0.5 for starts one behind the
    other.
    """
    for spacing in spacings:
        crashes, favour = drive_away(track, rules, settings, spacing)
        together = np.mean(
            [np.roll(crashes, shift) for shift in range(-NEIGHBOURS, NEIGHBOURS + 1)], axis=0
        )
        abreast = rules.start == "side-by-side"
        sides = (
            {"left": favour > 0.0, "right": favour < 0.0}
            if abreast
            else {"front": np.full(len(favour), True)}
        )
        # As strict as possible: a laxer limit is taken only where the strict limit leaves too few
        # places.
        for allowed in ALLOWED:
            fit = (together <= allowed) & (crashes < 1.0)
            found = {name: fit & side for name, side in sides.items()}
            counts = [np.count_nonzero(here) for here in found.values()]
            enough = sum(counts) >= ENOUGH and min(counts) >= ENOUGH_OF_A_SIDE
            if enough or (allowed == ALLOWED[-1] and sum(counts) >= MIN_PLACES):
                places = {name: stretches_of(here) for name, here in found.items() if here.any()}
                share = 0.5
                if len(places) == 2:
                    gains = [
                        _gain(track, rules, settings, spacing, places[side])
                        for side in ("left", "right")
                    ]
                    share = _left_share(*gains)
                return float(spacing), places, share
    tried = ", ".join(f"{spacing:g}" for spacing in spacings)
    raise InputError(
        f"track {track.name!r} has no place where two cars get away from a {rules.start} start"
        f" with gap {rules.start_gap:g} m at {rules.start_speed:g} m/s, {tried} m apart;"
        " widen the track, or set another start in the rules"
    )


def _gain(
    track: Track, rules: Rules, settings: KernelSettings, spacing: float, stretches: Stretches
) -> float:
    """Return the share of full races from some places that the left car wins, minus 0.5."""
    places = places_of(stretches)
    places = places[
        np.linspace(0, len(places) - 1, min(len(places), BALANCE_PLACES)).astype(np.intp)
    ]
    paces = np.random.default_rng(1).uniform(size=(BALANCE_PAIRS, 2))
    pairs = np.array(
        [[REFERENCE.policy({"pace": pace}).parameters for pace in pair] for pair in paces]
    )
    state, left = _race_from(track, rules, settings, spacing, places, pairs, 0)
    left = left[~state.crashed]
    return float((left > 0.0).mean()) - 0.5 if len(left) else 0.0


def _left_share(left: float, right: float) -> float:
    """Return the share of lines on left-favouring places that cancels the gains of the left car.

    If the left car gains, or loses, on both kinds of places, all lines go to the kind with the
    smaller effect.
    """
    if left * right >= 0.0:
        return 1.0 if abs(left) < abs(right) else 0.0 if abs(right) < abs(left) else 0.5
    return round(abs(right) / (abs(left) + abs(right)), 2)
