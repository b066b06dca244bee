"""The strategy level for a single agent: one car's moves, with an opponent in the other."""

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive import check_rendering, checked_seed
from pcs_racing.envs.duel_batch import DuelBatch
from pcs_racing.envs.duel_vector import DuelVectorEnv
from pcs_racing.envs.opponents import Opponent
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import ObservationElement, RaceGame
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.rendering import MODES, Renderer
from pcs_racing.track.track import Track

__all__ = ["DuelEnv", "DuelState", "DuelVectorEnv"]


class DuelState(NamedTuple):
    """A moment of a :class:`DuelEnv`: a value that can be kept, copied, pickled and restored."""

    games: tuple[Any, ...]
    running: bool
    generator: dict[str, Any]


class DuelEnv(gym.Env[NDArray[np.float32], np.int64]):
    """Play the game of moves in Policy Characteristic Space against an opponent.

    ## Description

    The view that the player of car 0 has of :class:`pcs_racing.envs.head_to_head.HeadToHeadEnv`. Both cars are driven
    by a motion planner with a policy from an archive. The players watch one step of 8 s, then make 4 moves; each asks
    for a bit more or less of one characteristic, the car goes on with the nearest policy of the archive, and 8 s are
    driven.

    ## Action Space

    ``Discrete(2 G)`` for G characteristics: move ``2 i`` asks for more of characteristic ``i``, move ``2 i + 1`` for
    less. With the default archive: 0 ``aggressiveness +``, 1 ``aggressiveness -``, 2 ``restraint +``, 3 ``restraint
    -``; with ``stay`` the last move keeps the policy. ``action_masks()`` and ``info["action_mask"]`` say which may be
    made.

    ## Observation Space

    ``Box(float32)`` with ``(moves + 1) (2 G + 2) + 1`` elements, 31 by default; ``env.unwrapped.elements`` holds name,
    unit, bounds and meaning of each. Step 0 is the one in which the players only watch, step ``k`` follows move ``k``.
    "Range" means that 0 is the archive's smallest and 1 its largest value.

    | Index | Element | Unit | Low | High |
    |---|---|---|---|---|
    | 6k | own_aggressiveness_k | range | -1 | 2 |
    | 6k + 1 | own_restraint_k | range | -1 | 2 |
    | 6k + 2 | opponent_aggressiveness_k | range | -1 | 2 |
    | 6k + 3 | opponent_restraint_k | range | -1 | 2 |
    | 6k + 4 | lead_k | 20 m | -5 | 5 |
    | 6k + 5 | seen_k | 1 | 0 | 1 |
    | 30 | step | 1 | 0 | 1 |

    ## Rewards

    0 until the game ends; then the utility: by default the own lead in m, and 0 after a crash. ``utility``,
    ``fault_penalty`` and ``discount`` change it (:class:`pcs_racing.game.config.GameConfig`).

    ## Starting State

    Start line, side, both policies, the steering noise (none in "paper") and the opponent are drawn from the
    environment's generator; then the first step is driven. Should it end in a crash, the game is drawn again.

    ## Episode End

    *Terminated* after the last move has been driven, or when a car crashes; never truncated. ``info`` holds ``move``
    and ``opponent_move`` (names; "" before the first), ``policy`` (index in the archive), ``lead`` (m), ``crash`` and
    ``opponent_crash`` ("", "wall" or "car"), ``fault``, ``result`` ("win", "tie", "loss", "crash" for a crash that pays
    nobody, "" while the game goes on), ``opponent`` (its name) and ``action_mask``.

    ## Arguments

    Parameters
    ----------
    track : str, Path or Track
    archive : str, Path or PolicyArchive
    opponent : str, Policy, object with ``predict``, callable, or list
        "random-moves"; "never-switch" (a policy of the archive, drawn for each game and kept); "always-<move>", for
        instance "always-aggressiveness +"; a driver such as "lane-switcher:3" or a Policy, which makes no moves; a
        model of Stable-Baselines3 or any object with its ``predict(observation, state, episode_start, deterministic)``;
        a function ``f(observation, generator) -> move``; or a mixture ``[(weight, opponent), ...]``, of which one is
        drawn for each game. It sees what car 1 sees, and may make the moves that the rules offer: one that makes
        "stay", as many agents of the zoo do, needs ``stay=True`` where the rules have no such move.
    race : str, Path, RaceConfig or GameConfig
        Rules: "paper", "contest", a YAML file or a configuration.
    deterministic_opponent : bool
        Whether models take their best move; if not, they draw with a generator of their own, which no seed of this
        environment reaches.
    render_mode : {"rgb_array", "human"}, optional
    view : {"track", "both", "car_0", "car_1"}
        What a frame shows.
    **settings
        Fields of :class:`pcs_racing.game.config.GameConfig`: ``moves``, ``step_seconds``, ``epsilon``, ``stay``...

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Duel-v1", num_envs=256)`` gives :class:`pcs_racing.envs.duel_vector.DuelVectorEnv`: one
    compiled call for all games, and the same numbers as this class gives with the same seeds.

    ## Version History

    * v1: fifty start lines at places found by driving, which no table uses; drivers leave room and do not brake for a
      car behind; the same bits on every x86-64 machine.
    * v0: first version.

    Examples
    --------
    >>> env = DuelEnv(opponent=[(1, "random-moves"), (2, "never-switch")])
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (31,)
    """

    metadata: dict[str, Any] = {"render_modes": list(MODES), "render_fps": 1}  # noqa: RUF012

    def __init__(
        self,
        track: Track | str | Path = "Tarnfjord",
        archive: PolicyArchive | str | Path = "default",
        opponent: Any = "random-moves",
        race: GameConfig | RaceConfig | str | Path = "paper",
        *,
        deterministic_opponent: bool = True,
        render_mode: str | None = None,
        view: str = "both",
        **settings: Any,
    ) -> None:
        if opponent is None:
            raise InputError("opponent is None; name one, for instance 'random-moves'")
        check_rendering(render_mode, view)
        self.render_mode, self.view = render_mode, view
        self._arguments = dict(
            track=track,
            archive=archive,
            opponent=opponent,
            race=race,
            deterministic_opponent=deterministic_opponent,
            **settings,
        )
        self._batch = DuelBatch(1, threads=1, **self._arguments)
        self.observation_space = spaces.Box(self._batch.low, self._batch.high, dtype=np.float32)
        self.action_space = spaces.Discrete(len(self.game.move_names))
        self._running = False
        self._renderer: Renderer | None = None

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self._batch.game

    @property
    def elements(self) -> tuple[ObservationElement, ...]:
        """Name, unit, bounds and meaning of every element of the observation."""
        return self.game.observation_elements

    @property
    def opponents(self) -> list[Opponent]:
        """The opponents among which each episode's is drawn."""
        return list(self._batch.opponents)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new game.

        Parameters
        ----------
        seed : int, optional
            Begin anew with this seed; without it the generator goes on.
        options : dict, optional
            Ignored.
        """
        super().reset(seed=checked_seed(seed))
        self._batch.restart(np.zeros(1, np.int64), [self.np_random])
        self._running = True
        if self.render_mode == "human":
            self.render()
        return self._batch.seen[0, 0].copy(), self._facts()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Make a move, and drive a step.

        Parameters
        ----------
        action : int
            Index of the move.

        Raises
        ------
        InputError
            If it is no move, or no game is going on.
        """
        moves = self._batch.check_actions(action, 1)
        self._batch.started()
        if not self._running:
            raise InputError("the episode has ended; call reset() before step()")
        utility, done = self._batch.step(moves, [self.np_random])
        self._running = not bool(done[0])
        if self.render_mode == "human":
            self.render()
        return self._batch.seen[0, 0].copy(), float(utility[0, 0]), bool(done[0]), False, self._facts()

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that may be made, shape (M,), as sb3-contrib's MaskablePPO asks for them."""
        return self.game.action_mask(self._batch.started())[0, 0].copy()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a frame (``"rgb_array"``), or show it (``"human"``).

        Raises
        ------
        InputError
            If there is no game to show yet, or the environment was made without a render mode.
        """
        if self.render_mode is None:
            raise InputError("render_mode is None; make the environment with render_mode='rgb_array' or 'human'")
        race = self._batch.started().race
        if self._renderer is None:
            self._renderer = Renderer(self.game.track, mode=self.render_mode, view=self.view)
        facts = self._facts()
        text = f"{race.tick[0] / 100:.0f} s    lead {facts['lead']:+.1f} m    {facts['move']}"
        return self._renderer.render(race.cars[0], plans=race.path[0], text=f"{text}    against {facts['opponent']}")

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def get_state(self) -> DuelState:
        """Return all that the rest of this game, and all later ones, depend on."""
        return DuelState(self._batch.get_state(), self._running, dict(self.np_random.bit_generator.state))

    def set_state(self, state: DuelState) -> NDArray[np.float32]:
        """Go on from what `get_state` returned, here or in an environment with equal arguments.

        Returns the observation at that moment.

        Raises
        ------
        InputError
            If the state does not fit this environment.
        """
        if not isinstance(state, DuelState):
            raise InputError(f"state is a {type(state).__name__}; it must be what get_state returned")
        self._batch.set_state(state.games)
        self.np_random.bit_generator.state = state.generator
        self._running = state.running
        return self._batch.seen[0, 0].copy()

    def _facts(self) -> dict[str, Any]:
        facts: dict[str, Any] = {}
        for name, values in self._batch.facts().items():
            facts[name] = values[0] if values.ndim > 1 or values.dtype == object else values[0].item()
        return facts

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = {**self._arguments, "render_mode": self.render_mode, "view": self.view}
        return _rebuild, (type(self), arguments, self.get_state())

    def __deepcopy__(self, memo: dict[int, Any]) -> "DuelEnv":
        function, arguments = self.__reduce__()
        return function(*arguments)


def _rebuild(kind: type[DuelEnv], arguments: dict[str, Any], state: DuelState) -> DuelEnv:
    env = kind(**arguments)
    env.set_state(state)
    return env
