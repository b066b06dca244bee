"""The strategy-level environment for two agents, in PettingZoo's parallel and turn-by-turn (AEC) interfaces."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.base.errors import InputError
from pcs_racing.envs.opponents import as_array
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import RaceGame, make_game
from pcs_racing.game.state import GameState, empty_game
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import advance
from pcs_racing.race.rendering import MODES, VIEWS, Renderer
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import CAR_CRASH, WALL_CRASH
from pcs_racing.track.track import Track

__all__ = ["AGENTS", "HeadToHeadEnv", "HeadToHeadState", "env", "parallel_env"]

AGENTS = ("car_0", "car_1")
CRASHES = {WALL_CRASH: "wall", CAR_CRASH: "car"}
FRAME_TICKS = 20  # simulation steps between two frames of a window
WINDOW_FPS = 20.0  # so that a window shows four seconds of racing per second
TRAIL = 10  # frames of trail behind each car

Observations = dict[str, NDArray[np.float32]]


class HeadToHeadState(NamedTuple):
    """A moment of a :class:`HeadToHeadEnv`: a value that can be kept, copied, pickled and restored.

    Attributes
    ----------
    game : GameState or None
        The one game; None before the first reset.
    moves : tuple of int
        Last move of each car; -1 before the first.
    cycles : int
        Steps since the reset.
    over : bool
        Whether the episode has ended.
    random : dict or None
        State of the generator that draws the next episode; None before the first reset.
    """

    game: GameState | None
    moves: tuple[int, int]
    cycles: int
    over: bool
    random: Mapping[str, Any] | None


class HeadToHeadEnv(ParallelEnv[str, NDArray[np.float32], int]):
    """Two cars race each other; their players change, move by move, how aggressive and how restrained they drive.

    ## Description

    Each car is driven by a motion planner with a policy from an archive. A policy is a point in the Policy
    Characteristic Space: its coordinates say how it drives, for instance how much lead it gains (aggressiveness, m)
    and how much time it keeps to a collision (restraint, s). The players watch one step of 8 s, then make 4 moves;
    each move asks for a bit more or less of one characteristic, the car continues with the nearest policy of the
    archive, and 8 s are driven. This is the game of Section V of the paper.

    ## Action Space

    `Discrete(2 G)` for G characteristics: move `2 i` asks for more of characteristic `i`, move `2 i + 1` for less.
    With the default archive: 0 `aggressiveness +`, 1 `aggressiveness -`, 2 `restraint +`, 3 `restraint -`. With
    several step sizes (`epsilon`) the moves of each follow one another; with `stay` the last move keeps the policy. A
    move may lead to the policy in use: then nothing changes. `info["action_mask"]` (int8) says which moves may be
    made: all of them, unless `mask_duplicates` is set.

    ## Observation Space

    `Box(float32)` with `(moves + 1) (2 G + 2) + 1` elements; 31 by default. Step 0 is the one in which the players
    only watch, step `k` follows move `k`. The unit "range" means that 0 is the archive's smallest and 1 its largest
    value of that characteristic; values beyond the bounds are clipped.

    | index | name | unit | low | high | meaning |
    | --- | --- | --- | --- | --- | --- |
    | 6k + 0 | own_aggressiveness_k | range | -1 | 2 | the own policy's aggressiveness in step k, from the archive |
    | 6k + 1 | own_restraint_k | range | -1 | 2 | the own policy's restraint in step k, from the archive |
    | 6k + 2 | opponent_aggressiveness_k | range | -1 | 2 | the opponent's aggressiveness as measured in step k alone |
    | 6k + 3 | opponent_restraint_k | range | -1 | 2 | the opponent's restraint as measured in step k alone |
    | 6k + 4 | lead_k | 20 m | -5 | 5 | own lead at the end of step k |
    | 6k + 5 | seen_k | 1 | 0 | 1 | 1 once step k is over; until then it and the numbers above are 0 |
    | 30 | step | 1 | 0 | 1 | share of the moves that have been made |

    `state()` is the observation of `car_0` followed by that of `car_1`.

    ## Rewards

    Zero until the game ends. Then each car gets its utility, and the two add up to zero: by default its lead in m,
    and 0 after a crash (`utility="lead"`); or the lead even after a crash (`"lead-at-crash"`); or 1 for a win and -1
    for a defeat (`"win"`). A `fault_penalty` goes from the car to blame for a crash to the other one. A `discount`
    multiplies the utility once for each move that was made.

    ## Starting State

    Start line, side, both policies and the steering noise (none in the preset `paper`) are drawn at random; then the
    first step is driven. Should it end in a crash, the game is drawn again. `reset(options=...)` takes `policies`
    (two indices of the archive; -1 draws one) and `start` (arc length of the line in m, and side: 0 puts `car_0` on
    the left or in front). If both are given and the first step ends in a crash, the first call of `step` ends the
    game. Other options are ignored.

    ## Episode End

    Both agents terminate after the last move has been driven, or when a car crashes. With `max_cycles` below the
    number of moves, they are truncated after so many moves.

    ## Information

    `info` of each agent holds `move` (name of its last move, `""` before the first), `policy` (index in the archive),
    `lead` (own, m), `crash` (`""`, `"wall"` or `"car"`), `fault` (whether it is to blame), `result` (`"win"`,
    `"tie"`, `"loss"`, `"crash"` for a crash that pays nobody, `""` while the game goes on) and `action_mask`.

    ## Arguments

    - `track` (`"Tarnfjord"`): a circuit's name, its folder, or a `Track`.
    - `archive` (`"default"`): an archive's name, its folder, or a `PolicyArchive`.
    - `race` (`"paper"`): rules of the race: `"paper"`, `"contest"`, a YAML file, a `RaceConfig`; or a `GameConfig`.
    - `render_mode` (`None`): `"rgb_array"`: `render()` returns a picture; `"human"`: every step is shown in a window.
    - `render_view` (`"both"`): `"track"`, `"both"`, `"car_0"` or `"car_1"`.
    - `render_size` (`(960, 640)`): width and height in pixels.
    - `max_cycles` (`None`): moves after which an episode is truncated.
    - every field of `GameConfig`: `moves` (4), `step_seconds` (8.0), `epsilon` (0.5; one number, or several), `stay`
      (as the race's rules say), `utility`, `fault_penalty` (0), `discount` (1), `characteristics` (the archive's),
      `mask_duplicates` (False).

    ## Vectorized environment

    `pcs_racing.game.game.RaceGame` plays any number of games at once, with the same rules: this environment is a batch
    of one. `gymnasium.make_vec("pcs_racing/Duel-v1", num_envs=256)` is the single-agent view of such a batch.

    ## Version History

    - v1: fifty start lines at places found by driving, which no table uses; drivers leave room and do not brake for a
      car behind; the same bits on every x86-64 machine.
    - v0: first version.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "head_to_head_v1",
        "render_modes": ["human", "rgb_array"],
        "render_fps": WINDOW_FPS,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        track: Track | str | Path = "Tarnfjord",
        archive: PolicyArchive | str | Path = "default",
        race: GameConfig | RaceConfig | str | Path = "paper",
        *,
        render_mode: str | None = None,
        render_view: str = "both",
        render_size: tuple[int, int] = (960, 640),
        max_cycles: int | None = None,
        **settings: Any,
    ) -> None:
        if render_mode is not None and render_mode not in MODES:
            raise InputError(f"render_mode is {render_mode!r}; it must be None or one of {', '.join(MODES)}")
        if render_view not in VIEWS:
            raise InputError(f"render_view is {render_view!r}; it must be one of {', '.join(VIEWS)}")
        whole = isinstance(max_cycles, int | np.integer) and not isinstance(max_cycles, bool)
        if max_cycles is not None and not (whole and max_cycles >= 1):
            raise InputError(f"max_cycles is {max_cycles!r}; it must be None or a whole number from 1")
        self.game: RaceGame = make_game(track, archive, race, **settings)
        self.render_mode = render_mode
        self.render_view = render_view
        self.render_size = render_size
        self.max_cycles = max_cycles
        self.possible_agents = list(AGENTS)
        self.agents: list[str] = []
        elements = self.game.observation_elements
        low, high = (np.array([getattr(e, end) for e in elements], np.float32) for end in ("low", "high"))
        self.observation_spaces: dict[str, spaces.Space[Any]] = {name: spaces.Box(low, high) for name in AGENTS}
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            name: spaces.Discrete(len(self.game.move_names)) for name in AGENTS
        }
        self.state_space = spaces.Box(np.tile(low, 2), np.tile(high, 2))
        self._random: np.random.Generator | None = None
        self._state: GameState | None = None
        self._before: GameState | None = None  # what the last step began with: frames are driven again from it
        self._moves = (-1, -1)
        self._cycles = 0
        self._renderer: Renderer | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy everything but the window."""
        return {**self.__dict__, "_renderer": None}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Observation space of an agent; always the same object."""
        return self.observation_spaces[_known(agent)]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Action space of an agent; always the same object."""
        return self.action_spaces[_known(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Begin a new game; with a seed, the one that belongs to it.

        Raises
        ------
        InputError
            If the seed or one of the options ``policies`` and ``start`` is impossible.
        """
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
            raise InputError(f"seed is {seed!r}; it must be None or a whole number from 0")
        random = self._random
        if seed is not None or random is None:
            random = np.random.default_rng(seed)
        policies, starts = _options(options)
        key = random.integers(2**63, size=1, dtype=np.int64)
        self._state = self.game.reset(key, policies=policies, starts=starts)
        self._random = random
        self._before = None
        self._moves = (-1, -1)
        self._cycles = 0
        self.agents = list(AGENTS)
        if self.render_mode == "human":
            self.render()
        return self._observations(self._state), self._infos(self._state)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Let both cars move, and drive a step.

        Raises
        ------
        InputError
            If there is no game going on, an action is missing, or it is no move.
        """
        state = self._current()
        if not self.agents:
            raise InputError("the game is over; call reset() to begin a new one")
        moves = tuple(self._action(actions, agent) for agent in AGENTS)
        after = self.game.step(state, np.array([moves], np.int64))
        self._before, self._state = state, after
        self._moves = (moves[0], moves[1])
        self._cycles += 1
        over = bool(self.game.done(after)[0])
        cut = not over and self.max_cycles is not None and self._cycles >= self.max_cycles
        utility = self.game.utility(after)[0]
        if over or cut:
            self.agents = []
        if self.render_mode == "human":
            for frame in self.frames():
                del frame  # shown by the renderer
        return (
            self._observations(after),
            {agent: float(utility[car]) for car, agent in enumerate(AGENTS)},
            dict.fromkeys(AGENTS, over),
            dict.fromkeys(AGENTS, cut),
            self._infos(after),
        )

    def state(self) -> NDArray[np.float32]:
        """Observations of both cars, one after the other.

        Raises
        ------
        InputError
            Before the first reset.
        """
        return self.game.observation(self._current())[0].reshape(-1)

    # The environment as a value

    def get_state(self) -> HeadToHeadState:
        """Return everything that the future of this environment depends on, as an independent value."""
        return HeadToHeadState(
            game=None if self._state is None else self._state.copy(),
            moves=self._moves,
            cycles=self._cycles,
            over=not self.agents,
            random=None if self._random is None else self._random.bit_generator.state,
        )

    def set_state(self, state: HeadToHeadState) -> None:
        """Continue from a moment that :meth:`get_state` of an environment with the same arguments returned.

        Raises
        ------
        InputError
            If it is no such moment, or belongs to another kind of game.
        """
        if not isinstance(state, HeadToHeadState):
            raise InputError(f"state is of type {type(state).__name__}; it must be what get_state() returned")
        if state.game is not None:
            self._check(state.game)
        random = None
        if state.random is not None:
            random = np.random.default_rng()
            try:
                random.bit_generator.state = state.random
            except (TypeError, ValueError, KeyError) as error:
                raise InputError(f"the state's random generator can't be restored: {error}") from None
        self._random = random
        self._state = None if state.game is None else state.game.copy()
        self._before = None
        self._moves = state.moves
        self._cycles = state.cycles
        self.agents = [] if state.over else list(AGENTS)

    def _check(self, game: GameState) -> None:
        setup = self.game.setup
        steps, axes = self.game.config.moves + 1, len(self.game.characteristics)
        model = empty_game(1, setup.memory_size, setup.theta_size, steps, axes)
        names = (*game.race._fields, *game._fields[1:])
        given: list[Any] = [*game.race, *game[1:]]
        wanted: list[Any] = [*model.race, *model[1:]]
        for name, array, like in zip(names, given, wanted, strict=True):
            if not isinstance(array, np.ndarray) or array.shape != like.shape:
                raise InputError(
                    f"the state's {name} has shape {np.shape(array)}; in this environment it must be "
                    f"{like.shape}: it belongs to another archive, planner or number of moves"
                )
        if not ((game.policy >= 0) & (game.policy < len(self.game.archive))).all():
            raise InputError(
                f"the state's policies {game.policy[0].tolist()} are not all in archive {self.game.archive.name!r}"
            )

    # Pictures

    def render(self) -> NDArray[np.uint8] | None:
        """Draw this moment: an array (height, width, 3) of uint8; None where a window shows it or nothing is drawn."""
        if self.render_mode is None:
            return None
        return self._draw(self._current(), None)

    def frames(self) -> Iterator[NDArray[np.uint8] | None]:
        """Drive the last step again and draw five moments of each second: what `render` gives, for videos."""
        if self.render_mode is None or self._before is None:
            return
        state = self._before.copy()
        race, theta = state.race, self._current().theta
        trail: list[NDArray[np.float64]] = []
        for _ in range(0, self.game.config.step_ticks, FRAME_TICKS):
            before = int(race.tick[0])
            advance(self.game.setup, race, theta, FRAME_TICKS, threads=1)
            if int(race.tick[0]) == before:
                break
            trail = [*trail[-TRAIL + 1 :], race.cars[0, :, :2].copy()]
            yield self._draw(state, np.array(trail))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _draw(self, state: GameState, trails: NDArray[np.float64] | None) -> NDArray[np.uint8] | None:
        if self._renderer is None:
            width, height = self.render_size
            mode = self.render_mode or "rgb_array"
            self._renderer = Renderer(self.game.track, width, height, mode, view=self.render_view, fps=WINDOW_FPS)
        moves = " | ".join(
            f"{agent}: {self.game.move_names[move] if move >= 0 else 'watching'}"
            for agent, move in zip(AGENTS, self._moves, strict=True)
        )
        race = state.race
        text = f"{race.tick[0] / 100:.1f} s | lead of car_0 {race.lead[0]:+.1f} m | {moves}"
        plans = [path[:, :2] for path in race.path[0] if path.any()]
        shown = plans if len(plans) == len(AGENTS) else None
        return self._renderer.render(race.cars[0], plans=shown, trails=trails, text=text)

    # What the agents are told

    def _current(self) -> GameState:
        if self._state is None:
            raise InputError("there is no game yet; call reset() first")
        return self._state

    def _action(self, actions: Mapping[str, Any], agent: str) -> int:
        if not isinstance(actions, Mapping) or agent not in actions:
            raise InputError(f"actions are {actions!r}; they must hold a move for each of {', '.join(AGENTS)}")
        action = as_array(actions[agent])
        count = len(self.game.move_names)
        if action.shape != () or action.dtype.kind not in "iu" or not 0 <= int(action) < count:
            raise InputError(
                f"action of {agent} is {actions[agent]!r}; it must be a whole number from 0 to {count - 1} "
                f"({', '.join(self.game.move_names)})"
            )
        return int(action)

    def _observations(self, state: GameState) -> Observations:
        seen = self.game.observation(state)[0]
        return {agent: seen[car].copy() for car, agent in enumerate(AGENTS)}

    def _infos(self, state: GameState) -> dict[str, dict[str, Any]]:
        race = state.race
        mask = self.game.action_mask(state)[0]
        return {
            agent: {
                "move": self.game.move_names[self._moves[car]] if self._moves[car] >= 0 else "",
                "policy": int(state.policy[0, car]),
                "lead": float(race.lead[0]) * (1.0 if car == 0 else -1.0),
                "crash": CRASHES.get(int(race.crash[0, car]), ""),
                "fault": bool(race.fault[0, car]),
                "result": self._result(state, car),
                "action_mask": mask[car].astype(np.int8),
            }
            for car, agent in enumerate(AGENTS)
        }

    def _result(self, state: GameState, car: int) -> str:
        if not self.game.done(state)[0]:
            return ""
        winner = int(self.game.winner(state)[0])
        if winner < 0:
            return "crash" if state.race.crashed[0] else "tie"
        return "win" if winner == car else "loss"


def _known(agent: str) -> str:
    if agent not in AGENTS:
        raise InputError(f"agent {agent!r} is unknown; the agents are {', '.join(AGENTS)}")
    return agent


def _options(options: dict[str, Any] | None) -> tuple[NDArray[np.int64] | None, Starts | None]:
    """Policies and start that the options of a reset ask for."""
    policies = starts = None
    chosen = {} if options is None else options
    if not isinstance(chosen, Mapping):
        raise InputError(f"options are {options!r}; they must be None or a mapping")
    if chosen.get("policies") is not None:
        policies = as_array(chosen["policies"])
        if policies.shape != (2,):
            raise InputError(f"option policies is {chosen['policies']!r}; it must be two indices of the archive")
        policies = policies[None]
    if chosen.get("start") is not None:
        try:
            s, side = (float(value) for value in chosen["start"])
        except (TypeError, ValueError):
            s, side = np.nan, np.nan
        if not np.isfinite(s) or side not in (0.0, 1.0):
            raise InputError(f"option start is {chosen['start']!r}; it must be an arc length in m, and side 0 or 1")
        starts = Starts(np.array([s]), np.array([int(side)], np.int64))
    return policies, starts


def parallel_env(**arguments: Any) -> HeadToHeadEnv:
    """Make a :class:`HeadToHeadEnv` (PettingZoo's parallel interface); the arguments are the class's."""
    return HeadToHeadEnv(**arguments)


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both cars move, then a step is driven."""
    return parallel_to_aec(HeadToHeadEnv(**arguments))
