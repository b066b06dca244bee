"""Arcs by the sectors of a lidar: what `lidar-ppo` drives by, in `Drive`."""

import numpy as np
import pytest
from faces import ARCS
from refusal import refused

from pcs_racing import load_track, racer, run_races
from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import ConfigError
from pcs_racing.envs import DriveEnv
from pcs_racing.planners.field.lidar_ppo import arc_policy, read_lidar_planner
from pcs_racing.planners.planner import Planner
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts

PLAIN = Planner("plain", (), drive=lambda track, theta, view, memory: (0.0, 2.0))


@pytest.mark.parametrize("opponent", ["lattice", PLAIN])
def test_the_actions_of_lidar_ppos_network_drive_the_race_of_lidar_ppo(opponent):
    _, layers = read_lidar_planner("lidar-ppo")
    env, over = DriveEnv(**ARCS | {"duration": 6.0}, opponent=opponent), False
    seen, _ = env.reset(seed=5)
    state, begun = env.batch.state, env.batch.state.copy()
    while not over:
        seen, _, ended, late, _ = env.step(layers.forward(seen, squash=True))
        over = ended or late
    for driver in (racer("lidar-ppo"), arc_policy(layers)):
        both = driver, racer(opponent)
        setup = RaceSetup(env.track, env.batch.setup.rules, tuple(one.planner for one in both))
        start = Starts(begun.frenet[0, :1, 0], np.zeros(1, np.int64))
        race = start_races(setup, start, begun.seed)
        for name in ("cars", "frenet", "progress", "command", "handicap", "leader", "ahead"):
            getattr(race, name)[:] = getattr(begun, name)
        theta = np.stack([pad_parameters([one], setup.theta_size) for one in both], 1)
        advance(setup, race, theta, int(state.tick[0]))
        # The environment rounds to float32.
        np.testing.assert_allclose(race.cars, state.cars, atol=2e-3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"action": "arc"}, "action is 'arc' and observation 'map'"),
        ({"observation": "sectors"}, "'arc' and 'sectors' belong together"),
        (ARCS | {"time_step": 0.2}, "time_step is 0.2; with arcs it is 0.1"),
        (ARCS | {"top_speed": 4.0}, "top_speed is 4.0; with arcs it is 8.0"),
        ({"action": "arcs"}, "arcs"),
    ],
)
def test_bad_input_is_refused_by_one_line(given, said):
    refused(said, DriveEnv, **given, error=ConfigError)


def test_a_model_of_stable_baselines3_races_by_arcs(tmp_path):
    stable = pytest.importorskip("stable_baselines3")
    from pcs_racing.envs import make_sb3_vec_env

    envs = make_sb3_vec_env("drive", 4, **ARCS)
    model = stable.PPO("MlpPolicy", envs, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(32)
    model.save(tmp_path / "model.zip")
    policies = [racer(model), racer(str(tmp_path / "model.zip"))]
    np.testing.assert_array_equal(policies[0].parameters, policies[1].parameters)
    track = load_track("Pipkin")
    assert np.isfinite(run_races(track, policies, "lattice", "contest").lead).all()
    pytest.importorskip("onnx")
    from pcs_racing_agents.agents import export_onnx

    assert export_onnx(model, tmp_path / "model.onnx").is_file()
    layers = DenseLayers((np.zeros((2, 41)),), (np.zeros(2),))
    refused("sizes .* from sectors", arc_policy, layers)
