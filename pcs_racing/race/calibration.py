"""Calibration of a circuit for all shipped rules: its speed range and its start places.

Shipped circuits carry their calibration. Any other circuit is calibrated by driving when rules
ask for it (:mod:`pcs_racing.race.calibrating`); the result is saved in the cache folder (see
`pcs_racing.track.cache`) and depends on nothing but the circuit and the rules.
"""

import json
import time
from collections.abc import Callable

import numpy as np

from pcs_racing.base.code_cache import cache_folder
from pcs_racing.base.errors import say
from pcs_racing.base.files import parse_json
from pcs_racing.race.config import CONTEST, KNOWN_RULES, PAPER, Rules
from pcs_racing.track.cache import CALIBRATION, cache_key, load_cached, store
from pcs_racing.track.track import Calibration, Track, calibration_from_values, calibration_values


def known_rules(rules: Rules) -> Rules:
    """Return the shipped rules with the calibration for rules: of their name, else as noisy."""
    return KNOWN_RULES.get(rules.name) or (CONTEST if rules.steering_noise > 0.0 else PAPER)


def calibration_of(track: Track, rules: Rules) -> Calibration:
    """Return the calibration of a circuit for rules: its own, a cached one, or a new one.

    Rules take the calibration of the shipped rules that they change (:func:`known_rules`).
    """
    known = known_rules(rules)
    own = track.calibration.get(known.name)
    if own is not None:
        return own
    memo = (track.content_hash, known.name)
    if memo not in _known:

        def find() -> Calibration:
            from pcs_racing.race.calibrating import calibrate

            return calibrate(track, known).calibration

        _known[memo] = _cached(track, known, "speeds and start places", find)
    return _known[memo]


def starts_for(track: Track, rules: Rules) -> Calibration:
    """Return the calibration with the start places for rules.

    It is the calibration of the shipped rules if these start alike; another kind of start is tried
    by driving, once, and saved in the cache.
    """
    calibration = calibration_of(track, rules)
    if start_layout(rules) == start_layout(known_rules(rules)):
        return calibration
    # Speeds decide who gets away: a track of the same content may bring others.
    memo = (
        track.content_hash,
        calibration.speed_range,
        known_rules(rules).name,
        *start_layout(rules),
    )
    if memo not in _known:

        def find() -> Calibration:
            from pcs_racing.race.calibrating import find_places

            return find_places(track, rules, known_rules(rules), calibration.speed_range)

        _known[memo] = _cached(
            track, rules, f"places for a {rules.start} start", find, calibration.speed_range
        )
    return _known[memo]


_known: dict[tuple[object, ...], Calibration] = {}


def start_layout(rules: Rules) -> tuple[object, ...]:
    """Return the kind of start, the gap, the distance across the track and the speed."""
    return rules.start, rules.start_gap, rules.start_spacing, rules.start_speed


def _cached(
    track: Track,
    rules: Rules,
    what: str,
    find: Callable[[], Calibration],
    speed_range: tuple[float, float] | None = None,
) -> Calibration:
    """Take a calibration (for a given range of speeds) from the cache on disk, or make it, say so,
    and put it there.
    """
    known = known_rules(rules)
    text = json.dumps(
        [known.name, known.steering_noise, known.noise_time, *start_layout(rules), speed_range]
    )
    parts = {"track": track.content_hash.encode(), "rules": text.encode()}
    key = cache_key(parts, CALIBRATION)
    found = load_cached(CALIBRATION, key)
    if found is not None:
        try:
            return calibration_from_values(parse_json("the cache", str(found["values"])))
        except (KeyError, ValueError, TypeError):
            pass  # a damaged file is as good as none
    folder = cache_folder()
    kept = f"once; saved in {folder}" if folder is not None else "there is no folder to save it"
    start = time.monotonic()
    say(f"finding {what} of track {track.name!r} for {known.name!r} by driving ({kept})")
    calibration = find()
    seconds = time.monotonic() - start
    low, high = calibration.speed_range
    moved = (
        ""
        if calibration.start_spacing == rules.start_spacing
        else f", not {rules.start_spacing:g} m,"
    )
    apart = f"cars start {calibration.start_spacing:g} m{moved} apart"
    say(
        f"track {track.name!r}: pace 0 to 1 is {low:.2f} to {high:.2f} of its speed profile;"
        f" {apart} ({seconds:.1f} s)"
    )
    store(CALIBRATION, key, {"values": np.array(json.dumps(calibration_values(calibration)))})
    return calibration
