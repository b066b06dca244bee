"""The characteristic `speed`: how fast a car drives for its circuit, whatever the opponent does."""

import numpy as np
import pytest

from pcs_racing import RaceSetup, Starts, advance, load_race_config, load_track, start_races
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.planners.lattice import LATTICE

PACES = (0.0, 0.5, 1.0)
TOLERANCE = 0.04  # between the slowest and the fastest of the circuits, for one policy


def pieces(name, paces, preset="paper", seconds=12.0, skip=4.0):
    """Speed and lead gained, m, of both cars in races of two paces each: shape (B, 2, 2)."""
    track = load_track(name)
    config = load_race_config(preset, duration=seconds, start="rolling", start_gap=min(0.5 * track.length, 50.0))
    setup = RaceSetup(track, config, (LATTICE, LATTICE))
    starts = Starts(np.zeros(len(paces)), np.zeros(len(paces), np.int64))
    state = start_races(setup, starts, race_seeds(0, len(paces)))
    theta = np.array([[LATTICE.policy({"pace": pace}).parameters for pace in pair] for pair in paces])
    advance(setup, state, theta, round(100 * skip))
    before = state.copy()
    advance(setup, state, theta, round(100 * (seconds - skip)))
    assert not state.crashed.any()
    axes = get_characteristics(["speed", "aggressiveness"])
    return measure(Segment.between(before, state, seconds - skip), axes)


@pytest.fixture(scope="module")
def alone():
    """Speed of each of PACES on three circuits, half a lap away from the other car: shape (3, 3)."""
    names = ("Brackwater", "Kestrelheim", "Pipkin")
    return np.array([pieces(name, [(pace, pace) for pace in PACES])[:, 0, 0] for name in names])


def test_pace_is_the_same_speed_on_every_circuit(alone):
    assert np.ptp(alone, axis=0).max() < TOLERANCE
    assert np.diff(alone, axis=1).min() > 2.0 * TOLERANCE
    assert (np.diff(alone, axis=1) > 0.0).all()
    # A car brakes for a bend a little earlier than the profile.
    np.testing.assert_allclose(alone[:, -1], 0.975, atol=0.025)


def test_it_does_not_depend_on_an_opponent_who_is_far_away():
    slow, fast = pieces("Larkmoor", [(0.5, 0.0), (0.5, 1.0)])[:, 0, 0]
    assert slow == pytest.approx(fast, abs=1e-9)
