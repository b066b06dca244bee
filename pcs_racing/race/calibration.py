"""Calibration of a circuit for each race preset: its speed range and its start places.

Shipped circuits carry their calibration. Any other circuit is calibrated by driving when a preset
asks for it (:mod:`pcs_racing.race.calibrating`); the result is kept in the cache folder (see
`pcs_racing.track.cache`) and depends on nothing but the circuit and the preset.
"""

import json
import time
from collections.abc import Callable

import numpy as np

from pcs_racing.base.code_cache import cache_folder
from pcs_racing.base.errors import say
from pcs_racing.base.files import parse_json
from pcs_racing.race.config import CONTEST, PAPER, PRESETS, RaceConfig
from pcs_racing.track.cache import CALIBRATION, cache_key, load_cached, store
from pcs_racing.track.track import Calibration, Track, calibration_from_values, calibration_values


def preset_of(config: RaceConfig) -> RaceConfig:
    """The preset whose calibration serves a configuration: the one of its name, else one that is as
    noisy.
    """
    return PRESETS.get(config.name) or (CONTEST if config.steering_noise > 0.0 else PAPER)


def calibration_of(track: Track, config: RaceConfig) -> Calibration:
    """The calibration of a circuit for a race configuration: the circuit's own, a cached one, or a
    new one.

    A configuration takes the calibration of the preset that it changes, or of one that is as noisy
    (:func:`preset_of`).
    """
    preset = preset_of(config)
    own = track.calibration.get(preset.name)
    if own is not None:
        return own
    memo = (track.content_hash, preset.name)
    if memo not in _known:

        def find() -> Calibration:
            from pcs_racing.race.calibrating import calibrate

            return calibrate(track, preset).calibration

        _known[memo] = _cached(track, preset, "speeds and start places", find)
    return _known[memo]


def starts_for(track: Track, config: RaceConfig) -> Calibration:
    """The calibration that says where a configuration starts.

    It is the preset's if the configuration starts as its preset does; another kind of start is
    tried out by driving, once, and kept in the cache.
    """
    calibration = calibration_of(track, config)
    if start_layout(config) == start_layout(preset_of(config)):
        return calibration
    # Speeds decide who gets away: a track of the same content may bring others.
    memo = (
        track.content_hash,
        calibration.speed_range,
        preset_of(config).name,
        *start_layout(config),
    )
    if memo not in _known:

        def find() -> Calibration:
            from pcs_racing.race.calibrating import find_places

            return find_places(track, config, preset_of(config), calibration.speed_range)

        _known[memo] = _cached(
            track, config, f"places for a {config.start} start", find, calibration.speed_range
        )
    return _known[memo]


_known: dict[tuple[object, ...], Calibration] = {}


def start_layout(config: RaceConfig) -> tuple[object, ...]:
    """Kind of start, gap, distance across the track and speed of a configuration."""
    return config.start, config.start_gap, config.start_spacing, config.start_speed


def _cached(
    track: Track,
    config: RaceConfig,
    what: str,
    find: Callable[[], Calibration],
    speed_range: tuple[float, float] | None = None,
) -> Calibration:
    """Take a calibration (for a given range of speeds) from the cache on disk, or make it, say so,
    and put it there.
    """
    preset = preset_of(config)
    rules = json.dumps(
        [preset.name, preset.steering_noise, preset.noise_time, *start_layout(config), speed_range]
    )
    parts = {"track": track.content_hash.encode(), "rules": rules.encode()}
    key = cache_key(parts, CALIBRATION)
    found = load_cached(CALIBRATION, key)
    if found is not None:
        try:
            return calibration_from_values(parse_json("the cache", str(found["values"])))
        except (KeyError, ValueError, TypeError):
            pass  # a damaged file is as good as none
    folder = cache_folder()
    kept = f"once; kept in {folder}" if folder is not None else "there is no folder to keep it in"
    start = time.monotonic()
    say(f"finding {what} of track {track.name!r} for {preset.name!r} by driving ({kept})")
    calibration = find()
    seconds = time.monotonic() - start
    low, high = calibration.speed_range
    moved = (
        ""
        if calibration.start_spacing == config.start_spacing
        else f", not {config.start_spacing:g} m,"
    )
    apart = f"cars start {calibration.start_spacing:g} m{moved} apart"
    say(
        f"track {track.name!r}: pace 0 to 1 is {low:.2f} to {high:.2f} of its speed profile;"
        f" {apart} ({seconds:.1f} s)"
    )
    store(CALIBRATION, key, {"values": np.array(json.dumps(calibration_values(calibration)))})
    return calibration
