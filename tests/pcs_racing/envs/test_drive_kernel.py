"""A step of the control-level environment against the same in a few lines of numpy; quick as plain
Python, too.
"""

import numpy as np
import pytest
from placed_cars import BETA, DELTA, HOLD, PSI, PSI_DOT, V

from pcs_racing import load_rules
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.race.start_grid import settle

TOP = 8.0
AHEAD = (0.0, 1.5, 30.0, 49.0)
RACE = load_rules(
    "contest", start_lines=3, steering_noise=0.0, sight=2.0 * np.pi, front_pace=(1.0, 1.0)
)


def begun(track, opponent=None, rules=RACE, seed=0, duration=8.0, **options):
    env = DriveEnv(
        track=track, opponent=opponent, rules=rules, look_ahead=AHEAD, duration=duration, **options
    )
    env.reset(seed=seed)
    return env


def put(env, poses, speeds=(0.0, 0.0)):
    """Let the cars of a running environment stand at (s, d); both have driven s so far."""
    races, track = env.batch.state, env.track
    for car, (s, d) in enumerate(poses[: env.batch.cars]):
        x, y, psi = track.to_cartesian([s, d])
        races.cars[0, car] = x, y, 0.0, speeds[car], np.mod(psi, 2.0 * np.pi), 0.0, 0.0
        races.progress[0, car] = s
    settle(track, env.batch.setup.vehicles, races)
    return races


def action(steer, speed):
    return np.array([steer / F1TENTH.steer_max, 2.0 * speed / TOP - 1.0], np.float64)


def wrapped(angle):
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def expected_observation(env, command):
    """By the names of the elements."""
    state, track = env.batch.state, env.track
    own, other, line, ds = state.cars[0, 0], state.cars[0, -1], track.line, track.arrays.ds
    (s, d), (other_s, other_d) = (track.to_frenet(car[:2]) for car in (own, other))
    seen = {
        "speed": own[V],
        "steering": own[DELTA],
        "yaw rate": own[PSI_DOT],
        "slip": wrapped(own[BETA]),
        "target steering": command[0],
        "target speed": command[1],
        "offset": d,
        "heading error": wrapped(own[PSI] - track.to_cartesian([s, 0.0])[2]),
    }
    for distance in AHEAD:
        sample = line[(int(s / ds) + round(distance / ds)) % len(line)]
        for name, value in zip(
            ("curvature", "line speed", "right", "left"), sample[[5, 6, 7, 8]], strict=True
        ):
            seen[f"{name} {distance:g} m ahead"] = value
    toward = np.array([np.cos(own[PSI]), np.sin(own[PSI])])
    leftward = np.array([-toward[1], toward[0]])
    way = other[:2] - own[:2]
    course, other_course = own[PSI] + own[BETA], other[PSI] + other[BETA]
    speed = other[V] * np.array([np.cos(other_course), np.sin(other_course)])
    speed -= own[V] * np.array([np.cos(course), np.sin(course)])
    length = track.length
    rival = {
        "opponent": 1.0,
        "opponent gap": np.mod(other_s - s + 0.5 * length, length) - 0.5 * length,
        "opponent offset": other_d - d,
        "opponent x": way @ toward,
        "opponent y": way @ leftward,
        "opponent heading": wrapped(other[PSI] - own[PSI]),
        "opponent vx": speed @ toward,
        "opponent vy": speed @ leftward,
        "lead": state.progress[0, 0] - state.progress[0, -1],
    }
    return seen | {name: 0.0 if env.batch.cars == 1 else value for name, value in rival.items()}


@pytest.mark.parametrize(
    "opponent", [HOLD.policy({"steer": 0.05, "speed": 3.0}), None], ids=["rival", "alone"]
)
@pytest.mark.parametrize(
    "places", [((9.0, 0.3), (13.0, -0.3)), ((48.5, -0.4), (0.9, 0.2)), ((0.4, 0.1), (46.0, 0.3))]
)
def test_the_observation_is_what_its_elements_say(coarse_oval, opponent, places):
    """Also across the start line, where an opponent ahead has a smaller arc length."""
    env = begun(coarse_oval, opponent)
    put(env, places, (4.0, 2.0))
    command = (0.1, 4.4)
    for _ in range(2):
        seen, *_ = env.step(action(*command))
    found = {element.name: value for element, value in zip(env.elements, seen, strict=True)}
    expected = expected_observation(env, command)
    # The line's heading between two samples follows from the curvature of the first one.
    assert found.pop("heading error") == pytest.approx(expected.pop("heading error"), abs=2e-3)
    assert found == pytest.approx(expected, abs=2e-4)


def test_normalised_observations_run_from_minus_one_to_one_between_the_bounds(coarse_oval):
    plain, scaled = (
        begun(coarse_oval, HOLD.policy(), seed=3, normalize=normalize)
        for normalize in (False, True)
    )
    for _ in range(3):
        seen, scaled_seen = (env.step(action(0.2, 5.0))[0] for env in (plain, scaled))
    low, high = (
        np.array([getattr(element, name) for element in plain.elements]) for name in ("low", "high")
    )
    steered = ["speed" not in element.name for element in plain.elements]
    assert ((low == 0.0) | (low == -high))[steered].all()  # as far to the left as to the right
    np.testing.assert_allclose(scaled_seen, 2.0 * (seen - low) / (high - low) - 1.0, atol=1e-6)
    np.testing.assert_allclose(
        [scaled.observation_space.low[0], scaled.observation_space.high[0]], [-1.0, 1.0]
    )
    np.testing.assert_allclose(plain.observation_space.low, low, rtol=1e-6)


def test_what_lies_beyond_the_bounds_is_shown_at_the_bound(coarse_oval):
    env = begun(coarse_oval, HOLD.policy(), seed=3)
    env.batch.state.progress[0] = 5000.0, 0.0
    seen, *_ = env.step(action(0.0, 1.0))
    assert (
        dict(zip([element.name for element in env.elements], seen, strict=True))["lead"] == 1000.0
    )


@pytest.mark.parametrize(
    ("given", "steer", "speed"),
    [((0.5, 0.0), 0.5, 4.0), ((-3.0, 9.0), -1.0, 8.0), ((3.0, -9.0), 1.0, 0.0)],
)
def test_actions_are_shares_of_the_largest_steering_angle_and_of_the_top_speed(
    coarse_oval, given, steer, speed
):
    env = begun(coarse_oval)
    env.step(np.array(given))
    np.testing.assert_allclose(env.batch.state.memory[0, 0, :2], [steer * F1TENTH.steer_max, speed])


@pytest.mark.parametrize("opponent", [HOLD.policy({"speed": 3.0}), None])
def test_the_reward_is_the_own_progress_less_a_share_of_the_opponents(coarse_oval, opponent):
    env = begun(coarse_oval, opponent, progress_reward=2.0, rivalry=0.25)
    races = put(env, ((6.0, 0.4), (2.0, -0.4)), (2.0, 3.0))
    for _ in range(3):
        before = races.progress[0].copy()
        _, reward, ended, late, _ = env.step(action(0.0, 2.0))
        own, *others = races.progress[0] - before
        assert reward == pytest.approx(2.0 * (own - 0.25 * sum(others)))
        assert own > 0.1
        assert not ended
        assert not late


def test_episodes_are_drawn_from_all_places_both_sides_and_all_opponents(coarse_oval):
    opponents = [HOLD.policy({"speed": speed}) for speed in (1.0, 2.0)]
    options = DriveOptions(track=coarse_oval, opponent=opponents, rules=RACE, start_lines=3)
    batch = DriveBatch(64, options, threads=1)
    rows = np.arange(64)
    batch.restart(rows, [np.random.default_rng(k) for k in rows])
    places = {tuple(np.round(cars[:, :2].ravel(), 3)) for cars in batch.state.cars}
    assert len(places) == 2 * 3 == batch.circuit(0).grid.races
    assert sorted(set(batch.drawn)) == [0, 1]
    np.testing.assert_array_equal(batch.theta[:, 1, 1], np.where(batch.drawn == 0, 1.0, 2.0))
    assert len(set(batch.state.seed)) == 64
