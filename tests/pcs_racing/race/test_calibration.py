"""The hazard of driving alone grows with speed, and the speed range follows from it."""

from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest
from refusal import refused

from pcs_racing import run_races
from pcs_racing.base.errors import ConfigError
from pcs_racing.envs.random_circuits import RandomCircuits, _calibration, random_circuit
from pcs_racing.race import start_places
from pcs_racing.race.calibrating import (
    FRICTION_SCALE,
    SCALES,
    CalibrationReport,
    calibrate,
    hazard_scan,
)
from pcs_racing.race.calibration import calibration_of, starts_for
from pcs_racing.race.config import CONTEST, KNOWN_RULES, PAPER
from pcs_racing.race.driving import kernel_settings
from pcs_racing.race.start_grid import BLOCK, PLACE_EVERY, Starts, places_of, split_places
from pcs_racing.race.start_places import crashes_of_pairs, drive_away, fit_places
from pcs_racing.track.frenet import KAPPA
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Calibration


def test_faster_is_riskier_and_threads_change_nothing():
    track = load_track("Kestrelheim")
    scales = (1.0, 1.45, 1.8)
    quiet = hazard_scan(track, PAPER, scales, cars=12)
    disturbed = hazard_scan(track, CONTEST, scales, cars=40)
    assert (quiet[:2] < 0.1).all()
    assert quiet[2] > 0.9
    assert disturbed[0] < 0.1 < disturbed[1] < 0.9 < disturbed[2]
    track = load_track("Pipkin")
    one, two = (
        hazard_scan(track, CONTEST, (1.0, 1.1), cars=12, seconds=10.0, threads=n) for n in (1, 2)
    )
    np.testing.assert_array_equal(one, two)


@pytest.fixture(scope="module")
def report():
    """Calibrate a circuit as it was done for the file that ships, in fewer races."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(start_places, "CRASH_PAIRS", 150)
        return calibrate(load_track("Pipkin"), PAPER, cars=40)


def test_the_range_lies_below_the_speeds_that_crash(report):
    assert report.calibration == load_track("Pipkin").calibration["paper"]
    low, high = report.calibration.speed_range
    assert 0.5 < low < high <= FRICTION_SCALE
    assert high - low == pytest.approx(0.30)
    crashing = [
        scale for scale, hazard in zip(report.scales, report.hazard, strict=True) if hazard > 0.10
    ]
    assert crashing
    assert high < min(crashing)


def test_the_scan_ends_where_the_hazard_is_too_large_and_a_rough_circuit_is_refused():
    track = load_track("Pipkin")
    whole = hazard_scan(track, PAPER, SCALES, cars=12)
    part = hazard_scan(track, PAPER, SCALES, cars=12, enough=0.01)
    assert len(part) < len(whole)
    np.testing.assert_array_equal(part, whole[: len(part)])
    assert part[-1] > 0.01 >= part[:-1].max()
    rough = replace(CONTEST, steering_noise=0.2)
    refused(r"Pipkin.*0\.60.*steering_noise", calibrate, load_track("Pipkin"), rough, cars=12)


def test_without_noise_the_range_falls_until_pairs_crash_as_rarely_as_the_aim_says(
    monkeypatch, capsys
):
    track = load_track("Pipkin")
    known = track.calibration["paper"]
    fits = []

    def fit(track, config, settings, spacings):
        fits.append(settings.speed_high)
        return known.start_spacing, known.start_places, known.left_share

    monkeypatch.setattr("pcs_racing.race.calibrating.fit_places", fit)
    for shares, lowered in ((iter([0.07]), 0.0), (iter([0.2, 0.1, 0.04]), 0.1), (repeat(0.3), 0.3)):
        monkeypatch.setattr(
            "pcs_racing.race.calibrating.crashes_of_pairs",
            lambda *arguments, shares=shares: next(shares),
        )
        fits.clear()
        low, high = calibrate(track, PAPER, cars=12).calibration.speed_range
        # Start places belong to the range that is kept.
        assert fits[-1] == high == pytest.approx(fits[0] - lowered)
        assert high - low == pytest.approx(0.30)
        said = (
            "two cars crash in 30% of the races of 'paper', in more than the aim of 8%, even with"
            " speeds lowered by 0.3"
        )
        assert (said in capsys.readouterr().err) == (lowered == 0.3)
    # contest aims at a car alone
    monkeypatch.setattr("pcs_racing.race.calibrating.crashes_of_pairs", None)
    assert calibrate(track, CONTEST, cars=12).calibration.speed_range[1] <= FRICTION_SCALE


def test_pairs_of_a_slow_range_crash_less(monkeypatch):
    monkeypatch.setattr(start_places, "CRASH_PAIRS", 60)
    track = load_track("Pipkin")
    known = track.calibration["paper"]
    settings = kernel_settings(PAPER, (1.1, 1.4))
    start = known.start_spacing, known.start_places, known.left_share
    fast, slow = (
        crashes_of_pairs(
            track, PAPER, settings._replace(speed_low=low, speed_high=low + 0.3), *start
        )
        for low in (1.4, 0.8)
    )
    assert slow < 0.05 < fast


def test_circuits_ship_with_all_rules_and_as_noisy_ones_share_their_speeds():
    for name in list_tracks():
        known = load_track(name).calibration
        assert set(known) == set(KNOWN_RULES)
        assert known["roboracer"].speed_range == known["contest"].speed_range


def test_a_hazard_is_counted_in_crashes_whatever_a_contact_does():
    track, scales = load_track("Pipkin"), (1.5,)
    restarts = replace(CONTEST, contact="restart", most_faults=3)
    assert (
        hazard_scan(track, restarts, scales, cars=12)
        == hazard_scan(track, CONTEST, scales, cars=12)
        > 0.1
    )


def test_a_circuit_without_a_calibration_is_calibrated_once_and_says_so(
    report, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path))
    own, asked = replace(load_track("Pipkin"), calibration={}), []

    def calibrated(*given):
        asked.append(given)
        return report

    def forget():
        monkeypatch.setattr("pcs_racing.race.calibration._known", {})

    monkeypatch.setattr("pcs_racing.race.calibrating.calibrate", calibrated)
    forget()
    found = calibration_of(own, PAPER)
    assert found == report.calibration
    said = capsys.readouterr().err
    assert "finding speeds and start places of track 'Pipkin' for 'paper'" in said
    assert str(tmp_path) in said
    assert calibration_of(own, PAPER) is found  # from memory
    forget()
    assert calibration_of(own, replace(PAPER, duration=5.0)) == found  # from the folder
    assert capsys.readouterr().err == ""
    assert asked == [(own, PAPER)]
    (kept,) = tmp_path.glob("calibration-*.npz")
    kept.write_bytes(b"damaged")
    forget()
    assert calibration_of(own, PAPER) == found
    assert len(asked) == 2


def test_another_kind_of_start_is_tried_out_by_driving(tmp_path, monkeypatch, oval, capsys):
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path))
    rolling = replace(PAPER, start="rolling", start_gap=3.0)
    found = starts_for(oval, rolling)
    assert list(found.start_places) == ["front"]
    assert found.speed_range == oval.calibration["paper"].speed_range
    assert "places for a rolling start of track 'oval'" in capsys.readouterr().err
    assert starts_for(oval, rolling) == found
    assert capsys.readouterr().err == ""


def test_a_report_is_a_table():
    places = {"left": ((0.0, 1.5),), "right": ((2.0, 2.0), (4.0, 4.5))}
    report = CalibrationReport(
        "oval", "paper", (0.6, 0.65), (0.0, 0.25), Calibration((0.75, 1.05), 0.8, places)
    )
    assert report.table().splitlines() == [
        "oval, paper: speed range 0.75 to 1.05",
        "start places: 4 that favour the left, 3 that favour the right; cars 0.8 m apart",
        "scale  own crash per 40 s",
        " 0.60    0.0%  ",
        " 0.65   25.0%  ##########",
    ]


def test_an_odd_number_of_cars_is_refused():
    for cars in [0, 1, 7]:
        refused(f"cars is {cars}", hazard_scan, load_track("Pipkin"), PAPER, cars=cars)


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


def test_a_spacing_at_which_no_cars_fit_is_refused(oval):
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
