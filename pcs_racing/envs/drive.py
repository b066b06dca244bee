"""The environments at the level of steering and speed: one car alone or against others, or an agent in each car."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import setting, whole
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.envs.drive_options import DriveOptions, drive_elements, rivals_of
from pcs_racing.envs.over_batch import Declared
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.observation import observation_table
from pcs_racing.race.state import MOST_CARS


class DriveEnv(ScalarEnv, observation_table=observation_table(drive_elements(DriveOptions(beams=1)))):
    """Drive one car against motion planners, or alone.

    ## Description

    Two cars race on a closed circuit, or up to eight. The agent steers car 0; each other car is driven by a policy of a
    motion planner at its own rate (plans at 10 Hz, steering at 50 Hz). A step lasts ``time_step`` s with one action:
    0.1 s by default, at which a discount of 0.99 looks ten seconds ahead; 0.02 s is the rate at which the planners
    steer, and 0.01 s that of the simulation, at which places along the race line are 0.01 s old in every second step.

    ## Action Space

    ``Box(-1, 1, (2,), float32)``; values outside are clipped, NaN and infinity are refused.

    | Index | Action | -1 | 0 | 1 |
    |---|---|---|---|---|
    | 0 | target steering angle | -0.4189 rad (right) | 0 | 0.4189 rad (left) |
    | 1 | target speed | `min_speed`, 0 m/s | half of their sum | `top_speed`, 8 m/s |

    The steering moves to its target at 3.2 rad/s at most; the speed error decays with a time constant of 0.1 s where
    engine and brakes allow it. Braking beyond about 6 m/s^2 unloads the rear axle, and the car spins.

    ## Observation Space

    A flat ``Box`` of float32. ``env.unwrapped.elements`` holds the name, unit, bounds and meaning of every element;
    values are clipped to the bounds. With ``normalize=True`` the bounds are mapped to -1 and 1. With the defaults there
    are 41 elements, and one more for each beam, up to ``max_range``:

    {observation_table}

    Nothing in it tells where on the circuit the car is, so what is learned on one circuit can drive on another. Beams
    see all opponents. With several opponents the nine elements about the opponent are repeated for each of them, the
    nearest along the track first ("opponent 2 gap" ...).

    ## Rewards

    ``progress_reward`` (1) for every metre of progress along the race line in the step, less ``rivalry`` (0) times the
    progress of the opponent (the mean of several), and ``-crash_penalty`` (-10) in the step in which the agent crashes
    by its own fault, into a wall or a car. ``rivalry=1`` makes the return the lead. ``win_reward`` (0) is added at
    the end of a race that was won, and subtracted after a defeat; the preset says who wins after a crash, alone nobody.

    ## Starting State

    A start line and the side (or, where the preset staggers the cars, the order) are drawn from the environment's
    generator, and so are the opponent, if there are several, and the key of the race's noise: the steering disturbance
    of the preset "contest" and the noise of the lidar. Cars start at up to 4 m/s.

    ``reset(options=...)`` takes ``obstacles`` (boxes: x, y, heading, length and width in m and rad, shape (K, 5));
    ``start``, (arc length of the line in m, side: 0 puts the agent on the left or in
    front); or ``poses``, (x, y, heading) or (x, y, heading, speed) of all cars, in m, rad and m/s; ``opponent`` and
    ``track``, which replace the arguments from then on; and ``state``, what ``get_state()`` returned. Others are
    refused.

    ## Episode End

    *Terminated* by a crash of any car, unless the rules' ``contact`` lets cars drive on, and when a car has driven
    ``laps`` from the start line.
    *Truncated* after the preset's duration (40 s); with a ``win_reward`` that is
    a termination, too, since the race is decided and nothing follows (take ``time_left`` then).

    ## Information

    Numbers: ``time`` (s), ``progress`` and ``lead`` (m), ``crash`` and ``opponent_crash``
    (:class:`pcs_racing.envs.infos.Crash`: 0 none, 1 wall, 2 car), ``fault`` (1 if the agent is to blame for a crash;
    how many were its fault, where they do not end the race),
    ``overtakes``, ``result`` (:class:`pcs_racing.envs.infos.Result`: 0 running, 1 win, 2 tie, 3 loss, 4 a no-contest
    crash; alone 1 at the end, or 4), ``opponent``, the index of the episode's opponent (-1 if there is none), ``laps``
    (complete ones, counted from the start line; the first begins with the race), ``lap_time`` and ``best_lap`` (s, of
    the last and the shortest of them; -1 if there is none), and where episodes differ in it, ``track`` (its number),
    ``obstacles`` (how many) and what ``randomize`` drew.
    Arrays: ``poses`` (x, y, heading) and ``velocities`` (speed, yaw rate, slip) of all cars in m, rad and s, the own
    one first, shape (N, 3).
    ``env.unwrapped.metadata["codes"]`` holds the words of all codes; ``env.unwrapped.outcome()`` is the info in words.

    ## Arguments

    {arguments}

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Drive-v1", num_envs=256)`` gives :class:`pcs_racing.envs.drive.DriveVectorEnv`:
    one compiled call for all races, and the same numbers as this class gives with the same seeds.

    Examples
    --------
    >>> env = DriveEnv(opponent=None, beams=108)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (149,)
    """

    batch_type = DriveBatch
    declared = Declared(DriveOptions, positional=("track", "opponent", "race"))


class DriveVectorEnv(BatchVectorEnv):
    """Many :class:`DriveEnv` in one, with the same numbers for the same seeds.

    The arguments are those of :class:`DriveEnv` and of :class:`pcs_racing.envs.vector.BatchVectorEnv`. Fewer threads
    are used where a step is short (``env.batch.threads``), and one where the opponent is plain Python.

    Examples
    --------
    >>> envs = DriveVectorEnv(16, opponent=None)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (16, 41)
    """

    batch_type = DriveBatch
    declared = replace(DriveEnv.declared, positional=())


@dataclass(frozen=True, eq=False)
class HeadToHeadOptions(DriveOptions):
    """Arguments of the environments with an agent in several cars."""

    cars: int = setting(2, whole(1, MOST_CARS), "Cars in a race.")


class _SeveralAgents:
    """Agents drive the cars that opponents leave."""

    def _players(self, arguments: dict[str, Any]) -> tuple[dict[str, Any], int]:
        own = {name: value for name, value in arguments.items() if name != "cars"}
        cars = check_whole("cars", arguments["cars"], 1, MOST_CARS)
        if arguments["opponent"] is not None and isinstance(self, BatchVectorEnv):
            raise InputError(f"opponent is {arguments['opponent']!r}; it must be None here, give opponents instead")
        opponents = len(rivals_of(arguments["opponent"], arguments["opponents"]))
        if opponents >= cars:
            raise InputError(f"cars is {cars}, and there are {opponents} opponents; leave a car to an agent")
        return own, cars - opponents


class DriveHeadToHeadEnv(_SeveralAgents, ParallelBatchEnv):
    """Two to eight cars race each other; each agent steers one, fifty times a second.

    ## Description

    :class:`pcs_racing.envs.drive.DriveEnv` with an agent in every car: the same vehicles, circuits and rules. All
    agents act in every step, at the same moment. A step lasts `time_step` seconds (0.02 s, the rate at which the motion
    planners steer), in which the actions are held; 0.1 s is easier to learn with. A race belongs to its seed, whatever
    the interface: with the same seed, `DriveEnv` starts on the same line.

    ## Action Space

    `Box(-1, 1, (2,), float32)` for each agent: target steering angle and target speed, as in `DriveEnv`.

    ## Observation Space

    A flat `Box` of float32 for each agent: the elements of `DriveEnv`, seen from the agent's own car; 41 by default.
    `env.elements` holds name, unit, bounds and meaning of each one. Each part can be switched:

    | part | numbers | switch |
    | --- | --- | --- |
    | own car: speeds, angles, place on the race line | 8 | `own_state` |
    | race line ahead: curvature, speed, free widths | 4 for each distance | `look_ahead`; `()` for none |
    | opponent: gap, position, heading, velocity, lead | 9 | `see_opponent`: `"always"`, `"in sight"`, `"never"` |
    | share of the race that is left | 1 | `time_left` |
    | lidar, which sees the opponent as well | `beams` | `beams`; 0 for none |

    Of several opponents the nearest comes first. `state()` is the observation of `car_0` followed by those of all
    others.

    ## Rewards

    Those of `DriveEnv`, for each agent from its own side. With the defaults (`progress_reward=1`, `rivalry=1`) the
    return is the lead that was gained, and the agents' rewards add up to zero but for the `crash_penalty` (10). The
    reward of winning alone is `progress_reward=0, crash_penalty=0, win_reward=1`.

    ## Starting State

    As in `DriveEnv`, and so are the options of `reset(options=...)`.

    ## Episode End

    As in `DriveEnv`, for all agents at once, and truncated after `max_cycles` steps. `agents` is empty from then on.

    ## Information

    `info` of each agent holds the numbers of `DriveEnv`, seen from its own car; `opponent` is -1: the other agent.
    `env.metadata["codes"]` holds the words of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    Agents are `car_0` to `car_7`. What opponents drive, no agent does: `opponent` takes the last car, and `opponents`
    as many.

    {arguments}

    ## Vectorized environment

    :class:`DriveHeadToHeadVectorEnv` drives any number of races in one compiled call, with the same numbers for the
    same seeds. ``make_sb3_vec_env("drive-self-play", 64)`` is the same for Stable-Baselines3.

    Examples
    --------
    >>> env = DriveHeadToHeadEnv(beams=27)
    >>> observations, infos = env.reset(seed=1)
    >>> {agent: observation.shape for agent, observation in observations.items()}
    {'car_0': (68,), 'car_1': (68,)}
    """

    metadata: dict[str, Any] = {**ParallelBatchEnv.metadata, "name": "drive_head_to_head_v0"}  # noqa: RUF012
    batch_type = DriveBatch
    batch: DriveBatch
    declared = Declared(
        HeadToHeadOptions, positional=("track", "race"), changed={"opponent": None, "time_step": 0.02, "rivalry": 1.0}
    )


class DriveHeadToHeadVectorEnv(_SeveralAgents, BatchVectorEnv):
    """Many races of :class:`DriveHeadToHeadEnv` in one, with the same numbers for the same seeds.

    Environment ``2 i`` is car 0 of race ``i``, and ``2 i + 1`` its car 1: one policy that acts in all of them races
    against itself; with N agents in a race they are ``N i`` to ``N i + N - 1``. Seeds belong to races:
    ``reset(seed=...)`` takes one for each race. The arguments are those of :class:`DriveHeadToHeadEnv`, without
    ``opponent``, and of :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = DriveHeadToHeadVectorEnv(16)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (16, 41)
    """

    batch_type = DriveBatch
    declared = replace(DriveHeadToHeadEnv.declared, positional=())
    players = 2


parallel_env = DriveHeadToHeadEnv
"""PettingZoo's name for what makes an environment of its parallel interface."""


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], Any]:
    """Make the same environment in PettingZoo's turn-by-turn interface: all agents act, then a step is driven."""
    return parallel_to_aec(parallel_env(**arguments))
