"""Environment of a series of races: one or two agents choose a policy before each race."""

from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv, OverGames
from pcs_racing.envs.match_batch import (
    MatchArguments,
    MatchBatch,
    MatchOptions,
    TwoPlayerMatchOptions,
)
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.game.match import MatchGame


class OverMatches(OverGames):
    """Common parts of environments of matches."""

    batch_type = MatchBatch
    batch: MatchBatch

    @property
    def match(self) -> MatchGame:
        """Rules of the match; ``game`` holds the rules of the races."""
        return self.batch.match


class MatchEnv(OverMatches, DuelEnv):
    """Match of several races against one opponent; the player chooses a policy before each race.

    ## Description

    A match is a series of races against the same opponent, drawn for the match. Before each race
    the player of car 0 chooses a policy of the archive for its car. The player knows the driving of
    both cars in the earlier races, and the winners. In each race the cars start on another line and
    swap their places on the grid. The rules are in :mod:`pcs_racing.game.match`.

    ## Action Space

    ``Discrete(K)`` for an archive of K policies: action ``k`` drives the next race with policy
    ``k``. Every policy can be chosen before every race, because knowing the opponent helps most
    before the start. Actions are indices, because policies close together in the Policy
    Characteristic Space may race differently.

    With ``race_moves`` a step is one step of a race (8 s), and the space is ``Discrete(K + M)``.
    Actions ``K`` to ``K + M - 1`` are the M moves of :class:`pcs_racing.envs.duel.DuelEnv`, for
    steps during a race. An action of the wrong kind has no effect: a move between two races keeps
    the policy of the last start, and a policy during a race keeps the policy. ``action_masks()``
    and ``info["action_mask"]`` mask the wrong kind.

    ## Observation Space

    ``Box(float32)`` with ``races (2 G + 3) + 2`` elements for G characteristics, 23 by default;
    ``env.unwrapped.elements`` holds the name, unit, bounds and meaning of each element. Races count
    from 0. "Range" means that 0 is the archive's min value and 1 its max value. All numbers of
    future races are 0.

    Here # is the race r:

    | index | name | unit | low | high | meaning |
    | --- | --- | --- | --- | --- | --- |
    | 7r | race_#_own_aggressiveness | range | -1 | 2 | own policy's, in the archive |
    | 7r + 1 | race_#_own_restraint | range | -1 | 2 | own policy's, in the archive |
    | 7r + 2 | race_#_opponent_aggressiveness | range | -1 | 2 | measured over race r |
    | 7r + 3 | race_#_opponent_restraint | range | -1 | 2 | measured over race r |
    | 7r + 4 | race_#_lead | 20 m | -5 | 5 | own lead at the end of race r |
    | 7r + 5 | race_#_score | 1 | 0 | 1 | 1 for a win, 0.5 for a tie |
    | 7r + 6 | race_#_driven | 1 | 0 | 1 | driven share of its duration |
    | 21 | races_left | 1 | 0 | 1 | share of the races that are not over |
    | 22 | front | 1 | 0 | 1 | 1 if the own car starts the next race on the left or in front |

    After a crash a race lasted less than its duration. With ``race_moves`` more elements follow:
    ``racing``, 1 during a race, and the observation of :class:`pcs_racing.envs.duel.DuelEnv` in
    that race, 0 between races.

    ## Rewards

    The score of each race at its end: 1 for a win, 1/2 for a tie, else 0. The sum is the number of
    races won. The argument ``reward`` gives another reward.

    ## Starting State

    The environment's generator draws the opponent, the start lines, the side of the first race, the
    noise, and the policy of an opponent that does not choose. Nothing is driven before the first
    action.

    ``reset(options=...)`` takes these options and refuses others:

    - ``policies``: two indices of the archive, the policies at the start of the races for players
      that do not choose; -1 draws a policy;
    - ``start``: arc length of the line of all races in m, and side of the first race (0 puts car 0
      on the left or in front);
    - ``obstacles``: boxes (x, y, heading, length and width in m and rad), shape (K, 5); with
      speed (m/s) and sway (m) of moving ones (K, 7);
    - ``state``: a state returned by ``get_state()``.

    ## Episode End

    *Terminated* after the last race; never truncated. A crash ends a race, not the match.

    ## Information

    The numbers of :class:`pcs_racing.envs.duel.DuelEnv` for the last race, and: ``race``, the
    number of finished races; ``race_result``, the result of the last finished race
    (:class:`pcs_racing.envs.infos.Result`); ``score`` and ``opponent_score``, races won so far.
    ``result`` is the result of the match. ``env.unwrapped.metadata["codes"]`` maps integer codes to
    labels. ``env.unwrapped.outcome()`` returns the info with labels in place of codes.

    ## Arguments

    :class:`pcs_racing.envs.match_batch.MatchOptions` and :class:`pcs_racing.game.GameConfig` list
    them; all are given by name. ``utility``, ``fault_penalty`` and ``discount`` are no arguments: a
    match has its own reward.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Match-v0", num_envs=256)`` makes a
    :class:`pcs_racing.envs.match.MatchVectorEnv`: the races of all matches in one compiled call,
    with the same numbers as this class for the same seeds.

    Examples
    --------
    >>> env = MatchEnv(opponent="never-switch")
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape, int(env.action_space.n) == len(env.game.archive)
    ((23,), True)
    """

    options_type = MatchOptions

    def __init__(self, **arguments: Unpack[MatchArguments]) -> None:
        ScalarEnv.__init__(self, **arguments)


class MatchVectorEnv(OverMatches, DuelVectorEnv):
    """Vector environment of :class:`MatchEnv`, with the same numbers for the same seeds.

    It takes the arguments of :class:`MatchEnv` and
    :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = MatchVectorEnv(4, opponent="never-switch", races=2)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 16)
    """

    options_type = MatchOptions

    def __init__(
        self,
        num_envs: int | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        **arguments: Unpack[MatchArguments],
    ) -> None:
        BatchVectorEnv.__init__(
            self,
            num_envs,
            autoreset_mode=autoreset_mode,
            max_episode_steps=max_episode_steps,
            threads=threads,
            **arguments,
        )


class SelfPlayMatchVectorEnv(MatchVectorEnv):
    """Self-play matches: environments ``2 i`` and ``2 i + 1`` are cars 0 and 1 of match ``i``.

    A policy acting in all environments plays against itself. ``reset(seed=...)`` takes one seed for
    each match. The class takes the arguments of :class:`MatchVectorEnv`; ``opponent`` must be None.

    Examples
    --------
    >>> envs = SelfPlayMatchVectorEnv(4)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 23)
    """

    options_type = TwoPlayerMatchOptions
    players = 2


class HeadToHeadMatchEnv(OverMatches, HeadToHeadEnv):
    """Match of several races between two players; both choose a policy before each race.

    ## Description

    :class:`pcs_racing.envs.match.MatchEnv` with a player for each car: both choose a policy at the
    same time, then the race is driven.

    ## Action Space

    The action space of `MatchEnv`; `info["action_mask"]` (int8) marks the valid kind of action.

    ## Observation Space

    `Box(float32)` with `races (2 G + 3) + 2` elements, 23 by default: the observation space of
    `pcs_racing/Match-v0`. `state()` is the observation of `car_0`, followed by the observation of
    `car_1`.

    ## Rewards

    The rewards of `MatchEnv`. The rewards of the two cars add up to 1 in each race, or to 0 after a
    no-contest crash.

    ## Starting State

    As in `MatchEnv`, with the same options of `reset(options=...)`.

    ## Episode End

    Both agents terminate after the last race. A crash ends a race, not the match. If `max_cycles`
    is below the number of steps, they are truncated after `max_cycles` steps.

    ## Information

    `info` of each agent holds the numbers of `MatchEnv`, seen from its own car.
    `env.metadata["codes"]` maps integer codes to labels. `env.outcome()` returns the infos with
    labels in place of codes.

    ## Arguments

    The arguments of `MatchEnv`. `max_cycles` is the number of steps after which an episode is
    truncated.

    ## Vectorized environment

    `pcs_racing.game.match.MatchGame` plays any number of matches at once, with the same rules: this
    environment is a batch of one. `gymnasium.make_vec("pcs_racing/Match-v0", num_envs=256)` is the
    single-agent view of such a batch; in `pcs_racing.envs.match.SelfPlayMatchVectorEnv` one policy
    plays both cars.
    """

    metadata: dict[str, Any] = HeadToHeadEnv.metadata | {"name": "head_to_head_match_v0"}
    options_type = TwoPlayerMatchOptions

    def __init__(
        self, *, max_cycles: int | None = None, **arguments: Unpack[MatchArguments]
    ) -> None:
        ParallelBatchEnv.__init__(self, max_cycles=max_cycles, **arguments)


parallel_env = HeadToHeadMatchEnv
"""PettingZoo's name for the constructor of a parallel environment."""


def env(
    *, max_cycles: int | None = None, **arguments: Unpack[MatchArguments]
) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment with PettingZoo's AEC interface.

    Both players choose, then a race is driven.
    """
    return parallel_to_aec(parallel_env(max_cycles=max_cycles, **arguments))
