"""Models that were trained at the wheel race as they drove in their environment, wherever a policy races."""

import pickle

import numpy as np
import pytest
from refusal import refused

from pcs_racing import draw_starts, load_race_config, parse_policy, run_races
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
from pcs_racing.envs.models import model_policy, save_model

RIVAL = "lattice:pace=0.3"
CONFIG = load_race_config("paper", duration=3.0)
SEEING = {"beams": 9, "time_step": 0.05, "own_pose": True, "normalized": False, "time_left": True}


def weave(seen):
    """Steering and speed of units that follow from all that is observed."""
    return np.stack([0.2 * np.sin(seen.sum(axis=1)), 1.0 + 0.5 * np.cos(seen[:, 0])], axis=1)


@pytest.mark.parametrize("arguments", [{}, SEEING])
def test_a_model_races_as_it_drives_in_its_environment(oval, arguments):
    policy, starts = model_policy(weave, **arguments), draw_starts(oval, CONFIG, 4, 3)
    raced = run_races(oval, policy, parse_policy(RIVAL), CONFIG, seed=3, starts=starts)
    for race in range(4):
        env = DriveEnv(oval, RIVAL, CONFIG, **arguments)
        seen, _ = env.reset(options={"start": (float(starts.s[race]), int(starts.side[race]))})
        ended = False
        while not ended:
            seen, _, over, late, info = env.step(weave(seen[None])[0])
            ended = over or late
        assert info["progress"] == pytest.approx(raced.state.progress[race, 0], abs=1e-6)
        assert info["time"] == pytest.approx(raced.time[race])


def test_a_model_is_an_opponent_among_others_in_any_car(oval):
    """It sees what the agent sees, unless it brings arguments; of several it is drawn; each episode is its own."""
    policy = model_policy(weave, name="weaver", **SEEING)
    envs = DriveVectorEnv(6, track=oval, opponents=[policy, RIVAL], duration=2.0, race="contest", time_step=0.02)
    envs.reset(seed=1)
    for _ in range(25):
        *_, infos = envs.step(np.tile([0.0, -0.6], (6, 1)))
    alone = DriveEnv(oval, opponents=[policy, RIVAL], duration=2.0, race="contest", time_step=0.02)
    alone.reset(seed=3)
    for _ in range(25):
        *_, info = alone.step([0.0, -0.6])
    np.testing.assert_array_equal(info["poses"], infos["poses"][2])
    copied = pickle.loads(pickle.dumps(policy.planner))
    assert (copied.name, copied.drive.hold) == ("weaver", 5)


def test_models_of_stable_baselines3_race_from_their_file(oval, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from pcs_racing_agents.agents import as_competitor, make

    env = DriveEnv(oval, RIVAL, beams=5, time_step=0.2)
    rows = np.random.default_rng(0).normal(size=(9, 46)).astype(np.float32)
    for kind, more in ((sb3.PPO, {}), (sb3.SAC, {"buffer_size": 10}), (sb3.TD3, {"buffer_size": 10})):
        model = kind("MlpPolicy", env, seed=1, device="cpu", **more)
        file = save_model(tmp_path / kind.__name__, model)
        kept, given = model_policy(file), model_policy(model)
        expected = model.predict(rows, deterministic=True)[0]
        np.testing.assert_allclose(np.clip(kept.planner.drive.model.predict(rows)[0], -1.0, 1.0), expected, atol=1e-5)
        assert kept.planner.drive.content_hash == given.planner.drive.content_hash
        assert (kept.planner.drive.hold, len(kept.planner.drive.options.look_ahead)) == (20, 6)
        first, second = (run_races(oval, one, parse_policy(RIVAL), CONFIG, seed=2) for one in (kept, given))
        np.testing.assert_array_equal(first.state.cars, second.state.cars)
        assert make(str(file)).planner.drive.content_hash == as_competitor(model).planner.drive.content_hash
        seen, _ = DriveEnv(oval, str(file), CONFIG).reset(seed=1)
        assert seen.shape == (41,)
    refused(r"observation_space \(46,\); with these arguments of Drive it is \(41,\)", model_policy, model, beams=0)
    file.with_suffix(".yaml").unlink()
    refused(r"TD3\.yaml with the arguments", model_policy, file)


def test_what_no_model_may_answer_is_one_line(oval):
    class Remembering:
        def predict(self, seen, state, first, deterministic):
            return seen[:, :2], "state"

    for model, message in (
        (lambda seen: seen, r"finite numbers of shape \(1, 2\)"),
        (lambda seen: np.nan * seen[:, :2], "finite numbers"),
        (Remembering(), "keeps a state"),
    ):
        refused(message, run_races, oval, model_policy(model), parse_policy(RIVAL), CONFIG)
    refused("beam", model_policy, weave, beam=3)
