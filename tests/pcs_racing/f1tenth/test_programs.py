"""Programs of the gym run without an edit: small ones of the same form, and others' where there is a checkout."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY
from situations import place, write_ring

A = """
import time
from argparse import Namespace
import gym
import numpy as np
from numba import njit
from f110_gym.envs.base_classes import Integrator
from f110_gym.envs import F110Env
from pyglet.gl import GL_POINTS
import math
@njit
def turn(x):
    return math.atan2(x, 2.0)
class Slow(gym.ActionWrapper):
    def action(self, action):
        return action * 0.5
drawn = []
def callback(e):
    x, y = e.cars[0].vertices[::2], e.cars[0].vertices[1::2]
    e.left, e.right, e.top, e.bottom = min(x) - 800, max(x) + 800, max(y) + 800, min(y) - 800
    e.score_label.x = e.left
    if not drawn:
        drawn.append(e.batch.add(1, GL_POINTS, None, ('v3f/stream', [1.0, 2.0, 0.0]), ('c3B/stream', [183, 193, 222])))
    drawn[0].vertices = [3.0, 4.0, 0.0]
env = gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=2, timestep=0.01, integrator=Integrator.RK4)
env.add_render_callback(callback)
obs, step_reward, done, info = env.reset(np.array(POSES))
env.render()
laps = 0.0
while not done and laps < 0.5:
    obs, step_reward, done, info = Slow(env).step(np.array([[turn(0.1), 2.0], [0.05, 4.0]]))
    laps += step_reward
    env.render(mode='human')
assert len(drawn) == 1 and len(obs['scans'][1]) == 1080 and F110Env.current_obs is obs
assert env.observation_space is None
assert Slow(env).sim.agents[0].state[3] > 0.3
print('driven', round(laps, 2), np.float(1.0), math.atan2(np.array([0.0]), 1.0))
"""
B = """
import gymnasium as gym
import numpy as np
from f1tenth_gym.envs import F110Env
from f1tenth_gym.envs.track import Track, Raceline
from f1tenth_gym.envs.track.utils import nearest_point_on_trajectory
env = gym.make('f1tenth_gym:f1tenth-v0', render_mode='human', config={'map': MAP, 'num_agents': 3,
    'observation_config': {'type': 'kinematic_state'}, 'reset_config': {'type': 'cl_random_static'}})
track = env.unwrapped.track
env.unwrapped.add_render_callback(track.raceline.render_waypoints)
env.unwrapped.add_render_callback(lambda e: e.render_points(np.zeros((1, 2)), color=(0, 0, 128), size=2))
obs, info = env.reset(seed=1)
line = np.stack([track.raceline.xs, track.raceline.ys], axis=1)
for _ in range(30):
    action = env.action_space.sample()
    for i, name in enumerate(obs.keys()):
        _, far, _, k = nearest_point_on_trajectory(np.array([obs[name]['pose_x'], obs[name]['pose_y']]), line)
        action[i] = np.array([0.05, track.raceline.vxs[k]])
    obs, reward, done, truncated, info = env.step(action)
    env.render()
assert far < 1.0 and isinstance(env, F110Env) and obs['agent_2']['pose_x'].dtype == np.float32
s, across, turned = track.cartesian_to_frenet(*env.sim.agent_poses[0])
assert np.allclose(track.frenet_to_cartesian(s, across, turned)[:2], env.sim.agent_poses[0][:2], atol=0.02)
print('driven', round(env.current_time, 2))
"""
C = """
import gym
import numpy as np
from gym import spaces
from gym.wrappers import TimeLimit
from numba import njit
from f110_gym.envs.base_classes import Integrator
from f110_gym.envs.dynamic_models import pid, vehicle_dynamics_st
from f110_gym.envs.laser_models import ScanSimulator2D
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv
class Learning(gym.Wrapper):
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
    observation_space = spaces.Box(0.0, 40.0, (108,), np.float32)
    def step(self, action):
        obs, reward, done, info = self.env.step(np.array([[0.4 * action[0], 2.0 + action[1]]]))
        return obs['scans'][0][::10].astype(np.float32), reward, done, info
    def reset(self):
        return self.env.reset(np.array(POSES[:1]))[0]['scans'][0][::10].astype(np.float32)
    def seed(self, seed):
        self.seeded = seed
@njit
def euler(state, pull, rate, params):
    return state + 0.01 * vehicle_dynamics_st(state, np.array([rate, pull]), *params)
def make():
    base = gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=1, integrator=Integrator.Euler)
    return TimeLimit(Learning(base), max_episode_steps=20)
if __name__ == '__main__':
    gym.logger.set_level(40)
    env = make()
    check_env(env)
    env.reset()
    params, done, steps = tuple(list(env.params.values())[:16]), False, 0
    while not done:
        before = env.sim.agents[0].state.copy()
        pull, rate = pid(2.0, 0.0, before[3], before[2], env.params['sv_max'], env.params['a_max'], 20.0, -5.0)
        obs, reward, done, info = env.step(np.zeros(2))
        assert np.abs(env.sim.agents[0].state - euler(before, pull, rate, params)).max() < 1e-12
        steps += 1
    lidar = ScanSimulator2D(108, 4.7)
    assert lidar.set_map(MAP + '.yaml', '.png') and env.sim.agents[0].scan_simulator.scan(POSES[0], None).max() < 30.0
    assert (steps, info['TimeLimit.truncated']) == (20, True) and obs.shape == lidar.scan(POSES[0], None).shape
    workers = SubprocVecEnv([make, make])
    model = PPO('MlpPolicy', workers, n_steps=32, n_epochs=1, device='cpu').learn(64)
    workers.close()
    score, _ = evaluate_policy(model, Monitor(make()), n_eval_episodes=1)
    model = PPO('MlpPolicy', env, n_steps=32, n_epochs=1, seed=5, device='cpu').learn(32)
    print('driven', round(score, 2), env.env.seeded)
"""


def run(program, cwd, *paths, seconds=300):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (*paths, REPOSITORY)))}
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        environment.pop(name, None)
    command = [sys.executable, "-m", "pcs_racing.f1tenth", str(program)]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=seconds, check=False
    )


@pytest.mark.parametrize(("program", "driven"), [(A, "driven 0.5 1.0 0.0"), (B, "driven 0.31"), (C, "driven 0.2 5")])
def test_a_program_runs_without_an_edit(program, driven, tmp_path):
    write_ring(tmp_path)
    poses = f"MAP, POSES = 'ring', {[place(0.0), place(1.0)]}\n"
    (tmp_path / "program.py").write_text(poses + program)
    done = run("program.py", tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, driven), done.stderr


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("from f1tenth_gym.envs.env_config import EnvConfig", "EnvConfig"),
        ("import gym; gym.make('f110_gym:f110-v0', map='vegas')", "vegas"),
        ("import f1tenth_gym, gymnasium; gymnasium.make('f1tenth-v0', config={'map': 'Pipkin', 'model': 'mb'})", "mb"),
    ],
)
def test_what_is_not_served_is_one_line(program, words, tmp_path):
    (tmp_path / "program.py").write_text(program)
    done = run("program.py", tmp_path)
    assert done.returncode == 2
    assert words in done.stderr.splitlines()[-1]
    assert done.stderr.count("error: ") == 1


OTHERS = {
    "CL2-UWaterloo/Head-to-Head-Autonomous-Racing": ("examples", "multi_agent.py", "."),
    "f1tenth/f1tenth_planning": ("examples/control", "stanley.py", "."),
    "f1tenth/f1tenth_gym": ("examples", "waypoint_follow.py", "examples"),
    "Taeyoung96/f1tenth-my-own-driver": ("pkg/src/pkg", "main.py", "pkg/src"),
}


@pytest.mark.parametrize("repository", OTHERS)
def test_others_programs_run_unchanged(repository):
    """``PCS_RACING_GYM_PROGRAMS`` is a folder with checkouts at OWNER/NAME."""
    folder = Path(os.environ.get("PCS_RACING_GYM_PROGRAMS", "nowhere")) / repository
    if not folder.is_dir():
        pytest.skip(f"PCS_RACING_GYM_PROGRAMS holds no checkout {repository}")
    where, program, path = OTHERS[repository]
    done = run(program, folder / where, folder / path, seconds=3000)
    assert done.returncode == 0, done.stderr
    assert "Sim elapsed time" in done.stdout
