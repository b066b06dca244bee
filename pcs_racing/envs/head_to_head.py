"""The environment at the level of strategy for two agents, in PettingZoo's parallel and turn-by-turn interfaces."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.envs.arguments import batch_arguments
from pcs_racing.envs.batch import check_options, check_rendering, check_reset_seed
from pcs_racing.envs.game_batch import GameBatch, draw_game
from pcs_racing.envs.infos import words
from pcs_racing.envs.over_batch import REBUILDING
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import advance
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track

__all__ = ["AGENTS", "HeadToHeadEnv", "HeadToHeadState", "env", "parallel_env"]

AGENTS = ("car_0", "car_1")
FRAME_TICKS = 20  # simulation steps between two frames of a window
WINDOW_FPS = 20.0  # so that a window shows four seconds of racing per second
TRAIL = 10  # frames of trail behind each car

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


class HeadToHeadState(NamedTuple):
    """A moment of a :class:`HeadToHeadEnv`: a value that can be kept, copied, pickled and restored.

    Attributes
    ----------
    batch : tuple
        State of the batch of one game.
    cycles : int
        Steps since the reset.
    over : bool
        Whether no episode goes on.
    generator : dict or None
        State of the generator that draws the next episode; None before the first reset.
    """

    batch: tuple[Any, ...]
    cycles: int
    over: bool
    generator: Mapping[str, Any] | None


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
    game. `track` and `opponent` replace the arguments from then on; `state` continues from what `get_state()`
    returned. Other options are refused.

    ## Episode End

    Both agents terminate after the last move has been driven, or when a car crashes. With `max_cycles` below the
    number of moves, they are truncated after so many moves.

    ## Information

    `info` of each agent holds numbers: `time` (s), `progress` and `lead` (own, m), `crash` and `opponent_crash`
    (`pcs_racing.envs.infos.Crash`: 0 none, 1 wall, 2 car), `fault` (1 if it is to blame), `overtakes`, `result`
    (`pcs_racing.envs.infos.Result`: 0 running, 1 win, 2 tie, 3 loss, 4 a crash that pays nobody), `opponent` (-1: the
    other agent), `move` and `opponent_move` (-1 before the first), `policy` (index in the archive) and `action_mask`.
    `env.metadata["codes"]` holds the words of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    - `track` (`"Tarnfjord"`): a circuit's name, its folder, or a `Track`.
    - `archive` (`"default"`): an archive's name, its folder, or a `PolicyArchive`.
    - `race` (`"paper"`): rules of the race: `"paper"`, `"contest"`, a YAML file, a `RaceConfig`; or a `GameConfig`.
    - `opponent` (`None`): what drives `car_1` in place of a second agent: as for `pcs_racing/Duel-v1`. Then `car_0` is
      the only agent.
    - `deterministic_opponent` (`True`): whether a model takes its best move.
    - `render_mode` (`None`): `"rgb_array"`: `render()` returns a picture; `"human"`: every step is shown in a window.
    - `view` (`"both"`): `"track"`, `"both"`, `"car_0"` or `"car_1"`.
    - `render_size` (`(960, 640)`): width and height in pixels.
    - `max_cycles` (`None`): moves after which an episode is truncated.
    - every field of `GameConfig`: `moves` (4), `step_seconds` (8.0), `epsilon` (0.5; one number, or several), `stay`
      (as the race's rules say), `utility`, `fault_penalty` (0), `discount` (1), `characteristics` (the archive's),
      `mask_duplicates` (False).

    ## Vectorized environment

    `pcs_racing.game.rules.RaceGame` plays any number of games at once, with the same rules: this environment is a batch
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
        opponent: Any = None,
        deterministic_opponent: bool = True,
        render_mode: str | None = None,
        view: str = "both",
        render_size: tuple[int, int] = (960, 640),
        max_cycles: int | None = None,
        **settings: Any,
    ) -> None:
        arguments = batch_arguments(HeadToHeadEnv, locals(), GameConfig, settings)
        self._set_up(arguments, render_mode, view, render_size)

    def _set_up(
        self, arguments: dict[str, Any], render_mode: str | None, view: str, render_size: tuple[int, int]
    ) -> None:
        """Make the batch and the spaces; ``max_cycles`` is among the arguments."""
        check_rendering(render_mode, view)
        max_cycles = arguments.pop("max_cycles")
        if max_cycles is not None:
            check_whole("max_cycles", max_cycles, 1)
        self._arguments = arguments
        self._use(self._make_batch(arguments))
        self.render_mode, self.view, self.render_size = render_mode, view, render_size
        self.max_cycles = max_cycles
        self.possible_agents = list(AGENTS[: self.batch.players])
        self.agents: list[str] = []
        box, discrete = self.batch.observation_space, self.batch.action_space
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(box.low, box.high) for name in self.possible_agents
        }
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            name: spaces.Discrete(int(discrete.n)) for name in self.possible_agents
        }
        self.state_space = spaces.Box(np.tile(box.low, 2), np.tile(box.high, 2))
        self._generator: np.random.Generator | None = None
        self._before: GameState | None = None  # what the last step began with: frames are driven again from it
        self._cycles = 0
        self._renderer: Renderer | None = None

    def _make_batch(self, arguments: dict[str, Any]) -> GameBatch:
        return GameBatch(1, threads=1, players=2 if arguments["opponent"] is None else 1, **arguments)

    def _use(self, batch: GameBatch) -> None:
        self.batch = batch
        self.metadata = {**type(self).metadata, "codes": batch.codes}  # type: ignore[misc]

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy everything but the window."""
        return {**self.__dict__, "_renderer": None}

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self.batch.game

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Observation space of an agent; always the same object."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Action space of an agent; always the same object."""
        return self.action_spaces[self._known(agent)]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin a new game; with a seed, the one that belongs to it.

        Raises
        ------
        InputError
            If the seed or an option is impossible or unknown.
        """
        number = check_reset_seed(seed)
        given = check_options(options, (*REBUILDING, "state", "options", *self.batch.reset_options))
        given.pop("options", None)  # what the API tests of PettingZoo hand over to every environment
        state = given.pop("state", None)
        if state is not None:
            if given or number is not None:
                raise InputError("reset option 'state' was given with others or a seed; it leaves nothing to choose")
            self.set_state(state)
            return self._observations(), self._infos()
        changes = {name: given.pop(name) for name in REBUILDING if name in given}
        batch = self._make_batch({**self._arguments, **changes}) if changes else self.batch
        if batch.players != len(self.possible_agents):
            raise InputError("reset option 'opponent' needs an environment that was made with an opponent")
        generator = self._generator
        if number is not None or generator is None:
            generator = np.random.default_rng(number)
        batch.restart(np.zeros(1, np.int64), [generator], given)
        if changes:
            self.close()
            self._arguments = {**self._arguments, **changes}
            self._use(batch)
        self._generator, self._before, self._cycles = generator, None, 0
        self.agents = list(self.possible_agents)
        if self.render_mode == "human":
            self.render()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let both cars move, and drive a step.

        Raises
        ------
        InputError
            If there is no game going on, an action is missing, or it is no move.
        """
        before = self.batch.started()
        if not self.agents:
            raise InputError("the game is over; call reset() to begin a new one")
        agents = self.possible_agents
        if not isinstance(actions, Mapping) or any(agent not in actions for agent in agents):
            raise InputError(f"actions are {actions!r}; they must hold a move for each of {', '.join(agents)}")
        moves = [actions[agent] for agent in agents]
        _, rewards, terminated, _ = self.batch.step(
            self.batch.check_actions(moves, (len(agents),)), [self._generator or np.random.default_rng()]
        )
        self._before = before
        self._cycles += 1
        over = bool(terminated[0])
        cut = not over and self.max_cycles is not None and self._cycles >= self.max_cycles
        if over or cut:
            self.agents = []
        if self.render_mode == "human":
            for frame in self.frames():
                del frame  # shown by the renderer
        return (
            self._observations(),
            {agent: float(reward) for agent, reward in zip(agents, rewards, strict=True)},
            dict.fromkeys(agents, over),
            dict.fromkeys(agents, cut),
            self._infos(),
        )

    def state(self) -> NDArray[np.float32]:
        """Observations of both cars, one after the other.

        Raises
        ------
        InputError
            Before the first reset.
        """
        self.batch.started()
        return self.batch.seen[0].reshape(-1).copy()

    def outcome(self) -> dict[str, dict[str, Any]]:
        """Return the info of each agent at this moment in words, for people."""
        return {agent: words(info, self.batch.codes) for agent, info in self._infos().items()}

    # The environment as a value

    def get_state(self) -> HeadToHeadState:
        """Return everything that the future of this environment depends on, as an independent value."""
        generator = None if self._generator is None else self._generator.bit_generator.state
        return HeadToHeadState(self.batch.get_state(), self._cycles, not self.agents, generator)

    def set_state(self, state: HeadToHeadState) -> None:
        """Continue from a moment that :meth:`get_state` of an environment with the same arguments returned.

        Raises
        ------
        InputError
            If it is no such moment, or belongs to another kind of game.
        """
        if not isinstance(state, HeadToHeadState):
            raise InputError(f"state is of type {type(state).__name__}; it must be what get_state() returned")
        generator = None
        if state.generator is not None:
            generator = np.random.default_rng()
            try:
                generator.bit_generator.state = state.generator
            except (TypeError, ValueError, KeyError) as error:
                raise InputError(f"the state's random generator can't be restored: {error}") from None
        self.batch.set_state(state.batch)
        self._generator, self._before, self._cycles = generator, None, state.cycles
        self.agents = [] if state.over else list(self.possible_agents)

    # Pictures

    def render(self) -> NDArray[np.uint8] | None:
        """Draw this moment: an array (height, width, 3) of uint8; None where a window shows it or nothing is drawn."""
        if self.render_mode is None:
            return None
        return self._draw(self.batch.started(), None)

    def frames(self) -> Iterator[NDArray[np.uint8] | None]:
        """Drive the last step again and draw five moments of each second: what `render` gives, for videos."""
        if self.render_mode is None or self._before is None:
            return
        trail: list[NDArray[np.float64]] = []
        for begun, theta in self._pieces():
            race = begun.copy()
            state = self.batch.started()._replace(race=race)
            for _ in range(0, self.game.config.step_ticks, FRAME_TICKS):
                before = int(race.tick[0])
                advance(self.game.setup, race, theta, FRAME_TICKS, threads=1)
                if int(race.tick[0]) == before:
                    break
                trail = [*trail[-TRAIL + 1 :], race.cars[0, :, :2].copy()]
                yield self._draw(state, np.array(trail))

    def _pieces(self) -> list[tuple[RaceState, NDArray[np.float64]]]:
        """Where the pieces of driving of the last step began, and the parameters that drove them."""
        return [] if self._before is None else [(self._before.race, self.batch.started().theta)]

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _draw(self, state: GameState, trails: NDArray[np.float64] | None) -> NDArray[np.uint8] | None:
        if self._renderer is None:
            mode = self.render_mode or "rgb_array"
            self._renderer = Renderer(self.game.track, *self.render_size, mode, view=self.view, fps=WINDOW_FPS)
        return draw_game(self._renderer, self.batch, state, 0, trails)

    # What the agents observe

    def _observations(self) -> Observations:
        return {agent: self.batch.seen[0, car].copy() for car, agent in enumerate(self.possible_agents)}

    def _infos(self) -> Infos:
        return {agent: self.batch.info(car) for car, agent in enumerate(self.possible_agents)}

    def _known(self, agent: str) -> str:
        if agent not in self.possible_agents:
            raise InputError(f"agent {agent!r} is unknown; the agents are {', '.join(self.possible_agents)}")
        return agent


def parallel_env(**arguments: Any) -> HeadToHeadEnv:
    """Make a :class:`HeadToHeadEnv` (PettingZoo's parallel interface); the arguments are the class's."""
    return HeadToHeadEnv(**arguments)


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both cars move, then a step is driven."""
    return parallel_to_aec(HeadToHeadEnv(**arguments))
