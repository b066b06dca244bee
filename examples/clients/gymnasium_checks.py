# /// script
# dependencies = ["gymnasium==1.4.0", "moviepy==2.2.1", "pygame-ce==2.5.8"]
# ///
"""Gymnasium: run its checker, wrappers and video recorder on every environment.

    python examples/clients/gymnasium_checks.py

Two tables list the wrappers; other wrappers need other kinds of observations or actions.
"""

import os
import tempfile
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.save_video import save_video
from gymnasium.wrappers import vector
from moviepy import VideoFileClip

import pcs_racing
from pcs_racing.envs import GYMNASIUM_IDS, RecordRaces

gym.register_envs(pcs_racing)

SHORT = {
    "pcs_racing/Duel-v1": {"steps": (0.4,) * 3},
    "pcs_racing/Drive-v1": {"duration": 0.5},
    "pcs_racing/Avoidance-v0": {"duration": 0.5},
}
ONE = {
    "DelayObservation": {"delay": 1},
    "DtypeObservation": {"dtype": np.float64},
    "FlattenObservation": {},
    "FrameStackObservation": {"stack_size": 2},
    "NormalizeObservation": {},
    "NormalizeReward": {},
    "RecordEpisodeStatistics": {},
    "StickyAction": {"repeat_action_probability": 0.5},
    "TimeAwareObservation": {},
    "TimeLimit": {"max_episode_steps": 2},
}
MANY = {
    "DictInfoToList": {},
    "DtypeObservation": {"dtype": np.float64},
    "FlattenObservation": {},
    "NormalizeObservation": {},
    "NormalizeReward": {},
    "RecordEpisodeStatistics": {},
    "RescaleObservation": {"min_obs": np.float32(-1.0), "max_obs": np.float32(1.0)},
    "TransformReward": {"func": lambda rewards: 2.0 * rewards},
}


def play(env: gym.Env) -> int:
    """Play an episode; return its steps."""
    env.reset(seed=1)
    steps, over = 0, False
    while not over:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps, over = steps + 1, terminated or truncated
    return steps


def film(folder: Path) -> None:
    """Film a game with the wrapper for races and with Gymnasium's function: 25 frames for each
    second of racing.
    """
    look = {
        "render_mode": "rgb_array_list",
        "render_size": (240, 160),
        "steps": (2.0,) * 3,
    }
    env = RecordRaces(gym.make("pcs_racing/Duel-v1", **look), str(folder / "wrapper"))
    play(env)
    env.close()
    env = gym.make("pcs_racing/Duel-v1", **look)
    play(env)
    save_video(env.render(), str(folder / "function"), fps=env.metadata["render_fps"])
    env = gym.make(
        "pcs_racing/Drive-v1", render_mode="rgb_array", render_size=(240, 160), duration=4.0
    )
    drive = wrappers.RecordVideo(env, str(folder / "drive"))
    play(drive)
    drive.close()
    for made in ("wrapper", "function", "drive"):
        (path,) = (folder / made).glob("*.mp4")
        with VideoFileClip(str(path)) as clip:
            print(f"video of {made}: {clip.duration:.1f} s at {clip.fps:g} frames a second")


def main() -> None:
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # the checker opens windows, too
    for name in GYMNASIUM_IDS:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a warning is an error
            check_env(gym.make(name, render_mode="rgb_array", **SHORT[name]).unwrapped)
        for wrapper, options in ONE.items():
            play(getattr(wrappers, wrapper)(gym.make(name, **SHORT[name]), **options))
        for wrapper, options in MANY.items():
            envs = getattr(vector, wrapper)(
                gym.make_vec(name, num_envs=4, **SHORT[name]), **options
            )
            envs.reset(seed=1)
            for _ in range(6):
                envs.step(envs.action_space.sample())
            envs.close()
        print(f"{name}: the checker, {len(ONE)} wrappers and {len(MANY)} vector wrappers pass")
    with tempfile.TemporaryDirectory() as folder:
        film(Path(folder))


if __name__ == "__main__":
    main()
