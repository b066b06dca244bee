"""Sight of the cars, and the slower car in front at the start."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, strategies as st
from placed_cars import HOLD, placed, view_of
from refusal import refused

from pcs_racing import load_rules, load_track, run_races
from pcs_racing.base.errors import ConfigError
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.vehicle import F1TENTH, V, VehicleParams
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.planners.view import VIEW
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, draw_starts, race_keys, start_races
from pcs_racing.race.sensing import out_of_sight

BESIDE, AHEAD, BEHIND = (5.0, -0.5), (7.0, 0.0), (3.0, 0.0)
angles = st.floats(-7.0, 7.0)


@given(angles, angles, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.1, 6.28))
def test_a_car_is_out_of_sight_when_all_its_corners_are(psi, opp_psi, x, y, sight):
    car = VehicleParams(lidar_x=0.2, lidar_y=0.05, lidar_yaw=0.1)
    row = np.array([1.0, 2.0, 0.0, 0.0, psi, 0.0, 0.0])
    lidar = 1.0 + 2.0j + (0.2 + 0.05j) * np.exp(1j * psi)
    corners = np.array([1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
    corners = corners.real * 0.29 + 1j * corners.imag * 0.155
    seen = (x + 1.0 + 1j * (y + 2.0) + corners * np.exp(1j * opp_psi) - lidar) / np.exp(
        1j * (psi + 0.1)
    )
    angle = np.abs(np.angle(seen))
    if np.abs(angle - 0.5 * sight).min() > 1e-6:
        body = Rectangle(x + 1.0, y + 2.0, opp_psi, 0.29, 0.155)
        assert out_of_sight.py_func(row, car.as_row(), body, sight) == (angle > 0.5 * sight).all()


def seen_by(track, *places, car=F1TENTH, **rules):
    vehicles = (car, *(F1TENTH,) * (len(places) - 1))
    setup, state, _ = placed(track, places, vehicles=vehicles, **rules)
    return dict(zip(VIEW, view_of(setup, state, 0, 0), strict=True))


def test_planners_see_no_car_behind_them(coarse_oval):
    for place, hidden in ((BESIDE, False), (AHEAD, False), (BEHIND, True)):
        seen = seen_by(coarse_oval, (5.0, 0.0), place, sight=4.7)
        whole = seen_by(coarse_oval, (5.0, 0.0), place)
        assert (seen["OPP_D"] == 1e6) == hidden
        assert hidden or seen == whole
        assert seen["TRUE_OPP_X"] == whole["TRUE_OPP_X"]  # for lidars
    assert seen["GAP"] == -0.5 * coarse_oval.length  # it is not in front
    nearest = seen_by(coarse_oval, (5.0, 0.0), (4.0, 0.0), (9.0, 0.0), sight=4.7)
    assert nearest["OPP_S"] == pytest.approx(9.0)


def test_a_late_car_is_seen_where_it_was_when_it_was_seen(coarse_oval):
    """A faster car comes out of the blind spot: its driver appears .1 s late."""
    late = VehicleParams(opponent_delay=0.1)
    found = []
    for car in (F1TENTH, late):
        places, speeds = ((5.0, -0.4), (2.5, 0.4)), [1.0, 4.0]
        setup, state, theta = placed(
            coarse_oval, places, speeds, vehicles=(car, F1TENTH), sight=4.7
        )
        seen = []
        for _ in range(40):
            seen.append(view_of(setup, state, 0, 0)[list(VIEW).index("OPP_D")] != 1e6)
            advance(setup, state, theta, 2, threads=1)
        found.append(np.array(seen))
    assert 0 < found[0].argmax() < 30
    assert found[1].argmax() == found[0].argmax() + 5


def test_observations_of_drive_hold_cars_in_sight_only():
    track = load_track("Pipkin")
    rules = load_rules("paper", sight=4.7)
    env = DriveEnv(track=track, opponents=["pure-pursuit"] * 2, rules=rules)
    element = [one.name for one in env.elements].index
    poses = track.to_cartesian([(20.0, 0.0), (18.5, 0.0), (23.0, 0.0)])
    row = env.reset(seed=0, options={"poses": poses})[0]
    assert row[element("opponent gap")] == pytest.approx(3.0)
    assert row[element("opponent")] == 1.0
    assert row[element("opponent 2")] == row[element("opponent 2 gap")] == 0.0


def test_the_car_in_front_at_the_start_is_slower(oval):
    rules = load_rules("contest", front_pace=(0.8, 0.9))
    setup = RaceSetup(oval, rules, (HOLD, HOLD))
    starts, keys = draw_starts(oval, rules, 40, 3), race_keys(rules, 3, np.arange(40))
    state = start_races(setup, starts, keys)
    front = state.handicap[np.arange(40), starts.side]
    assert (state.handicap[np.arange(40), 1 - starts.side] == 0.0).all()
    assert front.min() > 0.1
    assert front.max() < 0.2
    assert front.std() > 0.02
    np.testing.assert_array_equal(front[::2], front[1::2])  # both legs have the same draws
    theta = np.tile([0.0, 4.0], (40, 2, 1))
    state.cars[..., V] = 4.0
    advance(setup, state, theta, 80)
    np.testing.assert_allclose(state.cars[..., V], 4.0 * (1.0 - state.handicap), atol=0.02)
    beside = load_rules("contest", start="side-by-side")
    setup = RaceSetup(oval, beside, (HOLD, HOLD))
    assert not start_races(setup, draw_starts(oval, beside, 4, 0), keys[:4]).handicap.any()


def test_a_driver_knows_its_handicap_and_planners_drive_safely_with_it(oval):
    env = gym.make("pcs_racing/Drive-v1", rules="contest", opponent="lattice")
    known = set()
    for seed in range(8):
        row, info = env.reset(seed=seed)
        assert row[-1] == np.float32(info["handicap"])
        known.add(info["handicap"] > 0.0)
    assert known == {True, False}
    assert "handicap" not in gym.make("pcs_racing/Drive-v1").reset(seed=0)[1]
    rules = load_rules("contest", front_pace=(0.8, 0.8), steering_noise=0.0, duration=20.0)
    crashed = run_races(oval, ["lattice"] * 8, "pure-pursuit", rules).own_crash
    assert crashed.mean() < 0.2


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("sight", 0.0, "sight is 0.0; it must be a number from 0.1 to 6.28"),
        ("sight", 400.0, "sight is 400.0"),
        ("front_pace", [0.9, 1.1], r"it must be \[low, high\]"),
        ("front_pace", 0.9, r"it must be \[low, high\]"),
    ],
)
def test_impossible_rules_are_refused(field, value, text):
    refused(text, load_rules, "contest", error=ConfigError, **{field: value})
