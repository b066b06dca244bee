"""Random tracks: generated from numbers, in threads, while other tracks are in use."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Interval

from pcs_racing.base.errors import ConfigError, MapError
from pcs_racing.base.settings import OneOf, Settings
from pcs_racing.race.calibration import known_rules
from pcs_racing.race.config import KNOWN_RULES, Rules, load_rules
from pcs_racing.race.start_grid import PLACE_EVERY, stretches_of
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.frenet import KAPPA
from pcs_racing.track.loading import as_track
from pcs_racing.track.mapping.circuits import generate_circuit
from pcs_racing.track.mapping.shapes import STYLES
from pcs_racing.track.track import Calibration, Track

SPEED_RANGES = {"paper": (0.66, 0.86), "contest": (0.65, 0.97), "roboracer": (0.65, 0.97)}
"""Speed scales of pace 0 and 1: below the scales of most shipped tracks, as a generated track gets
no test drives."""
BENDS = 0.12  # 1/m: start places are where the line bends less than this
BEFORE, AHEAD = 2.0, 8.0  # m: stretch before and after a start place for that limit
TRIES = 20  # max generator seeds per track; hardly one seed in a hundred fails
KEPT = 64  # tracks cached in addition to the tracks in use
THREADS = 2  # threads that build tracks


@dataclass(frozen=True)
class RandomCircuits(Settings):
    """Tracks generated from numbers; the same number always gives the same track."""

    episodes: Annotated[
        int,
        Interval(ge=1, le=1_000_000),
        "Episodes of an environment before it gets another circuit.",
    ] = 1
    count: Annotated[int, Interval(ge=1, le=2**31), "Number of different circuits."] = 10_000
    style: Annotated[
        str | None,
        OneOf(STYLES),
        "Style of the generator (`pcs-racing track generate`); None mixes all of them.",
    ] = None
    width: Annotated[float, Interval(ge=1.6, le=10.0), "Width of the track, m."] = 2.2
    shortest: Annotated[
        float, Interval(ge=16.0, le=1000.0), "Min length of the centre line, m."
    ] = 60.0
    longest: Annotated[float, Interval(ge=16.0, le=1000.0), "Max length of the centre line, m."] = (
        120.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 10.0 * self.width <= self.shortest < self.longest:
            raise ConfigError(
                f"shortest is {self.shortest:g} and longest {self.longest:g} m; they must ascend"
                " from 10 widths"
            )


def random_circuit(settings: RandomCircuits, index: int) -> Track:
    """Generate track number ``index``; a function of settings and index alone.

    Its speed ranges are fixed, and its start places lie where the race line is nearly straight.
    ``pcs-racing track generate`` makes tracks with both found by driving.
    """
    refusal: MapError | None = None
    for attempt in range(TRIES):
        rng = np.random.default_rng(np.random.SeedSequence(index, spawn_key=(attempt,)))
        # A new seed for each attempt: the generator has already tried many drafts of the last seed.
        style = settings.style or list(STYLES)[rng.integers(len(STYLES))]
        direction = ("counterclockwise", "clockwise")[rng.integers(2)]
        try:
            made = generate_circuit(
                int(rng.integers(2**31)),
                style,
                width=settings.width,
                length_range=(settings.shortest, settings.longest),
                direction=direction,
                attempts=100,
            )
            track = build_track(
                f"random-{index}",
                made.occupied,
                made.resolution,
                made.origin,
                made.centerline,
                made.raceline,
            )
            track.calibration.update(
                {name: _calibration(track, rules) for name, rules in KNOWN_RULES.items()}
            )
        except MapError as error:
            refusal = error
            continue
        return track
    raise MapError(f"no circuit from {settings} in {TRIES} attempts: {refusal}")


def find_speeds(track: Track | str, rules: Rules | str = "contest", *, threads: int = 1) -> Track:
    """Return a circuit with the speed range that short test drives find for rules, in a second.

    The circuit is a track, a name or a folder; its ranges for other rules stay.

    The speed range of :func:`random_circuit` is low, and the same for all circuits. A network that
    learns on circuits with found speeds meets the speeds of calibrated ones.

    Examples
    --------
    >>> made = find_speeds(random_circuit(RandomCircuits(), 3))
    >>> made.calibration["contest"].speed_range[1] > 0.97
    True
    """
    from pcs_racing.race.calibrating import find_speed_range  # with planners, which others lack

    track, known = as_track(track), known_rules(load_rules(rules))
    found = find_speed_range(track, known, threads=threads)
    own = replace(track.calibration[known.name], speed_range=found)
    return replace(track, calibration=track.calibration | {known.name: own})


def _calibration(track: Track, rules: Rules) -> Calibration:
    kappa = np.abs(track.arrays.line[:, KAPPA])
    places = np.arange(0.0, track.length, PLACE_EVERY)
    steps = np.arange(-BEFORE, AHEAD, PLACE_EVERY)
    index = np.mod(places[:, None] + steps, track.length) / track.arrays.ds
    bend = kappa[index.astype(np.intp) % len(kappa)].max(axis=1)
    fit = bend < BENDS
    if not fit.any():
        raise MapError(f"track {track.name!r} has no straight to start from")
    return Calibration(SPEED_RANGES[rules.name], rules.start_spacing, {"front": stretches_of(fit)})


class CircuitBuilder:
    """Tracks by number: built once, in threads ahead of their use, and cached while there is room.

    The track of a number depends only on the settings, not on the time of the request. ``room`` is
    the number of tracks in use at the same time.
    """

    def __init__(self, settings: RandomCircuits, room: int = 1) -> None:
        self.settings = settings
        # It starts threads when there is work for them.
        self._pool = ThreadPoolExecutor(THREADS, "pcs-racing-circuits")
        #: Cache: tracks in use, an equal number of tracks built ahead, and some earlier tracks.
        self._made = lru_cache(maxsize=2 * room + KEPT)(self._begin)

    def _begin(self, index: int) -> "Future[Track]":
        return self._pool.submit(random_circuit, self.settings, index)

    def ahead(self, index: int) -> None:
        """Start to build a track, unless its build was started before."""
        self._made(index)

    def get(self, index: int) -> Track:
        """Return a track; wait until it is built."""
        return self._made(index).result()

    def close(self) -> None:
        """Stop the threads; a track requested later is built again."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = ThreadPoolExecutor(THREADS, "pcs-racing-circuits")
        self._made.cache_clear()
