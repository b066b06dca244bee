"""Models that control the car race as they drove in their environment."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, racer, run_races
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.models import model_policy
from pcs_racing.race.races import draw_starts

RIVAL = "lattice:pace=0.3"
CONFIG = load_rules("paper", duration=3.0)
SEEING = {"beams": 9, "time_step": 0.05, "own_pose": True, "normalized": False, "time_left": True}


def weave(seen):
    """Steering and speed of units that follow from all that is observed."""
    return np.stack([0.2 * np.sin(seen.sum(axis=1)), 1.0 + 0.5 * np.cos(seen[:, 0])], axis=1)


@pytest.mark.parametrize("arguments", [{}, SEEING])
def test_a_model_races_as_it_drives_in_its_environment(oval, arguments):
    policy, starts = model_policy(weave, **arguments), draw_starts(oval, CONFIG, 4, 3)
    raced = run_races(oval, policy, racer(RIVAL), CONFIG, seed=3, starts=starts)
    for race in range(4):
        env = DriveEnv(track=oval, opponent=RIVAL, rules=CONFIG, **arguments)
        seen, _ = env.reset(options={"start": (float(starts.s[race]), int(starts.side[race]))})
        over = late = False
        while not (over or late):
            seen, _, over, late, info = env.step(weave(seen[None])[0])
        assert info["progress"] == pytest.approx(raced.state.progress[race, 0], abs=1e-6)
        assert info["time"] == pytest.approx(raced.time[race])


@pytest.mark.parametrize(
    ("arguments", "limit"),
    [
        ({"vehicle": [{"steer_max": 0.2}, {"steer_max": 0.6}]}, 0.2),
        ({"randomize": {"each": {"steer_max": [0.3, 0.6]}}}, 0.6),
        ({"randomize": {"car_1": {"steer_max": 0.6}}}, 0.4189),
    ],
)
def test_an_action_has_the_limits_of_the_agents_car(oval, arguments, limit):
    """As a share in the environment and for a model; opponents have limits of their own."""
    env = DriveEnv(track=oval, opponent=RIVAL, **arguments)
    env.reset(seed=1)
    env.step([1.0, 0.0])
    assert env.batch.state.memory[0, 0, 0] == pytest.approx(limit)
    steering = env.unwrapped.elements[1]
    assert steering.high == max(limit, 0.4189)
    policy = model_policy(lambda seen: np.ones((len(seen), 2)), name="left", like=env)
    assert policy.planner.drive.options.limits == env.batch.limits
    assert policy.planner.drive.options.limits.steer_max == limit


def test_a_model_is_one_of_several_opponents_and_is_sent_to_other_processes(oval):
    policy = model_policy(weave, name="weaver", **SEEING)
    env = DriveEnv(track=oval, opponents=[RIVAL, policy], time_step=0.02)
    env.reset(seed=3)
    env.step([1.0, -0.6])
    # the own command is driven, too
    assert env.batch.state.cars[0, 0, 2] == pytest.approx(3.2 * 0.02, abs=0.01)
    assert env.batch.state.memory[0, 2, 1] > 0.4
    copied = pickle.loads(pickle.dumps(policy.planner))
    assert (copied.name, copied.drive.hold) == ("weaver", 5)


def test_what_no_model_may_answer_is_one_line(oval):
    remembering = SimpleNamespace(predict=lambda seen, *_: (seen[:, :2], "state"))
    for model, message in (
        (lambda seen: seen, r"finite numbers of shape \(1, 2\)"),
        (lambda seen: np.nan * seen[:, :2], "finite numbers"),
        (remembering, "keeps a state"),
    ):
        refused(message, run_races, oval, model_policy(model), racer(RIVAL), CONFIG)
    refused("beam", model_policy, weave, beam=3)
