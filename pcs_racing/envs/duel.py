"""The environment at the level of strategy: moves of one car against an opponent, or of both cars by two agents."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.game_batch import DrivenStep, GameBatch, GameOptions
from pcs_racing.envs.opponents import Opponent
from pcs_racing.envs.over_batch import Declared, OverBatch
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.config import GameConfig
from pcs_racing.game.observation import observation_elements, observation_table
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.rendering import MODES

FILM = "rgb_array_list"  # render mode in which `render` returns all frames since it was last called
FILM_RATE = 25  # frames of a film for each second of racing
FILM_TICKS = 4  # simulation steps between two frames of a film
WINDOW_TICKS = 16  # the same in a window, which shows 25 frames a second as well: four times as fast

AXES = get_characteristics(("aggressiveness", "restraint"))
"""Those of the archive "default", which the tables of the classes' pages are made for."""

_MOVES = GameConfig().moves
_TABLE = observation_table(observation_elements(AXES, _MOVES), _MOVES)


class OverGames(OverBatch):
    """What environments of the game of moves have in common; their steps are so long that they are filmed."""

    batch_type = GameBatch
    batch: GameBatch

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self.batch.game

    def _show_step(self) -> None:
        # A window shows what is drawn.
        frames = len(list(self.batch.film(self._open_renderer(), self.batch.last_step(), WINDOW_TICKS)))
        if frames == 0:
            super()._show_step()

    def _frames_per_second(self) -> int:
        return FILM_RATE if self.render_mode in (FILM, "human") else self.batch.frame_rate


class DuelEnv(OverGames, ScalarEnv, observation_table=_TABLE):
    """Play the game of moves in Policy Characteristic Space against an opponent.

    ## Description

    Each car is driven by a motion planner with a policy from an archive. A policy is a point in the Policy
    Characteristic Space: its coordinates say how it drives, for instance how much lead it gains (aggressiveness, m)
    and how much time it keeps to a collision (restraint, s). The players watch one step of 8 s, then make 4 moves;
    each move asks for a bit more or less of one characteristic, the car continues with the nearest policy of the
    archive, and 8 s are driven. This is the game of Section V of the paper, seen by the player of car 0. With the
    rules ``contest`` players move 6 times: on the grid, at 2 s, and at 8, 16, 24 and 32 s.

    ## Action Space

    ``Discrete(2 G)`` for G characteristics: move ``2 i`` asks for more of characteristic ``i``, move ``2 i + 1`` for
    less. With the default archive: 0 ``aggressiveness +``, 1 ``aggressiveness -``, 2 ``restraint +``, 3 ``restraint
    -``. With several step sizes (``epsilon``) the moves of each follow one another; with ``stay`` the last move keeps
    the policy. A move may lead to the policy in use: then nothing changes. ``action_masks()`` and
    ``info["action_mask"]`` leave out a move that leads where ``stay`` or an earlier one leads; it may be made all the
    same.

    ## Observation Space

    ``Box(float32)`` with ``(moves + 1) (2 G + 2) + 1`` elements, 31 by default; ``env.unwrapped.elements`` holds name,
    unit, bounds and meaning of each. Step 0 is the one in which the players only watch, step ``k`` follows move ``k``.
    "Range" means that 0 is the archive's smallest and 1 its largest value; values beyond the bounds are clipped.

    {observation_table}

    ## Rewards

    0 until the game ends; then the utility: by default the own lead in m, and 0 after a crash (``utility="lead"``); or
    the lead even after a crash (``"lead-at-crash"``); or 1 for a win and -1 for a defeat (``"win"``). A
    ``fault_penalty`` goes from the car to blame for a crash to the other one. A ``discount`` multiplies the utility
    once for each move that was made.

    ## Starting State

    Start line, side, both policies, the steering noise (none in "paper") and the opponent are drawn from the
    environment's generator; then the first step is driven. Should it end in a crash, the game is drawn again; if
    policies and start were given, the first call of ``step`` ends it instead.

    ``reset(options=...)`` takes ``policies`` (two indices of the archive; -1 draws one), ``start`` (arc length of the
    line in m, and side: 0 puts car 0 on the left or in front), ``obstacles`` (boxes: x, y, heading, length and width in
    m and rad, shape (K, 5)), ``opponent`` and ``track``, which replace the arguments from then on, and ``state``, what
    ``get_state()`` returned. Others are refused.

    ## Episode End

    *Terminated* after the last move has been driven, or when a car crashes; never truncated.

    ## Information

    The numbers of :class:`pcs_racing.envs.drive.DriveEnv`, and ``move`` and ``opponent_move`` (-1 before the first, and
    for a driver), ``policy`` (index in the archive) and ``action_mask``.
    ``env.unwrapped.metadata["codes"]`` holds the words of all codes; ``env.unwrapped.outcome()`` is the info in words.

    ## Arguments

    {arguments}

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Duel-v1", num_envs=256)`` gives :class:`pcs_racing.envs.duel.DuelVectorEnv`: one
    compiled call for all games, and the same numbers as this class gives with the same seeds.

    Examples
    --------
    >>> env = DuelEnv(opponent=[(1, "random-moves"), (2, "never-switch")])
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (31,)
    """

    metadata: dict[str, Any] = {**ScalarEnv.metadata, "render_modes": [*MODES, FILM]}  # noqa: RUF012
    declared = Declared(GameOptions, positional=("track", "archive", "opponent", "race"), more=GameConfig)
    _unseen: tuple[DrivenStep, ...] = ()  # steps that `render` has not returned the frames of

    @property
    def opponents(self) -> list[Opponent]:
        """The opponents among which each episode's is drawn."""
        return list(self.batch.opponents)

    def render(self) -> Any:
        """Return a frame (``"rgb_array"``), show it (``"human"``), or return a list of frames (``"rgb_array_list"``).

        The list holds all frames since it was last asked for, or since the reset, 25 for each second of racing; it is
        empty if nothing was driven since.
        """
        if self.render_mode != FILM:
            return super().render()
        renderer, batch = self._open_renderer(), self.batch
        steps, self._unseen = self._unseen, ()
        frames = [frame for step in steps for frame in batch.film(renderer, step, FILM_TICKS)]
        return frames or [batch.draw(renderer, 0) for _ in steps[:1]]  # of a restored state, the moment

    def _keep_step(self, *, begun: bool = False) -> None:
        # Races are driven again for a film, so that what nobody asks for need not be drawn.
        if self.render_mode == FILM:
            self._unseen = (*(() if begun else self._unseen), self.batch.last_step())

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that may be made, shape (M,), as sb3-contrib's MaskablePPO asks for them."""
        return self.batch.action_masks()[0]


class DuelVectorEnv(OverGames, BatchVectorEnv):
    """Many :class:`DuelEnv` in one, with the same numbers for the same seeds.

    The arguments are those of :class:`DuelEnv` and of :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = DuelVectorEnv(4, opponent="never-switch")
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 31)
    """

    declared = replace(DuelEnv.declared, positional=())

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that each player may make, shape (num_envs, M), as sb3-contrib's MaskablePPO asks for them."""
        return self.batch.action_masks()


class SelfPlayVectorEnv(DuelVectorEnv):
    """Games in which both cars belong to the agent: environment ``2 i`` is car 0 of game ``i``, ``2 i + 1`` its car 1.

    One policy that acts in all environments plays against itself; rewards of a pair add up to zero. Seeds belong to
    games: ``reset(seed=...)`` takes one for each game. The arguments are those of :class:`DuelVectorEnv`, without
    ``opponent``.
    """

    declared = replace(DuelVectorEnv.declared, changed={"opponent": None})
    players = 2


class HeadToHeadEnv(OverGames, ParallelBatchEnv, observation_table=_TABLE):
    """Two cars race each other; their players change, move by move, how aggressive and how restrained they drive.

    ## Description

    :class:`pcs_racing.envs.duel.DuelEnv` with a player for each car: the same rules, and both moves are made at the
    same time.

    ## Action Space

    `Discrete(2 G)` for G characteristics: the moves of `DuelEnv`. `info["action_mask"]` (int8) says which may be made.

    ## Observation Space

    `Box(float32)` with `(moves + 1) (2 G + 2) + 1` elements, 31 by default: those of `DuelEnv`, seen from the own car.

    {observation_table}

    `state()` is the observation of `car_0` followed by that of `car_1`.

    ## Rewards

    Those of `DuelEnv`. The two cars' add up to zero.

    ## Starting State

    As in `DuelEnv`, and so are the options of `reset(options=...)`.

    ## Episode End

    Both agents terminate after the last move has been driven, or when a car crashes. With `max_cycles` below the
    number of moves, they are truncated after so many moves.

    ## Information

    `info` of each agent holds the numbers of `DuelEnv`, seen from its own car; `opponent` is -1: the other agent.
    `env.metadata["codes"]` holds the words of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    {arguments}

    ## Vectorized environment

    `pcs_racing.game.rules.RaceGame` plays any number of games at once, with the same rules: this environment is a batch
    of one. `gymnasium.make_vec("pcs_racing/Duel-v1", num_envs=256)` is the single-agent view of such a batch.
    """

    metadata: dict[str, Any] = {**ParallelBatchEnv.metadata, "name": "head_to_head_v1"}  # noqa: RUF012
    declared = Declared(
        GameOptions, positional=("track", "archive", "race"), more=GameConfig, changed={"opponent": None}
    )

    def frames(self) -> Iterator[NDArray[np.uint8] | None]:
        """Drive the last step again and draw 25 moments of each second: what `render` gives, for videos."""
        if self.render_mode is not None:
            yield from self.batch.film(self._open_renderer(), self.batch.last_step(), FILM_TICKS)

    def _frames_per_second(self) -> int:
        return FILM_RATE  # of `frames`, whatever the mode


parallel_env = HeadToHeadEnv
"""PettingZoo's name for what makes an environment of its parallel interface."""


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both cars move, then a step is driven."""
    return parallel_to_aec(parallel_env(**arguments))
