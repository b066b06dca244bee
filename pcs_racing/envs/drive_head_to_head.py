"""The environment at the level of steering and speed for two agents, in PettingZoo's two interfaces and as a batch."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.arguments import Declared
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.parallel import ParallelBatchEnv, ParallelState
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.race.rendering import MODES


class DriveHeadToHeadEnv(ParallelBatchEnv):
    """Two cars race each other; each agent steers one, fifty times a second.

    ## Description

    :class:`pcs_racing.envs.drive.DriveEnv` with an agent in either car: the same vehicles, circuits and rules. Both
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

    With `see_opponent="in sight"` the nine numbers are 0 while a wall stands between the centres of the two cars, or
    they are further apart than `max_range`. `state()` is the observation of `car_0` followed by that of `car_1`.

    ## Rewards

    The rewards of `DriveEnv`, for each agent from its own side. Progress is in m along the race line.

    - `progress_reward` (1) times (own progress in the step less `rivalry` (1) times the opponent's): with the defaults
      the return is the lead that was gained, and the two agents' rewards add up to zero;
    - less `crash_penalty` (10) for a crash by own fault: into a wall, or into the other car;
    - plus `win_reward` (0) at the end of a race that was won, less as much after a defeat. Who is ahead wins; after a
      crash, the preset decides: in `contest` the car to blame loses, in `paper` nobody wins.

    The reward of winning alone is `progress_reward=0, crash_penalty=0, win_reward=1`.

    ## Starting State

    Start line, side and the key of the race's noise are drawn from the generator. `reset(options=...)` takes `start`
    (arc length of the line in m, and side: 0 puts `car_0` on the left or in front) or `poses` (x, y, heading and
    optionally speed of both cars), and `obstacles` (boxes: x, y, heading, length, width, in m and rad). `track`
    and `opponent` replace the arguments from then on; `state` continues from what `get_state()` returned. Other options
    are refused.

    ## Episode End

    Both agents terminate when either car crashes: the race is over then. Both are truncated after the race's duration
    (40 s), which with a `win_reward` is a termination, since the race is decided and nothing follows; and after
    `max_cycles` steps. `agents` is empty from then on.

    ## Information

    `info` of each agent holds numbers: `time` (s), `progress` and `lead` (own, m), `crash` and `opponent_crash`
    (`pcs_racing.envs.infos.Crash`: 0 none, 1 wall, 2 car), `fault` (1 if it is to blame), `overtakes`, `result`
    (`pcs_racing.envs.infos.Result`: 0 running, 1 win, 2 tie, 3 loss, 4 a crash that pays nobody), `opponent` (-1: the
    other agent), `laps`, `lap_time`, `best_lap` and what was drawn for the episode, as in `DriveEnv`.
    `env.metadata["codes"]` holds the words of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    - `track` (`"Tarnfjord"`): a circuit's name, its folder, or a `Track`; a list of these, of which one is drawn for
      each episode; or `"random"`: a newly generated circuit for each episode.
    - `race` (`"paper"`): rules of the race: `"paper"`, `"contest"`, a YAML file or a `RaceConfig`.
    - `opponent` (`None`): what drives `car_1` in place of a second agent, as for `pcs_racing/Drive-v1`. Then `car_0` is
      the only agent.
    - `time_step` (0.02): length of a step in s, a multiple of 0.02 s up to 1 s.
    - `rivalry` (1.0): see *Rewards*.
    - `render_mode` (`None`): `"rgb_array"`: `render()` returns a picture; `"human"`: every step is shown in a window.
    - `view` (`"both"`): `"track"`, `"both"`, `"car_0"` or `"car_1"`.
    - `render_size` (`(960, 640)`): width and height in pixels.
    - `max_cycles` (`None`): steps after which an episode is truncated.
    - every other argument of `DriveEnv`, with its meaning and default there.

    ## Vectorized environment

    :class:`DriveHeadToHeadVectorEnv` drives any number of races in one compiled call, with the same numbers for the
    same seeds. ``make_sb3_vec_env("drive-self-play", 64)`` is the same for Stable-Baselines3.

    ## Version History

    - v0: first version.

    Examples
    --------
    >>> env = DriveHeadToHeadEnv(beams=27)
    >>> observations, infos = env.reset(seed=1)
    >>> {agent: observation.shape for agent, observation in observations.items()}
    {'car_0': (68,), 'car_1': (68,)}
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "drive_head_to_head_v0",
        "render_modes": list(MODES),
        "render_fps": 50,
        "is_parallelizable": True,
    }
    batch_type = DriveBatch
    batch: DriveBatch
    declared = Declared(
        DriveOptions,
        positional=("track", "race"),
        named=("opponent", "time_step", "rivalry"),
        changed={"opponent": None, "time_step": 0.02, "rivalry": 1.0},
    )

    def _use(self, batch: Any) -> None:
        super()._use(batch)
        self.metadata["render_fps"] = batch.frame_rate

    def state(self) -> NDArray[np.float32]:
        """Observations of both cars, one after the other, whoever drives them.

        Raises
        ------
        InputError
            Before the first reset.
        """
        self._check_started()
        return self.batch.both_views().reshape(-1)

    # Copies are made anew from the arguments: they share the track, and neither compiled code nor a window.

    def __reduce__(self) -> tuple[Any, ...]:
        own = {
            "render_mode": self.render_mode,
            "view": self.view,
            "render_size": self.render_size,
            "max_cycles": self.max_cycles,
        }
        return _rebuild, ({**self._arguments, **own}, self.get_state())

    def __deepcopy__(self, memo: dict[int, Any]) -> "DriveHeadToHeadEnv":
        function, arguments = self.__reduce__()
        copied: DriveHeadToHeadEnv = function(*arguments)
        return copied


def _rebuild(arguments: dict[str, Any], state: ParallelState) -> DriveHeadToHeadEnv:
    made = DriveHeadToHeadEnv(**arguments)
    made.set_state(state)
    return made


class DriveHeadToHeadVectorEnv(BatchVectorEnv):
    """Many races of :class:`DriveHeadToHeadEnv` in one, with the same numbers for the same seeds.

    Environment ``2 i`` is car 0 of race ``i``, and ``2 i + 1`` its car 1: one policy that acts in all of them races
    against itself. Seeds belong to races: ``reset(seed=...)`` takes one for each race.

    Parameters
    ----------
    num_envs : int
        Twice the number of races.
    time_step, rivalry, **settings
        As for :class:`DriveHeadToHeadEnv`, without ``opponent``: for opponents that learn nothing there is
        :class:`pcs_racing.envs.drive.DriveVectorEnv`.
    autoreset_mode : AutoresetMode or str
        What happens after an episode has ended: see :class:`pcs_racing.envs.vector.BatchVectorEnv`.
    max_episode_steps : int, optional
        Steps after which an episode is truncated, in addition to its duration.
    threads : int, optional
        Threads that share a step; the result does not depend on it.
    render_mode, view, render_size
        As for :class:`DriveHeadToHeadEnv`; `render` returns a frame for each environment.

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


def parallel_env(**arguments: Any) -> DriveHeadToHeadEnv:
    """Make a :class:`DriveHeadToHeadEnv` (PettingZoo's parallel interface); the arguments are the class's."""
    return DriveHeadToHeadEnv(**arguments)


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], Any]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both agents act, then a step is driven."""
    return parallel_to_aec(DriveHeadToHeadEnv(**arguments))
