"""Strategy-level environment: moves of one car against an opponent, or of both cars."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.game_batch import (
    DrivenStep,
    GameBatch,
    GameOptions,
    TwoPlayerOptions,
)
from pcs_racing.envs.opponents import Opponent
from pcs_racing.envs.over_batch import OverBatch
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.state import MODES

FILM = "rgb_array_list"  # render mode where `render` returns all frames since its last call
FILM_RATE = 25  # frames of a film for each second of racing
FILM_TICKS = 4  # simulation steps between two frames of a film
WINDOW_TICKS = 16  # simulation steps between two frames of a window: 4 times real time at 25 fps


class OverGames(OverBatch):
    """Common parts of environments of the game of moves; their long steps are filmed."""

    batch_type: ClassVar[type[GameBatch]] = GameBatch
    options_type: ClassVar[type[GameOptions]] = GameOptions
    batch: GameBatch

    @property
    def game(self) -> RaceGame:
        """Rules of the game."""
        return self.batch.game

    def _show_step(self) -> None:
        # A window shows each drawn frame.
        frames = len(
            list(self.batch.film(self._open_renderer(), self.batch.last_step(), WINDOW_TICKS))
        )
        if frames == 0:
            super()._show_step()

    def _frames_per_second(self) -> int:
        return FILM_RATE if self.render_mode in (FILM, "human") else self.batch.frame_rate


class DuelEnv(OverGames, ScalarEnv):
    """Game of moves in the Policy Characteristic Space against an opponent.

    ## Description

    A motion planner with a policy from an archive drives each car. A policy is a point in the
    Policy Characteristic Space. Its coordinates describe its driving, for instance the gained lead
    (aggressiveness, m) and the kept time to collision (restraint, s). The players watch one step of
    8 s, then make 4 moves. Each move requests slightly more or less of one characteristic. Then the
    car continues with the nearest policy of the archive, and 8 s are driven. This is the game of
    Section V of the paper, seen by the player of car 0. With the rules ``contest`` players move
    6 times: on the grid, at 2 s, and at 8, 16, 24 and 32 s.

    ## Action Space

    ``Discrete(2 G)`` for G characteristics: move ``2 i`` requests more of characteristic ``i``,
    move ``2 i + 1`` less. With the default archive: 0 ``aggressiveness +``, 1 ``aggressiveness -``,
    2 ``restraint +``, 3 ``restraint -``. With several step sizes (``epsilon``) the moves of each
    size follow one another. With ``stay`` the last move keeps the policy. A move may lead to the
    policy in use; then nothing changes. ``action_masks()`` and ``info["action_mask"]`` mask a move
    with the same target as ``stay`` or an earlier move; masked moves are still legal.

    ## Observation Space

    ``Box(float32)`` with ``(moves + 1) (2 G + 2) + 1`` elements, 31 by default;
    ``env.unwrapped.elements`` is the table of its elements: name, unit, bounds and meaning of each.
    In step 0 the players only watch; step ``k`` follows move ``k``. "Range" means that 0 is the
    archive's min value and 1 its max value. Values beyond the bounds are clipped.

    ## Rewards

    The reward is 0 until the end of the game, then the utility: by default the own lead in m, and 0
    after a crash (``utility="lead"``); or the lead even after a crash (``"lead-at-crash"``); or 1
    for a win and -1 for a defeat (``"win"``). The car to blame for a crash pays a ``fault_penalty``
    to the other car. A ``discount`` multiplies the utility once for each move made. The argument
    ``reward`` gives another reward.

    ## Starting State

    The environment's generator draws the start line, the side, both policies, the steering noise
    (none in "paper") and the opponent. Then the first step is driven. If it ends in a crash, the
    game is drawn again; with given policies and start, the first call of ``step`` ends the game
    instead.

    ``reset(options=...)`` takes these options and refuses others:

    - ``policies``: two indices of the archive; -1 draws a policy;
    - ``start``: arc length of the line in m, and side (0 puts car 0 on the left or in front);
    - ``obstacles``: boxes (x, y, heading, length and width in m and rad), shape (K, 5); with
      speed (m/s) and sway (m) of moving ones (K, 7);
    - ``state``: a state returned by ``get_state()``.

    ## Episode End

    *Terminated* after the step of the last move, or when a car crashes; never truncated.

    ## Information

    The numbers of :class:`pcs_racing.envs.drive.DriveEnv`, and ``move`` and ``opponent_move`` (-1
    before the first move, and for a fixed policy), ``policy`` (index in the archive) and
    ``action_mask``. ``env.unwrapped.metadata["codes"]`` maps integer codes to labels.
    ``env.unwrapped.outcome()`` returns the info with labels in place of codes.

    ## Arguments

    :class:`pcs_racing.envs.game_batch.GameOptions` and :class:`pcs_racing.game.Rules` list
    them; all are given by name.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Duel-v1", num_envs=256)`` makes a
    :class:`pcs_racing.envs.duel.DuelVectorEnv`: one compiled call for all games, with the same
    numbers as this class for the same seeds.

    Examples
    --------
    >>> env = DuelEnv(opponent=[(1, "random-moves"), (2, "never-switch")])
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (31,)
    """

    metadata: dict[str, Any] = ScalarEnv.metadata | {"render_modes": [*MODES, FILM]}
    _unseen: tuple[DrivenStep, ...] = ()  # steps not yet returned by `render`

    @property
    def opponents(self) -> list[Opponent]:
        """Opponents; one is drawn for each episode."""
        return list(self.batch.opponents)

    def render(self) -> Any:
        """Return a frame, show it, or return a list of frames.

        The render mode ``"rgb_array"`` returns a frame, ``"human"`` shows it, and
        ``"rgb_array_list"`` returns all frames since the last call or the reset, 25 for each second
        of racing. The list is empty if nothing was driven since.
        """
        if self.render_mode != FILM:
            return super().render()
        renderer, batch = self._open_renderer(), self.batch
        steps, self._unseen = self._unseen, ()
        frames = [frame for step in steps for frame in batch.film(renderer, step, FILM_TICKS)]
        return frames or [batch.draw(renderer, 0) for _ in steps[:1]]  # one if restored

    def _keep_step(self, *, begun: bool = False) -> None:
        # A film drives the races again, so unused frames are never drawn.
        if self.render_mode == FILM:
            self._unseen = (*(() if begun else self._unseen), self.batch.last_step())

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of valid moves, shape (M,), for sb3-contrib's MaskablePPO."""
        return self.batch.action_masks()[0]


class DuelVectorEnv(OverGames, BatchVectorEnv):
    """Vector environment of :class:`DuelEnv`, with the same numbers for the same seeds.

    It takes the arguments of :class:`DuelEnv` and
    :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = DuelVectorEnv(4, opponent="never-switch")
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 31)
    """

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of valid moves, shape (num_envs, M), for sb3-contrib's MaskablePPO."""
        return self.batch.action_masks()


class SelfPlayVectorEnv(DuelVectorEnv):
    """Self-play games: environments ``2 i`` and ``2 i + 1`` are cars 0 and 1 of game ``i``.

    A policy acting in all environments plays against itself. The rewards of a pair add up to zero.
    ``reset(seed=...)`` takes one seed for each game. The class takes the arguments of
    :class:`DuelVectorEnv`; ``opponent`` must be None.
    """

    options_type: ClassVar[type[GameOptions]] = TwoPlayerOptions
    players = 2


class HeadToHeadEnv(OverGames, ParallelBatchEnv):
    """Race of two cars whose players change aggressiveness and restraint move by move.

    ## Description

    :class:`pcs_racing.envs.duel.DuelEnv` with a player for each car: the same rules, with
    simultaneous moves.

    ## Action Space

    `Discrete(2 G)` for G characteristics: the moves of `DuelEnv`. `info["action_mask"]` (int8)
    marks the valid moves.

    ## Observation Space

    `Box(float32)` with `(moves + 1) (2 G + 2) + 1` elements, 31 by default: the elements of
    `DuelEnv`, seen from the own car.

    `state()` is the observation of `car_0`, followed by the observation of `car_1`.

    ## Rewards

    The rewards of `DuelEnv`. The rewards of the two cars add up to zero.

    ## Starting State

    As in `DuelEnv`, with the same options of `reset(options=...)`.

    ## Episode End

    Both agents terminate after the step of the last move, or when a car crashes. If `max_cycles` is
    below the number of moves, they are truncated after `max_cycles` moves.

    ## Information

    `info` of each agent holds the numbers of `DuelEnv`, seen from its own car; `opponent` is -1:
    the other agent. `env.metadata["codes"]` maps integer codes to labels. `env.outcome()` returns
    the infos with labels in place of codes.

    ## Arguments

    The arguments of `DuelEnv`. An episode is truncated after `max_cycles` steps.

    ## Vectorized environment

    `pcs_racing.game.rules.RaceGame` plays any number of games at once, with the same rules: this
    environment is a batch of one. `gymnasium.make_vec("pcs_racing/Duel-v1", num_envs=256)` is the
    single-agent view of such a batch.
    """

    metadata: dict[str, Any] = ParallelBatchEnv.metadata | {"name": "head_to_head_v1"}
    options_type: ClassVar[type[GameOptions]] = TwoPlayerOptions


parallel_env = HeadToHeadEnv
"""PettingZoo's name for the constructor of a parallel environment."""


def env(
    *, max_cycles: int | None = None, **arguments: Any
) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment with PettingZoo's AEC interface.

    Both cars move, then a step is driven.
    """
    return parallel_to_aec(parallel_env(max_cycles=max_cycles, **arguments))
