"""The control-level environment: steering and speed for one car, a policy in the other."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_batch import EXTERNAL, DriveBatch, DriveOptions, Element, Opponent
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.rendering import MODES, VIEWS, Renderer
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track

__all__ = ["EXTERNAL", "DriveEnv", "DriveState"]


class DriveState(NamedTuple):
    """A moment of a :class:`DriveEnv`: a value that can be kept, copied, pickled and restored.

    Attributes
    ----------
    races : RaceState
        The one race.
    opponents : ndarray, shape (1,)
        Which of the opponents drives in it.
    running : bool
        Whether the episode goes on.
    generator : dict
        State of the random generator that the next episodes are drawn from.
    """

    races: RaceState
    opponents: NDArray[np.int64]
    running: bool
    generator: dict[str, Any]


class DriveEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Drive one car against a motion planner, or alone.

    ## Description

    Two cars race on a closed circuit. The agent steers car 0; car 1 is driven by a policy of a motion planner at its
    own rate (plans at 10 Hz, steering at 50 Hz). Every step lasts ``time_step`` seconds, in which the action is held:
    0.1 s by default, at which a discount of 0.99 looks ten seconds ahead; 0.02 s is the rate at which the planners
    steer.

    ## Action Space

    ``Box(-1, 1, (2,), float32)``; values outside are clipped, NaN and infinity are refused.

    | Index | Action | -1 | 0 | 1 |
    |---|---|---|---|---|
    | 0 | target steering angle | -0.4189 rad (right) | 0 | 0.4189 rad (left) |
    | 1 | target speed | 0 m/s | half of `top_speed` | `top_speed` |

    The steering moves to its target at 3.2 rad/s at most; the speed error decays with a time constant of 0.1 s where
    engine and brakes allow it. Braking beyond about 6 m/s^2 unloads the rear axle, and the car spins.

    ## Observation Space

    A flat ``Box`` of float32. ``env.unwrapped.elements`` holds the name, unit, bounds and meaning of every element;
    values are clipped to the bounds. With ``normalize=True`` the bounds are mapped to -1 and 1. With the default
    `look_ahead` of six distances there are 41 elements and one for each beam:

    | Index | Element | Unit | Low | High |
    |---|---|---|---|---|
    | 0 | speed | m/s | -5 | 20 |
    | 1 | steering | rad | -0.4189 | 0.4189 |
    | 2 | yaw rate | rad/s | -20 | 20 |
    | 3 | slip | rad | -3.142 | 3.142 |
    | 4 | target steering | rad | -0.4189 | 0.4189 |
    | 5 | target speed | m/s | 0 | 20 |
    | 6 | offset | m | -10 | 10 |
    | 7 | heading error | rad | -3.142 | 3.142 |
    | 8, 12, ... 28 | curvature 0, 1, 2, 4, 6, 9 m ahead | 1/m | -5 | 5 |
    | 9, 13, ... 29 | line speed there | m/s | 0 | 20 |
    | 10, 14, ... 30 | left: free width there | m | 0 | 10 |
    | 11, 15, ... 31 | right: free width there | m | 0 | 10 |
    | 32 | opponent (present) | 1 | 0 | 1 |
    | 33 | opponent gap | m | -30 | 30 |
    | 34 | opponent offset | m | -20 | 20 |
    | 35 | opponent x | m | -30 | 30 |
    | 36 | opponent y | m | -30 | 30 |
    | 37 | opponent heading | rad | -3.142 | 3.142 |
    | 38 | opponent vx | m/s | -30 | 30 |
    | 39 | opponent vy | m/s | -30 | 30 |
    | 40 | lead | m | -1000 | 1000 |
    | 41, ... | beam 0, ... | m | 0 | 30 (`max_range`) |

    Nothing in it tells where on the circuit the car is, so what is learned on one circuit can drive on another. Beams
    see the opponent.

    ## Rewards

    ``progress_reward`` (1) for every metre of progress along the race line in the step, less ``rivalry`` (0) times the
    opponent's progress, and ``-crash_penalty`` (-10) in the step in which the agent crashes into a wall, or into the
    opponent and is to blame for it. ``rivalry=1`` makes the return the lead.

    ## Starting State

    A start line and the side (or, where the preset staggers the cars, the order) are drawn from the environment's
    generator, and so are the opponent, if there are several, and the key of the race's noise: the steering disturbance
    of the preset "contest" and the noise of the lidar. Cars start at up to 4 m/s.

    ## Episode End

    *Terminated* by a crash of either car. *Truncated* after the preset's duration (40 s). The info of each step holds
    ``time`` (s), ``progress`` and ``lead`` (m), ``crash`` and ``opponent_crash`` ("none", "wall" or "car"),
    ``at_fault`` (whether the agent is to blame for a crash), ``overtakes``, and the name of the ``opponent``.

    ## Arguments

    Parameters
    ----------
    track : str, Path or Track
        Name of a shipped circuit, a map folder, or a track.
    opponent : str, Policy, None, or a list of them
        "lattice", "lattice:pace=0.8", "lane-switcher:3", a policy, or a list of policies of one planner, of which one
        is drawn for each episode. With None the agent is alone on the track: the second car is not simulated, can't be
        touched or seen, and its elements are 0.
    race : str, Path or RaceConfig
        Rules of the race: "paper", "contest", a YAML file or a configuration.
    duration : float, optional
        Length of an episode in s, a multiple of 0.1 s; the preset's by default.
    time_step : float
        Length of a step in s, a multiple of 0.02 s up to 1 s.
    top_speed : float
        Target speed of the action 1, m/s.
    beams : int
        Beams of the lidar; 0 for none.
    fov : float
        Angle from the first beam to the last, rad.
    max_range : float
        Longest range that is reported, m.
    lidar_noise : float
        Standard deviation of the ranges, m; a function of the race's key, the time and the beam.
    look_ahead : tuple of float
        Distances at which curvature, speed and widths are reported, m.
    normalize : bool
        Whether to map every element to [-1, 1].
    progress_reward, rivalry, crash_penalty : float
        See *Rewards*.
    start_lines : int
        Number of start lines to draw from.
    render_mode : {"rgb_array", "human"}, optional
    view : {"track", "both", "car_0", "car_1"}
        What a frame shows.

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Drive-v1", num_envs=256)`` gives :class:`pcs_racing.envs.drive_vector.DriveVectorEnv`:
    one compiled call for all races, and the same numbers as this class gives with the same seeds.

    ## Version History

    * v1: opponents of the lattice leave room and do not brake for a car behind; start lines at places found by driving;
      the same bits on every x86-64 machine.
    * v0: first version.

    Examples
    --------
    >>> env = DriveEnv(opponent=None, beams=108)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (149,)
    """

    metadata: dict[str, Any] = {"render_modes": list(MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        track: str | Path | Track = "Tarnfjord",
        opponent: Opponent = "lattice",
        race: str | Path | RaceConfig = "paper",
        *,
        duration: float | None = None,
        time_step: float = 0.1,
        top_speed: float = 8.0,
        beams: int = 0,
        fov: float = 4.7,
        max_range: float = 30.0,
        lidar_noise: float = 0.0,
        look_ahead: Sequence[float] = (0.0, 1.0, 2.0, 4.0, 6.0, 9.0),
        normalize: bool = False,
        progress_reward: float = 1.0,
        rivalry: float = 0.0,
        crash_penalty: float = 10.0,
        start_lines: int = 100,
        render_mode: str | None = None,
        view: str = "both",
    ) -> None:
        given = locals()
        self._options = DriveOptions(**{field.name: given[field.name] for field in fields(DriveOptions)})
        check_rendering(render_mode, view)
        self.render_mode, self.view = render_mode, view
        self._renderer: Renderer | None = None
        self._batch = DriveBatch(1, self._options)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / time_step))}
        self.observation_space = spaces.Box(self._batch.low, self._batch.high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._row = np.zeros(1, np.int64)
        self._running = False
        self._started = False

    @property
    def elements(self) -> list[Element]:
        """Name, unit, bounds and meaning of every element of the observation."""
        return list(self._batch.elements)

    @property
    def track(self) -> Track:
        """The circuit."""
        return self._batch.track

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start a new episode.

        Parameters
        ----------
        seed : int, optional
            Begin anew with this seed; without it the generator goes on.
        options : dict, optional
            Ignored.

        Returns
        -------
        observation : ndarray of float32
        info : dict
        """
        super().reset(seed=checked_seed(seed))
        self._batch.restart(self._row, [self.np_random])
        self._running = self._started = True
        out = np.empty((1, len(self._batch.low)), np.float32)
        self._batch.observe(self._row, out)
        if self.render_mode == "human":
            self.render()
        return out[0], self._batch.facts_of(0)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one step on.

        Parameters
        ----------
        action : array_like, shape (2,)
            Steering and speed in [-1, 1].

        Returns
        -------
        observation : ndarray of float32
        reward : float
        terminated, truncated : bool
        info : dict

        Raises
        ------
        InputError
            If the action is not two finite numbers, or no episode is running.
        """
        actions = self._batch.check_actions(action, (2,))
        if not self._running:
            raise InputError(
                f"the episode {'has ended' if self._started else 'has not begun'}; call reset() before step()"
            )
        observations, reward, terminated, truncated = self._batch.step(actions)
        ended, late = bool(terminated[0]), bool(truncated[0])
        self._running = not (ended or late)
        if self.render_mode == "human":
            self.render()
        return observations[0], float(reward[0]), ended, late, self._batch.facts_of(0)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a frame (``"rgb_array"``), or show it (``"human"``).

        Raises
        ------
        InputError
            If there is no race to show yet, or the environment was made without a render mode.
        """
        if self.render_mode is None:
            raise InputError("render_mode is None; make the environment with render_mode='rgb_array' or 'human'")
        if not self._started:
            raise InputError("there is nothing to render before reset()")
        if self._renderer is None:
            self._renderer = Renderer(
                self.track, mode=self.render_mode, view=self.view, fps=float(self.metadata["render_fps"])
            )
        return draw_race(self._renderer, self._batch, 0)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def get_state(self) -> DriveState:
        """Return all that the rest of this episode, and all later ones, depend on."""
        races, opponents = self._batch.get_state()
        return DriveState(races, opponents, self._running, dict(self.np_random.bit_generator.state))

    def set_state(self, state: DriveState) -> NDArray[np.float32]:
        """Go on from a state that `get_state` returned, here or in an environment with equal arguments.

        Returns
        -------
        ndarray of float32
            The observation at that moment.

        Raises
        ------
        InputError
            If the state does not fit this environment.
        """
        if not isinstance(state, DriveState):
            raise InputError(f"state is a {type(state).__name__}; it must be what get_state returned")
        self._batch.set_state(state.races, state.opponents)
        self.np_random.bit_generator.state = state.generator
        self._running, self._started = state.running, True
        out = np.empty((1, len(self._batch.low)), np.float32)
        self._batch.observe(self._row, out)
        return out[0]

    # Copies are made anew from the arguments: they share the track, and neither compiled code nor a window.

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = {field.name: getattr(self._options, field.name) for field in fields(DriveOptions)}
        arguments |= {"render_mode": self.render_mode, "view": self.view}
        return _rebuild, (type(self), arguments, self.get_state(), self._started)

    def __deepcopy__(self, memo: dict[int, Any]) -> "DriveEnv":
        function, arguments = self.__reduce__()
        return function(*arguments)


def _rebuild(kind: type[DriveEnv], arguments: dict[str, Any], state: DriveState, started: bool) -> DriveEnv:
    env = kind(**arguments)
    env.set_state(state)
    env._started = started
    return env


def checked_seed(seed: Any) -> int | None:
    """Return a seed as Gymnasium wants it.

    Raises
    ------
    InputError
        If it is neither None nor a whole number from 0.
    """
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be None or a whole number from 0")
    return int(seed)


def check_rendering(render_mode: str | None, view: str) -> None:
    """Refuse a render mode or a view that there is not."""
    if view not in VIEWS:
        raise InputError(f"view is {view!r}; it must be one of {', '.join(VIEWS)}")
    if render_mode is not None and render_mode not in MODES:
        raise InputError(f"render_mode is {render_mode!r}; it must be None or one of {', '.join(MODES)}")


def draw_race(renderer: Renderer, batch: DriveBatch, race: int) -> NDArray[np.uint8] | None:
    """Draw one race of a batch as it stands."""
    cars = batch.state.cars[race, :1] if batch.alone else batch.state.cars[race]
    facts = batch.facts_of(race)
    text = f"{facts['time']:.1f} s    {facts['progress']:.1f} m"
    if not batch.alone:
        text += f"    lead {facts['lead']:+.1f} m    against {facts['opponent']}"
    plans = None if batch.alone else [np.full((1, 2), np.nan), batch.state.path[race, 1]]
    return renderer.render(cars, plans=plans, text=text)
