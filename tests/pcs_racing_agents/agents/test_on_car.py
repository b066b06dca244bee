"""With measured states as input, a policy gives the commands of a race."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, load_track, racer
from pcs_racing.base.compilation import kernel
from pcs_racing.envs.models import model_policy
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.shipped import SHIPPED
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, draw_starts, start_races
from pcs_racing_agents.agents import PolicyOnCar
from pcs_racing_agents.agents.on_car import scans

TRACK = "Pipkin"


@pytest.mark.parametrize("name", ["line-ppo:risk=0.5", "pure-pursuit"])
def test_the_commands_are_those_of_a_race(name):
    track, config = load_track(TRACK), load_rules("paper", steering_noise=0.0)
    policies = [racer(name), racer("pure-pursuit")]
    setup = RaceSetup(track, config, tuple(one.planner for one in policies))
    state = start_races(setup, draw_starts(track, config, 1, 0), np.zeros(1, np.uint64))
    theta = pad_parameters(policies, setup.theta_size)[None]
    on_car = PolicyOnCar(policies[0], track)
    for tick in range(0, 300, 2):
        command = on_car.command(0.01 * tick, *state.cars[0])
        advance(setup, state, theta, 2)
        np.testing.assert_allclose(command, state.command[0, 0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(on_car.path, state.path[0, 0], rtol=0.0, atol=1e-9)


def test_an_opponent_may_be_lost_and_calls_may_come_late():
    on_car = PolicyOnCar("lattice", TRACK)
    x, y, heading = on_car.track.to_cartesian([1.0, 0.0])
    own = [x, y, 0.0, 4.0, heading, 0.0, 0.0]
    x, y, heading = on_car.track.to_cartesian([2.0, 0.0])
    ahead = [x, y, 0.0, 1.0, heading, 0.0, 0.0]
    paths = []
    for time, opponent in ((0.0, None), (0.05, ahead), (0.1301, ahead), (0.5, None)):
        assert np.isfinite(on_car.command(time, own, opponent)).all()
        paths.append(on_car.path[:, 2].copy())
    np.testing.assert_array_equal(paths[0], paths[1])  # the next plan is due at 0.1 s
    assert paths[2].mean() < paths[1].mean()  # behind a slow car
    assert paths[2].mean() < paths[3].mean()  # the opponent is lost


def test_time_goes_back_with_a_reset_alone():
    on_car, new = PolicyOnCar("lattice", TRACK), PolicyOnCar("lattice", TRACK)
    x, y, heading = on_car.track.to_cartesian([1.0, 0.0])
    car = [x, y, 0.0, 4.0, heading, 0.0, 0.0]
    for time in (3.0, 3.02):
        on_car.command(time, car, car)
    refused("time is 3.0; it must be a number from 3.02", on_car.command, 3.0, car)
    assert (on_car.memory != new.memory).any()
    on_car.reset()
    assert on_car.command(0.0, car) == new.command(0.0, car)
    np.testing.assert_array_equal(on_car.memory, new.memory)


ERRORS = {"pose_noise": 0.3, "heading_bias": 0.2, "opponent_delay": 0.1, "opponent_lost": 1.0}


def test_measured_states_are_not_disturbed_again():
    body = {"width": 0.25}
    own, ahead = [
        [x, y, 0.0, speed, heading, 0.0, 0.0]
        for s, speed in ((1.0, 4.0), (2.0, 1.0))
        for x, y, heading in [load_track(TRACK).to_cartesian([s, 0.0])]
    ]
    exact, other = (PolicyOnCar("lattice", TRACK, vehicle=one) for one in (body, body | ERRORS))
    for time in (0.0, 0.1, 0.5):
        assert exact.command(time, own, ahead) == other.command(time, own, ahead)
        np.testing.assert_array_equal(exact.view, other.view)


def test_bad_input_is_refused():
    on_car = PolicyOnCar("pure-pursuit", TRACK)
    refused("car", on_car.command, 0.0, [0.0] * 6)
    refused("opponent", on_car.command, 0.0, [0.0] * 7, [np.nan] * 7)
    refused("time is -1", on_car.command, -1.0, [0.0] * 7)
    model = model_policy(lambda seen: 0.0 * seen[:, :2], name="straight")
    refused("'straight' is no compiled planner", PolicyOnCar, model, TRACK)
    refused("unknown", PolicyOnCar, "latice", TRACK)


SCANNING = {"disparity-extender", "follow-the-gap", "gap-follower", "lidar-ppo"}


def test_planners_that_scan_are_refused():
    """They would scan the map: an obstacle on the road would not be seen."""
    for name in SCANNING:
        refused(f"planner '{name}' would scan the map", PolicyOnCar, name, TRACK)
    plan = get_planner("gap-follower").plan
    own = Planner("own", (), plan=kernel(lambda *given: plan(*given)), scratch_size=10_000)
    refused("planner 'own' would scan the map", PolicyOnCar, own.policy(), TRACK)
    assert {name for name in SHIPPED if scans(get_planner(name))} == SCANNING


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        (0, 1e256, r"has x 1e\+256; it must be within \+-100000"),
        (0, 500.0, "which is not on track 'Pipkin'"),
        (3, 1e9, "has speed 1e\\+09; it must be within"),
        (4, -1e9, "has heading -1e\\+09"),
        (5, 1e5, "has yaw rate 100000"),
    ],
)
def test_states_that_no_car_on_the_track_has_are_refused(column, value, said):
    on_car = PolicyOnCar("pure-pursuit", TRACK)
    x, y, heading = on_car.track.to_cartesian([1.0, 0.0])
    car = [x, y, 0.0, 4.0, heading, 0.0, 0.0]
    wrong = [*car[:column], value, *car[column + 1 :]]
    refused(f"car .*{said}", on_car.command, 0.0, wrong)
    refused(f"opponent .*{said}", on_car.command, 0.0, car, wrong)
