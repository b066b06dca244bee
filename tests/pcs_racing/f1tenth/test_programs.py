"""Programs of the gym run without an edit."""

import os
import subprocess
import sys

import pytest
from repository import REPOSITORY
from situations import place, write_ring
from warm_start import call_python

from pcs_racing.f1tenth.maps import find_yaml

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
        drawn.append(e.batch.add(1, GL_POINTS, None, ('v3f/stream', [1.0, 2.0, 0.0]),
                                 ('c3B/stream', [183, 193, 222])))
    drawn[0].vertices = [3.0, 4.0, 0.0]
env = gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=2, timestep=0.01,
               integrator=Integrator.RK4)
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
    'observation_config': {'type': 'kinematic_state'},
    'reset_config': {'type': 'cl_random_static'}})
track = env.unwrapped.track
env.unwrapped.add_render_callback(track.raceline.render_waypoints)
env.unwrapped.add_render_callback(
    lambda e: e.render_points(np.zeros((1, 2)), color=(0, 0, 128), size=2))
obs, info = env.reset(seed=1)
line = np.stack([track.raceline.xs, track.raceline.ys], axis=1)
for _ in range(30):
    action = env.action_space.sample()
    for i, name in enumerate(obs.keys()):
        at = np.array([obs[name]['pose_x'], obs[name]['pose_y']])
        _, far, _, k = nearest_point_on_trajectory(at, line)
        action[i] = np.array([0.05, track.raceline.vxs[k]])
    obs, reward, done, truncated, info = env.step(action)
    env.render()
assert far < 1.0 and isinstance(env, F110Env) and obs['agent_2']['pose_x'].dtype == np.float32
s, across, turned = track.cartesian_to_frenet(*env.sim.agent_poses[0])
back = track.frenet_to_cartesian(s, across, turned)
assert np.allclose(back[:2], env.sim.agent_poses[0][:2], atol=0.02)
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
    base = gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=1,
                    integrator=Integrator.Euler)
    return TimeLimit(Learning(base), max_episode_steps=20)
if __name__ == '__main__':
    gym.logger.set_level(40)
    env = make()
    check_env(env)
    env.reset()
    params, done, steps = tuple(list(env.params.values())[:16]), False, 0
    while not done:
        before = env.sim.agents[0].state.copy()
        limits = env.params['sv_max'], env.params['a_max'], 20.0, -5.0
        pull, rate = pid(2.0, 0.0, before[3], before[2], *limits)
        obs, reward, done, info = env.step(np.zeros(2))
        assert np.abs(env.sim.agents[0].state - euler(before, pull, rate, params)).max() < 1e-12
        steps += 1
    lidar = ScanSimulator2D(108, 4.7)
    assert lidar.set_map(MAP + '.yaml', '.png')
    assert env.sim.agents[0].scan_simulator.scan(POSES[0], None).max() < 30.0
    assert (steps, info['TimeLimit.truncated']) == (20, True)
    assert obs.shape == lidar.scan(POSES[0], None).shape
    workers = SubprocVecEnv([make, make])
    model = PPO('MlpPolicy', workers, n_steps=32, n_epochs=1, device='cpu').learn(64)
    workers.close()
    score, _ = evaluate_policy(model, Monitor(make()), n_eval_episodes=1)
    model = PPO('MlpPolicy', env, n_steps=32, n_epochs=1, seed=5, device='cpu').learn(32)
    print('driven', round(score, 2), env.env.seeded)
"""
D = """
import gym
import numpy as np
from gym.wrappers.normalize import RunningMeanStd
class Scans(gym.ObservationWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.observation_space = gym.spaces.Box(0.0, 40.0, (108,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1, 2), np.float32)
    def observation(self, obs):
        return obs['scans'][0][::10].astype(np.float32)
    def reset(self):
        return super().reset(np.array(POSES[:1]))[0]
def make_env():
    env = Scans(gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=1))
    env = gym.wrappers.TimeLimit(env, 20)
    env = gym.wrappers.RecordEpisodeStatistics(env)
    env = gym.wrappers.ClipAction(env)
    env = gym.wrappers.NormalizeObservation(env)
    env = gym.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10))
    env = gym.wrappers.NormalizeReward(env, gamma=0.99)
    env = gym.wrappers.TransformReward(env, lambda reward: np.clip(reward, -10, 10))
    env.seed(1)
    return env
envs = gym.vector.SyncVectorEnv([make_env for _ in range(2)])
obs, kept, returns, rewards = envs.reset(), [], [], 0.0
assert obs.shape == (2, 108) and abs(obs).max() <= 10.0
mean = RunningMeanStd(shape=(108,))
for _ in range(25):
    obs, reward, done, infos = envs.step(np.full((2, 1, 2), [0.1, 5.0]))
    rewards += reward
    returns += [info['episode']['r'] for info in infos if 'episode' in info]
    kept += [info['terminal_observation'].shape for info in infos if 'episode' in info]
assert kept == [(108,)] * 2 and (rewards > 0.2).all() and envs.envs[0].sim.agents[0].state[3] > 0.0
one = Scans(gym.make('f110_gym:f110-v0', map=MAP, map_ext='.png', num_agents=1))
stacked = gym.wrappers.FrameStack(gym.wrappers.RescaleAction(one, -2.0, 2.0), 4)
assert stacked.reset().shape == (4, 108) == stacked.observation_space.shape
obs, reward, done, info = gym.wrappers.FlattenObservation(stacked).step(np.array([[0.0, 2.0]]))
assert obs.shape == (432,) and not done
class Mine(gym.Env):
    def seed(self, seed=None):
        return super().seed(seed) + [self.np_random.random() >= 0.0]
assert Mine().seed(3) == [3, True]
print('driven', round(float(np.mean(returns)), 2))
"""
E = """
import gym, numpy as np
env = gym.make('f110_gym:f110-v0', map='mine', num_agents=1)
obs, step, done, info = env.reset(np.array(POSES[:1]))
print('driven', step, len(obs['scans'][0]))
"""


def run(program, cwd, start=call_python):
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    environment["PYTHONPATH"] = str(REPOSITORY)
    return start("-m", "pcs_racing.f1tenth", program, cwd=cwd, env=environment)


def start_cold(*arguments, **named):
    """Start a new interpreter, which imports all that the program names after the replacements."""
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        **named,
    )


DRIVEN = [(A, "driven 0.5 1.0 0.0"), (B, "driven 0.31"), (C, "driven 0.2 5"), (D, "driven 0.2")]


@pytest.mark.parametrize(("program", "driven"), DRIVEN)
def test_a_program_runs_without_an_edit(program, driven, tmp_path):
    write_ring(tmp_path)
    poses = f"MAP, POSES = 'ring', {[place(0.0), place(1.0)]}\n"
    (tmp_path / "program.py").write_text(poses + program)
    done = run("program.py", tmp_path, start_cold if program == C else call_python)
    assert (done.returncode, done.stdout.strip()) == (0, driven), done.stderr


def test_a_map_is_found_by_the_name_of_its_folder(tmp_path, monkeypatch):
    for name in ("Another Ring", "My Ring"):
        (tmp_path / name).mkdir()
        write_ring(tmp_path / name)
    monkeypatch.setenv("PCS_RACING_MAPS", str(tmp_path))
    assert find_yaml("myring") == tmp_path / "My Ring" / "ring.yaml"


@pytest.mark.parametrize("place_of_copy", ["f110_gym/envs", "gym/f110_gym/envs"])
def test_a_program_drives_on_the_maps_of_the_copy_that_it_brings_along(place_of_copy, tmp_path):
    """No code of the copy is run."""
    maps = tmp_path / place_of_copy / "maps"
    maps.mkdir(parents=True)
    ring = write_ring(maps)
    for file in maps.glob(f"{ring.stem}.*"):
        file.rename(file.with_stem("mine"))
    (maps / "mine.yaml").write_text((maps / "mine.yaml").read_text().replace(ring.stem, "mine"))
    (maps.parents[1] / "__init__.py").write_text("raise SystemExit('the copy is run')")
    (tmp_path / "program.py").write_text(f"POSES = {[place(0.0)]}\n{E}")
    done = run("program.py", tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "driven 0.01 1080"), done.stderr
    assert "takes its place, with the defaults of the gym" in done.stderr


def test_an_own_package_of_the_gym_is_announced(tmp_path):
    (tmp_path / "f1tenth_gym" / "envs").mkdir(parents=True)
    (tmp_path / "f1tenth_gym" / "envs" / "__init__.py").write_text("raise SystemExit('run')")
    config = {"map": "Pipkin", "observation_config": {"type": "frenet_marl"}}
    (tmp_path / "program.py").write_text(
        f"import f1tenth_gym, gymnasium; gymnasium.make('f1tenth-v0', config={config})"
    )
    done = run("program.py", tmp_path)
    announced, error = done.stderr.strip().splitlines()
    assert "f1tenth_gym is not run: pcs_racing.f1tenth takes its place" in announced
    assert "type is 'frenet_marl'" in error


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("import gym; gym.wrappers.AtariPreprocessing", "AtariPreprocessing"),
        ("from f1tenth_gym.envs.env_config import EnvConfig", "EnvConfig"),
        ("import gym; gym.make('f110_gym:f110-v0', map='vegas')", "vegas"),
        (
            (
                "import f1tenth_gym, gymnasium; gymnasium.make('f1tenth-v0', config={'map':"
                " 'Pipkin', 'model': 'mb'})"
            ),
            "mb",
        ),
    ],
)
def test_what_is_not_served_is_one_line(program, words, tmp_path):
    (tmp_path / "program.py").write_text(program)
    done = run("program.py", tmp_path)
    assert done.returncode == 2
    assert words in done.stderr.splitlines()[-1]
    assert done.stderr.count("error: ") == 1
