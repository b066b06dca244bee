"""Start places are the places where pairs of drivers get away."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, PAPER, load_track, run_races
from pcs_racing.base.errors import ConfigError
from pcs_racing.envs.random_circuits import RandomCircuits, _calibration, random_circuit
from pcs_racing.race import start_places
from pcs_racing.race.driving import kernel_settings
from pcs_racing.race.start_grid import BLOCK, PLACE_EVERY, Starts, places_of, split_places
from pcs_racing.race.start_places import drive_away, fit_places
from pcs_racing.track.frenet import KAPPA
from pcs_racing.track.maps import list_tracks


@pytest.fixture(scope="module")
def driven(oval):
    """How the first seconds go at every place of the oval, at a reckless speed."""
    return drive_away(oval, PAPER, kernel_settings(PAPER, (1.2, 1.5)), 0.9)


def test_what_is_counted_at_a_place_is_what_races_from_there_do(oval, driven):
    crashes, favour = driven
    place = int(np.flatnonzero((crashes > 0.0) & (crashes < 1.0))[0])
    pairs = start_places._pairs()
    rules = replace(PAPER, speed_range=(1.2, 1.5), duration=start_places.FIRST_SECONDS)
    starts = Starts(np.full(2 * len(pairs), place * PLACE_EVERY), np.tile([0, 1], len(pairs)))
    twice = np.repeat(pairs, 2, axis=0)
    egos, rivals = (
        [start_places.REFERENCE.policy(theta) for theta in twice[:, car]] for car in range(2)
    )
    result = run_races(oval, egos, rivals, rules, starts=starts)
    assert result.crashed.mean() == crashes[place]
    left_leads = np.sign(np.where(starts.side == 0, result.lead, -result.lead)).reshape(-1, 2)
    assert favour[place] == left_leads[start_places.EQUALS].mean()
    again = drive_away(oval, PAPER, kernel_settings(PAPER, (1.2, 1.5)), 0.9, threads=1)
    np.testing.assert_array_equal(again, driven)


@pytest.fixture
def pretend(oval, monkeypatch):
    """Let the races at the places of the oval go as a test says: crashes by spacing, and the side
    that is favoured.
    """

    def pretend_so(crashes, favour=None):
        count = len(np.arange(0.0, oval.length, PLACE_EVERY))
        alternating = (
            np.where(np.arange(count) < count // 2, 1.0, -1.0) if favour is None else favour
        )
        monkeypatch.setattr(
            start_places,
            "drive_away",
            lambda *given, **named: (np.zeros(count) + crashes[given[3]], alternating),
        )
        monkeypatch.setattr(
            start_places, "_gain", lambda *given: 0.2 if given[4][0][0] == 0.0 else -0.1
        )
        return count

    return pretend_so


def test_the_first_spacing_that_works_is_taken_and_the_front_may_be_favoured(oval, pretend):
    count = pretend({0.9: 1.0, 1.0: 0.5, 0.8: 0.0, 1.1: 0.0})
    spacing, places, share = fit_places(
        oval, PAPER, kernel_settings(PAPER, (0.8, 1.0)), [0.9, 1.0, 0.8, 1.1]
    )
    assert spacing == 0.8
    assert share == 0.33
    half = count // 2 * PLACE_EVERY
    assert places == {
        "left": ((0.0, half - PLACE_EVERY),),
        "right": ((half, (count - 1) * PLACE_EVERY),),
    }
    count = pretend({0.45: 0.0})
    places = fit_places(oval, CONTEST, kernel_settings(CONTEST, (0.8, 1.0)), [0.45])[1]
    assert places == {"front": ((0.0, (count - 1) * PLACE_EVERY),)}


def test_stretches_hold_the_places_that_are_fit_and_training_and_tests_share_them(oval, pretend):
    crashes = np.ones(pretend({0.45: 0.0}))
    crashes[10:30] = 0.0
    crashes[50:70] = 0.0
    pretend({0.45: crashes})
    stretches = fit_places(oval, CONTEST, kernel_settings(CONTEST, (0.8, 1.0)), [0.45])[1]["front"]
    # The outermost places have a neighbour that always crashes.
    assert stretches == ((11 * PLACE_EVERY, 28 * PLACE_EVERY), (51 * PLACE_EVERY, 68 * PLACE_EVERY))
    np.testing.assert_array_equal(
        places_of(stretches) / PLACE_EVERY, [*range(11, 29), *range(51, 69)]
    )
    places = np.arange(0.0, 40.0, PLACE_EVERY)
    train, test = (split_places(places, split) for split in ("train", "test"))
    np.testing.assert_array_equal(np.sort(np.concatenate([train, test])), places)
    assert (train // BLOCK % 2 == 1).all()
    assert (test // BLOCK % 2 == 0).all()
    places = np.array([0.0, 0.5, 2.0, 4.0, 4.5, 6.0, 8.0, 8.5])
    np.testing.assert_array_equal(split_places(places, "train"), places[1::2])
    np.testing.assert_array_equal(split_places(places, "test"), places[::2])


def test_where_the_left_gains_more_it_gets_fewer_lines_and_none_where_cars_do_not_fit(oval):
    gains = [
        (0.2, -0.1, 0.33),
        (0.1, -0.3, 0.75),
        (0.1, -0.1, 0.5),
        (0.1, 0.3, 1.0),
        (-0.2, -0.1, 0.0),
    ]
    for left, right, share in gains:
        assert start_places._left_share(left, right) == share
        if left * right < 0.0:
            assert share * left + (1.0 - share) * right == pytest.approx(0.0, abs=0.005)
    settings = kernel_settings(PAPER, (0.8, 1.0))
    assert (drive_away(oval, PAPER, settings, 2.2)[0] == 1.0).all()
    refused(
        r"track 'oval' has no place .* side-by-side start .* 2.2 m apart",
        fit_places,
        oval,
        PAPER,
        settings,
        [2.2],
    )


def test_a_side_gains_what_it_wins_of_whole_races_from_some_of_its_places(oval, monkeypatch):
    """From 30 places at most, spread over all; races that ended in a crash do not count."""
    asked, crashed = [], np.array([False, False, True, False])

    def race(track, config, settings, spacing, places, pairs, key):
        asked.append((spacing, places.tolist(), len(pairs), key))
        return SimpleNamespace(crashed=crashed), np.array([3.0, -1.0, 5.0, 2.0])

    monkeypatch.setattr(start_places, "_race_from", race)
    gains = [
        start_places._gain(oval, PAPER, None, 0.9, stretches)
        for stretches in (((0.0, 19.5),), ((2.0, 4.0),))
    ]
    crashed[:] = True
    assert start_places._gain(oval, PAPER, None, 0.9, ((2.0, 4.0),)) == 0.0
    assert gains == pytest.approx([2 / 3 - 0.5] * 2)
    some = (0.5 * np.linspace(0, 39, 30).astype(int)).tolist()
    assert asked == [(0.9, places, 8, 0) for places in (some, *[[2.0, 2.5, 3.0, 3.5, 4.0]] * 2)]


def test_more_crashes_are_allowed_only_where_places_are_few(oval, pretend):
    crashes = np.full(pretend({0.9: 0.0}), 0.018)
    crashes[:60] = 0.0
    settings = kernel_settings(PAPER, (0.8, 1.0))
    pretend({0.9: crashes}, np.where(np.arange(len(crashes)) % 2, 1.0, -1.0))
    few = fit_places(oval, PAPER, settings, [0.9])[1]
    assert max(stretches[-1][1] for stretches in few.values()) == 59 * PLACE_EVERY
    # no safe place favours the right
    pretend({0.9: crashes}, np.where(np.arange(len(crashes)) < 70, 1.0, -1.0))
    many = fit_places(oval, PAPER, settings, [0.9])[1]
    assert many["right"] == ((70 * PLACE_EVERY, (len(crashes) - 1) * PLACE_EVERY),)


def test_shipped_circuits_start_where_hardly_a_race_is_over_at_once():
    rng = np.random.default_rng(5)
    over, races = 0, 40
    for name in list_tracks():
        for config in (PAPER, CONTEST):
            short = replace(config, duration=2.0)
            paces = rng.uniform(size=(2, races))
            egos, rivals = (
                [start_places.REFERENCE.policy({"pace": pace}) for pace in car] for car in paces
            )
            over += int(run_races(load_track(name), egos, rivals, short, seed=2).crashed.sum())
    assert over <= 0.02 * 2 * races * len(list_tracks())


def test_a_random_circuit_starts_where_its_line_is_nearly_straight(oval):
    """From 2 m before a place to 8 m ahead of it the line bends by less than 0.12 1/m."""
    track = random_circuit(RandomCircuits(), 3)
    assert track.name == "random-3"
    assert track.content_hash == random_circuit(RandomCircuits(), 3).content_hash
    assert {name: own.speed_range for name, own in track.calibration.items()} == {
        "paper": (0.66, 0.86),
        "contest": (0.65, 0.97),
        "roboracer": (0.65, 0.97),
    }
    for circuit in (track, oval):
        kappa, ds = np.abs(circuit.arrays.line[:, KAPPA]), circuit.arrays.ds
        expected = []
        for place in np.arange(0.0, circuit.length, 0.5):
            ahead = [
                int((place + step) % circuit.length / ds) % len(kappa)
                for step in np.arange(-2.0, 8.0, 0.5)
            ]
            if kappa[ahead].max() < 0.12:
                expected.append(place)
        known = _calibration(circuit, CONTEST)
        assert places_of(known.start_places["front"]).tolist() == pytest.approx(expected)
        assert 0 < len(expected) < circuit.length / 0.5
        assert known.start_spacing == CONTEST.start_spacing
    bends = {"width": 3.0, "shortest": 30.0, "longest": 31.0}
    assert RandomCircuits(**bends).shortest == 30.0
    for change in ({"shortest": 29.0}, {"longest": 30.0}):
        refused("must ascend from 10 widths", RandomCircuits, error=ConfigError, **bends | change)
