"""The environments with arguments for short episodes, and one way to play all of them."""

import numpy as np
from gymnasium.spaces import MultiDiscrete

from pcs_racing.envs.drive import (
    DriveEnv,
    DriveHeadToHeadEnv,
    DriveHeadToHeadVectorEnv,
    DriveVectorEnv,
)
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv, SelfPlayVectorEnv
from pcs_racing.envs.line import (
    LineEnv,
    LineHeadToHeadEnv,
    LineHeadToHeadVectorEnv,
    LineVectorEnv,
)
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.lattice import REFERENCE

AGENTS = ("car_0", "car_1")  # of two
AXES = ("aggressiveness", "restraint")
MIXTURE = [(1, "random-moves"), (2, "never-switch"), (1.0, "always-restraint+")]
SINGLE = (DriveEnv, DuelEnv)
PAIRS = (DriveHeadToHeadEnv, HeadToHeadEnv)
ALL = (*SINGLE, *PAIRS)
MANY = {
    DriveEnv: DriveVectorEnv,
    DuelEnv: DuelVectorEnv,
    DriveHeadToHeadEnv: DriveHeadToHeadVectorEnv,
    HeadToHeadEnv: SelfPlayVectorEnv,
    LineEnv: LineVectorEnv,
    LineHeadToHeadEnv: LineHeadToHeadVectorEnv,
}
"""The vector environment of each environment."""


def six_policies() -> PolicyArchive:
    """Six policies from slow to fast, with coordinates that were made up."""
    planner = REFERENCE
    pace = np.linspace(0.3, 0.9, 6)
    parameters = np.array([planner.policy({"pace": value}).parameters for value in pace])
    coordinates = np.column_stack([20.0 * pace - 10.0, [4.0, 3.0, 3.5, 2.0, 2.5, 1.0]])
    return PolicyArchive("six", "lattice", planner.parameter_names, parameters, AXES, coordinates)


DRIVE = {
    "rules": "contest",
    "duration": 1.0,
    "time_step": 0.1,
    "beams": 3,
    "vehicle": {"lidar_noise": 0.1},
}
GAME = {"steps": (0.5,) * 3, "rules": "contest"}
LINE = {"duration": 1.0, "style": {"risk": (0.0, 1.0), "pace": (0.9, 1.6)}}
USUAL = {
    DriveEnv: DRIVE,
    DuelEnv: GAME,
    DriveHeadToHeadEnv: DRIVE,
    HeadToHeadEnv: GAME,
    LineEnv: LINE,
    LineHeadToHeadEnv: LINE,
}
"""Arguments of each environment."""

VARIED = {
    "track": ["Pipkin", "Tarnfjord"],
    "vehicle": [
        {"mu": 0.9, "steer_lag": 0.05, "speed_delay": 0.04, "speed_lag": 0.2, "speed_noise": 0.2}
        | {"lidar_x": 0.2, "lidar_noise": 0.02, "lidar_lost": 0.1, "opponent_delay": 0.06}
        | {"pose_noise": 0.02, "heading_drift": 0.01, "opponent_lost": 0.3},
        "forzaeth-nuc2",
    ],
    "randomize": {
        "mu": [0.6, 1.2],
        "m": [3.0, 4.5],
        "steer_delay": [0.0, 0.1],
        "steer_noise": 0.01,
        "each": {"steer_lag": {"normal": [0.02, 0.02]}, "tyres": {"choice": ["linear", "pacejka"]}},
        "car_1": {"speed_delay": {"choice": [0.0, 0.04, 0.1]}},
    },
    "obstacles": {"count": [0, 2], "passage": 0.8, "moving": [0, 1], "sway": [0.0, 0.3]},
}
"""Arguments for episodes that differ in everything."""

ARCS = {
    "action": "arc",
    "observation": "sectors",
    "beams": 0,
    "track": "Pipkin",
    "rules": "contest",
}
"""Arguments of a drive by arcs, as ``lidar-ppo`` drives."""


class Counting:
    """An opponent that remembers: its k-th move in a game is move k."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert (state is None) == bool(episode_start[0])
        count = 0 if state is None else state
        return np.full(len(observation), count % 4), count + 1


def by_lead(observation, generator):
    """An opponent that is a function and draws."""
    return int(observation[4] < 0.0) + 2 * int(generator.integers(2))


def poses(track, *places):
    """Poses (x, y, heading, speed) of the cars at arc length, offset and speed."""
    return [(*track.to_cartesian([s, d]), speed) for s, d, speed in places]


def follow_the_line(observation, share=0.7):
    """A driver that reads the observation by its documented order: back to the race line, a bit
    slower than it.
    """
    steer = 0.6 * -observation[7] - 0.35 * observation[6] + 0.33 * observation[12]
    return np.array([steer / 0.4189, 2.0 * share * observation[13] / 8.0 - 1.0], np.float32)


def make(kind, **arguments):
    return kind(**{**USUAL[kind], **arguments})


def begun(env, **reset):
    """The environment after a reset."""
    env.reset(**reset)
    return env


def make_many(kind, episodes, **arguments):
    """The vector environment of so many episodes."""
    return MANY[kind](episodes * MANY[kind].players, **{**USUAL[kind], **arguments})


def act(env, k=0):
    """Actions of a step, others for each ``k``: slow driving, or moves."""
    if hasattr(env, "possible_agents"):
        return {
            agent: _act(env.action_space(agent), k + car)
            for car, agent in enumerate(env.possible_agents)
        }
    return _act(env.action_space, k)


def _act(space, k):
    if isinstance(space, MultiDiscrete):
        return (np.arange(len(space.nvec)) + k) % space.nvec
    return np.resize([0.2 * np.sin(k), -0.4], space.shape) if space.shape else k % int(space.n)


def flat(value):
    """Return an answer of an environment as values that compare, bit for bit."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: flat(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [flat(item) for item in value]
    return "nan" if value != value else value  # NaN does not equal itself


def ends(answer):
    """Whether the episode of an environment for one agent, or for two, is over after a step."""
    _, _, *flags, _ = answer
    return any(any(flag.values()) if isinstance(flag, dict) else flag for flag in flags)


def play(env, seed=None, first=0):
    """All that an episode returns, from its reset to its end."""
    answers = [flat(env.reset(seed=seed))]
    while len(answers) == 1 or not ends(answers[-1]):
        answers.append(flat(env.step(act(env, first + len(answers)))))
    return answers
