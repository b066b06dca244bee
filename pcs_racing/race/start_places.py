"""Which places of a circuit are fit to start from: found by driving away from all of them.

A place is fit if pairs of lattice policies, slow and fast, sensible and drawn at random, get away from it: on either
side and counted together with its neighbours, hardly any of their races is over within the first seconds. Every
such crash would be one that neither driver could have avoided by driving better afterwards, and so nothing but noise in
a table.

Side by side, most places favour one side: there the car on it leads after the first seconds whoever drives it, and
mostly wins against an equal. Fit places are kept by the side that they favour, and start lines are drawn from both
kinds, so many of each that neither side gains on the whole.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.driving import drive
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.start_grid import Starts, place_on_grid
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track

Floats = NDArray[np.float64]
Stretches = tuple[tuple[float, float], ...]
Places = dict[str, Stretches]

PLACE_EVERY = 0.5  # m between the places that are tried
FIRST_SECONDS = 2.5  # s; a race that is over by then was decided by its start
PACES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.2, 0.8), (0.8, 0.2), (0.0, 1.0), (1.0, 0.0), (0.4, 0.5), (0.9, 1.0))
RANDOM_PAIRS = 7
REPEATS = 3  # of every pair, under other noise
EQUALS = [k for k, (ego, rival) in enumerate(PACES) if abs(ego - rival) < 0.15]
ALLOWED = (0.01, 0.02, 0.03)  # share of races over within the first seconds: the first with places enough is taken
ENOUGH, ENOUGH_OF_A_SIDE = 40, 12  # places
BALANCE_PLACES, BALANCE_PAIRS = 30, 8  # races that tell how much a side gains: at most so many places, pairs of paces
FEWEST = 8  # places in all, without which a spacing does not work
NEIGHBOURS = 1  # places before and after that are counted together with one
BLOCK = 1.0  # m; stretches of that length serve training and tests in turn
BATCH = 64  # places driven at once


@cache
def _pairs() -> Floats:
    """Parameter vectors of the pairs that drive away from every place, shape (pairs, 2, P)."""
    generator = np.random.default_rng(0)
    paces = [[LATTICE.policy({"pace": pace}).parameters for pace in pair] for pair in PACES]
    # Without a pace of its own behind: the first seconds are too short for one, and the places of circuits stay.
    drawn = [[LATTICE.sample(generator, fixed=("pace_behind",)) for _ in range(2)] for _ in range(RANDOM_PAIRS)]
    return np.array(paces + drawn)


def _race_from(
    track: Track,
    config: RaceConfig,
    settings: KernelSettings,
    spacing: float,
    places: Floats,
    pairs: Floats,
    first_key: int,
    threads: int | None = None,
) -> tuple[RaceState, Floats]:
    """Race every pair from every place, from both sides: the ends, and the lead of the car on the left, m.

    The keys of the races' noise are ``first_key`` and those after it: any that differ will do.
    """
    # Every pair from both sides in turn, so that what the pair does well is not taken for a gain of the side.
    starts = Starts(np.repeat(places, 2 * len(pairs)), np.tile(np.arange(2), len(places) * len(pairs)))
    cars = (F1TENTH, F1TENTH)
    state = place_on_grid(track, config, spacing, settings.speed_low, cars, starts, LATTICE.memory_total)
    state.seed[:] = np.arange(first_key, first_key + len(starts), dtype=np.uint64)
    theta = np.ascontiguousarray(np.tile(np.repeat(pairs, 2, axis=0), (len(places), 1, 1)))
    settings = settings._replace(ittc_horizon=0.0)
    drive(track, settings, (LATTICE, LATTICE), cars, state, theta, settings.end_tick, threads=threads)
    return state, np.where(starts.side == 0, state.lead, -state.lead)


def drive_away(
    track: Track, config: RaceConfig, settings: KernelSettings, spacing: float, *, threads: int | None = None
) -> tuple[Floats, Floats]:
    """Start pairs of drivers at every place of a circuit, on either side, and see how the first seconds go.

    The cars are ``spacing`` metres apart across the track; the places are 0, `PLACE_EVERY`, 2 `PLACE_EVERY` ... m.

    Returned are, both of shape (places,), the share of races over within the first seconds, 1 where the cars do not
    fit; and, of the races between equals, those in which the car on the left (or in front) then leads, less those in
    which the other one does, as a share: from -1 to 1.
    """
    places = np.arange(0.0, track.length, PLACE_EVERY)
    # One race of a pair says little where chance has a part in it.
    pairs = np.concatenate([_pairs()] * (REPEATS if settings.noise_sd > 0.0 else 1))
    each = 2 * len(pairs)
    settings = settings._replace(end_tick=round(100.0 * FIRST_SECONDS))
    crashes, favour = np.empty(len(places)), np.empty(len(places))
    for first in range(0, len(places), BATCH):
        some = places[first : first + BATCH]
        state, left = _race_from(track, config, settings, spacing, some, pairs, first * each, threads)
        crashes[first : first + BATCH] = state.crashed.reshape(len(some), each).mean(axis=1)
        lead = np.sign(left).reshape(len(some), len(pairs), 2)
        favour[first : first + BATCH] = lead[:, EQUALS].mean(axis=(1, 2))
    return crashes, favour


def fit_places(
    track: Track, config: RaceConfig, settings: KernelSettings, spacings: Sequence[float]
) -> tuple[float, Places, float]:
    """Find where a circuit is fit to start from, with the first of some distances across the track (m) that works.

    Returned are that distance; for each side that places favour ("left" and "right", or "front" for starts one behind
    the other) the stretches of such places, arc lengths of the first and the last one, m, ascending; and the share of
    start lines to draw from the places that favour the left, 0.5 where cars start one behind the other.
    """
    for spacing in spacings:
        crashes, favour = drive_away(track, config, settings, spacing)
        together = np.mean([np.roll(crashes, shift) for shift in range(-NEIGHBOURS, NEIGHBOURS + 1)], axis=0)
        abreast = config.start == "side-by-side"
        sides = {"left": favour > 0.0, "right": favour < 0.0} if abreast else {"front": np.full(len(favour), True)}
        # As strict as possible: a laxer limit is taken only where the strict one leaves too few places.
        for allowed in ALLOWED:
            fit = (together <= allowed) & (crashes < 1.0)
            found = {name: fit & side for name, side in sides.items()}
            counts = [np.count_nonzero(here) for here in found.values()]
            enough = sum(counts) >= ENOUGH and min(counts) >= ENOUGH_OF_A_SIDE
            if enough or (allowed == ALLOWED[-1] and sum(counts) >= FEWEST):
                places = {name: stretches_of(here) for name, here in found.items() if here.any()}
                share = 0.5
                if len(places) == 2:
                    gains = [_gain(track, config, settings, spacing, places[side]) for side in ("left", "right")]
                    share = _left_share(*gains)
                return float(spacing), places, share
    tried = ", ".join(f"{spacing:g}" for spacing in spacings)
    raise InputError(
        f"track {track.name!r} has no place from which two cars get away from a {config.start} start with gap "
        f"{config.start_gap:g} m at {config.start_speed:g} m/s, {tried} m apart; widen the track, or set another start "
        "in the race settings"
    )


def _gain(track: Track, config: RaceConfig, settings: KernelSettings, spacing: float, stretches: Stretches) -> float:
    """Share of whole races from some places that the car on the left wins, less a half."""
    places = places_of(stretches)
    places = places[np.linspace(0, len(places) - 1, min(len(places), BALANCE_PLACES)).astype(np.intp)]
    paces = np.random.default_rng(1).uniform(size=(BALANCE_PAIRS, 2))
    pairs = np.array([[LATTICE.policy({"pace": pace}).parameters for pace in pair] for pair in paces])
    state, left = _race_from(track, config, settings, spacing, places, pairs, 0)
    left = left[~state.crashed]
    return float((left > 0.0).mean()) - 0.5 if len(left) else 0.0


def _left_share(left: float, right: float) -> float:
    """Share of lines on the places that favour the left with which the gains of the left on both kinds cancel.

    Where the left gains, or loses, on both, all lines go to the places where it does least.
    """
    if left * right >= 0.0:
        return 1.0 if abs(left) < abs(right) else 0.0 if abs(right) < abs(left) else 0.5
    return round(abs(right) / (abs(left) + abs(right)), 2)


def stretches_of(fit: NDArray[np.bool_]) -> Stretches:
    """First and last place of every run of fit ones."""
    edges = np.diff(np.concatenate([[False], fit, [False]]).astype(np.int8))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple(
        (round(first * PLACE_EVERY, 3), round(last * PLACE_EVERY, 3))
        for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True)
    )


def places_of(stretches: Stretches) -> Floats:
    """All places of some stretches, m, ascending."""
    return np.concatenate([np.arange(first, last + 0.5 * PLACE_EVERY, PLACE_EVERY) for first, last in stretches])


def split_places(places: Floats, split: str) -> Floats:
    """The places that training may use, or those that tests and tables use: every second block of 1 m is for training.

    Where the fit places lie in blocks of one kind only, every second place is for training instead.
    """
    if split not in ("train", "test"):
        raise InputError(f"split is {split!r}; it must be 'train' or 'test'")
    training = (places / BLOCK).astype(np.int64) % 2 == 1
    if min(np.count_nonzero(training), np.count_nonzero(~training)) < len(places) // 4:
        training = np.arange(len(places)) % 2 == 1
    return places[training if split == "train" else ~training]
