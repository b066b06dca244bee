"""Control-level environments: one car alone or against others, or an agent in each car."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.envs.drive_options import (
    DriveOptions,
    HeadToHeadOptions,
    rivals_of,
)
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv


def make_batch(episodes: int, options: DriveOptions, **given: Any) -> DriveBatch:
    """Return the batch of the actions that the options name."""
    if options.action == "command":
        return DriveBatch(episodes, options, **given)
    from pcs_racing.envs.arc_batch import ArcBatch  # with code that others do not need

    return ArcBatch(episodes, options, **given)


class DriveEnv(ScalarEnv):
    """Control of one car against motion planners, or alone on the track.

    ## Description

    Two to eight cars race on a closed track. The agent steers car 0. A policy of a motion planner
    drives each other car at its own rate (plans at 10 Hz, steering at 50 Hz). A step applies one
    action for ``time_step`` s. With the default of 0.1 s, a discount of 0.99 looks ten seconds
    ahead. With 0.02 s, the agent steers at the rate of the planners. With 0.01 s, the rate of the
    simulation, positions along the race line are 0.01 s old in every second step.

    ## Action Space

    ``Box(-1, 1, (2,), float32)``; values outside are clipped, NaN and infinity are refused.

    | Index | Action | -1 | 0 | 1 |
    |---|---|---|---|---|
    | 0 | target steering angle | -0.4189 rad (right) | 0 | 0.4189 rad (left) |
    | 1 | target speed | `min_speed`, 0 m/s | half of their sum | `top_speed`, 8 m/s |

    The steering moves to its target at up to 3.2 rad/s. The speed error decays with a time constant
    of 0.1 s, within the limits of engine and brakes. Braking beyond about 6 m/s^2 unloads the rear
    axle, and the car spins.

    With ``action="arc"`` the car follows an arc for 0.1 s. The first number is its curvature, as a
    share of ``1.3 / (1 + (v / 4)**2)`` 1/m at the speed ``v`` in m/s, the second one a change of
    the speed, m/s.

    ## Observation Space

    A flat ``Box`` of float32. ``env.unwrapped.elements`` is the table of its elements: name, unit,
    bounds and meaning of each. Values are clipped to the bounds. With ``normalize=True`` the bounds
    are mapped to -1 and 1. The default has 41 elements: 8 of the own car, 4 of the race line at
    each of the 6 distances of ``look_ahead``, and 9 of the opponent. Each lidar beam adds one, up
    to ``max_range``.

    With ``observation="sectors"`` there are 230 elements of order one: the nearest range in each of
    75 sectors of a lidar, as a root, its changes in 0.1 and 0.2 s, and five numbers of the own
    motion. No map is needed. The planner ``lidar-ppo`` has these observations and arcs.

    The numbers are measurements of the car: its parameters (`vehicle`) may give its localization
    and its lidar errors, and let it see opponents late, or not for a while.

    The observation does not contain the position on the track, so a policy trained on one track can
    drive on another. Beams see all opponents. With several opponents the nine elements about the
    opponent ("opponent 2 gap" ...) are repeated for each opponent, the nearest along the track
    first.

    ## Rewards

    The reward of a step is ``progress_reward`` (1) for every metre of progress along the race line,
    minus ``rivalry`` (0) times the progress of the opponent (the mean of several opponents). In the
    step of a crash by the agent's own fault, into a wall or a car, ``-crash_penalty`` (-10) is
    added. With ``rivalry=1`` the return is the lead. At the end of a race, ``win_reward`` (0) is
    added for a win and subtracted for a defeat. The rules determine the winner after a crash. A
    single car gets no ``win_reward``. The argument ``reward`` gives another reward.

    ## Starting State

    The environment's generator draws a start line and the side (or the order, if the rules
    staggers the cars), the opponent if there are several, and the key of the race's noise: the
    steering disturbance of the rules "contest" and the noise of the lidar. Cars start at up to
    4 m/s.

    ``reset(options=...)`` takes these options and refuses others:

    - ``obstacles``: boxes (x, y, heading, length and width in m and rad), shape (K, 5); with
      speed (m/s) and sway (m) of moving ones (K, 7);
    - ``start``: arc length of the line in m, and side (0 puts the agent on the left or in front);
    - ``poses``, in place of ``start``: (x, y, heading) or (x, y, heading, speed) of all cars, in m,
      rad and m/s;
    - ``state``: a state returned by ``get_state()``.

    ## Episode End

    *Terminated* by a crash of any car, unless the rules' ``contact`` lets cars drive on, and when a
    car has driven the ``laps``.
    *Truncated* after the rules' duration (40 s; with ``laps`` 40 s a lap). With a ``win_reward``
    the episode is terminated instead, because the race is decided then (use ``time_left`` in this
    case).

    ## Information

    Numbers:

    - ``time`` (s), ``progress`` and ``lead`` (m), ``overtakes``;
    - ``crash`` and ``opponent_crash`` (:class:`pcs_racing.envs.infos.Crash`: 0 none, 1 wall,
      2 car);
    - ``fault``: 1 if the agent is to blame for a crash; the number of its faults if crashes do not
      end the race;
    - ``cost``: 1.0 if the agent was at fault in the last step, else 0.0;
    - ``result`` (:class:`pcs_racing.envs.infos.Result`: 0 running, 1 win, 2 tie, 3 loss,
      4 no-contest crash; for a single car 1 at the end, 3 if the time ends before the ``laps``, or
      4; of several cars without all ``laps`` the car ahead wins);
    - ``opponent``: index of the episode's opponent (-1 if there is none);
    - ``laps``: complete laps, counted from the start line; the first begins with the race;
    - ``lap_time`` and ``best_lap``: times of the last and the shortest lap, s; -1 if there is none;
    - ``track`` (number), ``obstacles`` (count) and the values drawn by ``randomize``, if episodes
      differ in them.

    Arrays: ``poses`` (x, y, heading) and ``velocities`` (speed, yaw rate, slip) of all cars in m,
    rad and s, the own car first, shape (N, 3); with ``laps`` also ``lap_times``, the time of each
    lap in s, shape (laps,), -1 for a lap not driven.

    ``env.unwrapped.metadata["codes"]`` maps integer codes to labels. ``env.unwrapped.outcome()``
    returns the info with labels in place of codes.

    ## Arguments

    :class:`pcs_racing.envs.drive_options.DriveOptions` lists them; all are given by name.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Drive-v1", num_envs=256)`` makes a
    :class:`pcs_racing.envs.drive.DriveVectorEnv`: one compiled call for all races, with the same
    numbers as this class for the same seeds.

    Examples
    --------
    >>> env = DriveEnv(opponent=None, beams=108)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (149,)
    """

    batch_type = staticmethod(make_batch)
    options_type = DriveOptions


class DriveVectorEnv(BatchVectorEnv):
    """Vector environment of :class:`DriveEnv`, with the same numbers for the same seeds.

    It takes the arguments of :class:`DriveEnv` and
    :class:`pcs_racing.envs.vector.BatchVectorEnv`. Short steps use fewer threads
    (``env.batch.threads``), and an opponent in plain Python uses one thread.

    Examples
    --------
    >>> envs = DriveVectorEnv(16, opponent=None)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (16, 41)
    """

    batch_type = staticmethod(make_batch)
    options_type = DriveOptions


def count_agents(options: Any) -> int:
    """Return the number of cars without an opponent."""
    opponents = len(rivals_of(options.opponent, options.opponents))
    if opponents >= options.cars:
        raise InputError(
            f"cars is {options.cars}, and there are {opponents} opponents; leave a car to an agent"
        )
    return options.cars - opponents


def count_pairs(options: Any) -> int:
    """Return the number of cars without an opponent, for a vector environment of self-play."""
    if options.opponent is not None:
        raise InputError(
            f"opponent is {options.opponent!r}; it must be None here, give opponents instead"
        )
    return count_agents(options)


class DriveHeadToHeadEnv(ParallelBatchEnv):
    """Races of two to eight cars; each agent steers one car, fifty times a second.

    ## Description

    :class:`pcs_racing.envs.drive.DriveEnv` with an agent in every car: the same vehicles, tracks
    and rules. All agents act in every step, at the same moment. A step holds the actions for
    `time_step` seconds (default: 0.02 s, the steering period of the motion planners). Learning is
    easier with 0.1 s. A seed gives the same race through every interface: with the same seed,
    `DriveEnv` starts on the same line.

    ## Action Space

    `Box(-1, 1, (2,), float32)` for each agent: target steering angle and target speed, as in
    `DriveEnv`.

    ## Observation Space

    A flat `Box` of float32 for each agent: the elements of `DriveEnv`, seen from the agent's own
    car; 41 by default. `env.elements` holds the name, unit, bounds and meaning of each element.
    Each part can be switched:

    | part | numbers | switch |
    | --- | --- | --- |
    | own car: speeds, angles, place on the race line | 8 | `own_state` |
    | race line: curvature, speed, free widths | 4 for each distance | `look_ahead`; `()` for none |
    | opponent: gap, position, heading, velocity, lead | 9 | `see_opponent`; `"never"` for none |
    | remaining share of the race | 1 | `time_left` |
    | lidar, including the opponent | `beams` | `beams`; 0 for none |

    The nearest of several opponents comes first. `state()` is the observation of `car_0`, followed
    by the observations of all other cars.

    ## Rewards

    The rewards of `DriveEnv`, for each agent's own car. With the defaults (`progress_reward=1`,
    `rivalry=1`) the return is the gained lead, and the agents' rewards add up to zero except for
    the `crash_penalty` (10). For a reward of winning alone, use `progress_reward=0,
    crash_penalty=0, win_reward=1`.

    ## Starting State

    As in `DriveEnv`, with the same options of `reset(options=...)`.

    ## Episode End

    As in `DriveEnv`, for all agents at once, and truncated after `max_cycles` steps. `agents` is
    empty afterwards.

    ## Information

    `info` of each agent holds the numbers of `DriveEnv`, seen from its own car; `opponent` is -1:
    the other agent. `env.metadata["codes"]` maps integer codes to labels. `env.outcome()` returns
    the infos with labels in place of codes.

    ## Arguments

    Agents are `car_0` to `car_7`. Opponents replace agents: `opponent` takes the last car,
    `opponents` the last cars. :class:`pcs_racing.envs.drive_options.HeadToHeadOptions` lists all
    arguments; they are given by name. An episode is truncated after `max_cycles` steps.

    ## Vectorized environment

    :class:`DriveHeadToHeadVectorEnv` drives any number of races in one compiled call, with the same
    numbers for the same seeds. ``make_sb3_vec_env("drive-self-play", 64)`` makes the same for
    Stable-Baselines3.

    Examples
    --------
    >>> env = DriveHeadToHeadEnv(beams=27)
    >>> observations, infos = env.reset(seed=1)
    >>> {agent: observation.shape for agent, observation in observations.items()}
    {'car_0': (68,), 'car_1': (68,)}
    """

    metadata: dict[str, Any] = ParallelBatchEnv.metadata | {"name": "drive_head_to_head_v0"}
    batch_type = staticmethod(make_batch)
    batch: DriveBatch
    options_type = HeadToHeadOptions

    def _count_players(self, options: HeadToHeadOptions) -> int:
        return count_agents(options)


class DriveHeadToHeadVectorEnv(BatchVectorEnv):
    """Vector environment of :class:`DriveHeadToHeadEnv`, with the same numbers for the same seeds.

    Environments ``2 i`` and ``2 i + 1`` are cars 0 and 1 of race ``i``; N agents in a race have the
    environments ``N i`` to ``N i + N - 1``. A policy acting in all environments races against
    itself.
    ``reset(seed=...)`` takes one seed for each race. The class takes the arguments of
    :class:`DriveHeadToHeadEnv`, without ``opponent``, and of
    :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = DriveHeadToHeadVectorEnv(16)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (16, 41)
    """

    batch_type = staticmethod(make_batch)
    options_type = HeadToHeadOptions
    players = 2

    def _count_players(self, options: HeadToHeadOptions) -> int:
        return count_pairs(options)


parallel_env = DriveHeadToHeadEnv
"""PettingZoo's name for the constructor of a parallel environment."""


def env(
    *, max_cycles: int | None = None, **arguments: Any
) -> AECEnv[str, NDArray[np.float32], Any]:
    """Make the same environment with PettingZoo's AEC interface.

    All agents act, then a step is driven.
    """
    return parallel_to_aec(parallel_env(max_cycles=max_cycles, **arguments))
