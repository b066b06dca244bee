"""The environment of a series of races: a policy for each race, and what was seen before; for one agent or two."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.duel import AXES, DuelEnv, DuelVectorEnv, HeadToHeadEnv, OverGames
from pcs_racing.envs.match_batch import UNUSED, MatchBatch, MatchOptions
from pcs_racing.game.match import MatchGame
from pcs_racing.game.observation import match_elements, observation_table


class OverMatches(OverGames):
    """What environments of matches have in common."""

    batch_type = MatchBatch
    batch: MatchBatch

    @property
    def match(self) -> MatchGame:
        """The rules; ``game`` holds those of the races."""
        return self.batch.match


class MatchEnv(OverMatches, DuelEnv, observation_table=observation_table(match_elements(AXES, MatchOptions().races))):
    """Play a match: several races against the same opponent, with a policy to choose before each of them.

    ## Description

    A match is a series of races against the same opponent, which is drawn for the match. Before each race the player
    of car 0 chooses the policy of the archive that its car drives with; it knows how both cars drove in the earlier
    races, and who won them. In each race the cars start on another line, and they swap their places on the grid. The
    rules are in :mod:`pcs_racing.game.match`.

    ## Action Space

    ``Discrete(K)`` for an archive of K policies: action ``k`` drives the next race with policy ``k``. Every policy can
    be chosen before every race, because knowing the opponent helps most before the start; and by its index, because
    policies that lie close together in the Policy Characteristic Space may race differently. With ``race_moves`` a
    step is one step of a race (8 s), and the space is ``Discrete(K + M)``: actions ``K`` to ``K + M - 1`` are the M
    moves of :class:`pcs_racing.envs.duel.DuelEnv`, to be made while a race goes on. An action of the other kind changes
    nothing: a move between two races keeps the policy of the last start, a policy in a race keeps the policy.
    ``action_masks()`` and ``info["action_mask"]`` say which kind is asked for.

    ## Observation Space

    ``Box(float32)`` with ``races (2 G + 3) + 2`` elements for G characteristics, 23 by default;
    ``env.unwrapped.elements`` holds name, unit, bounds and meaning of each. Races count from 0. "Range" means that 0 is
    the archive's smallest and 1 its largest value. Of races to come all numbers are 0.

    {observation_table}

    After a crash a race lasted less than its duration. With ``race_moves`` there follow ``racing``, 1 while a race goes
    on, and the observation of :class:`pcs_racing.envs.duel.DuelEnv` in that race, 0 between races.

    ## Rewards

    The score of each race when it is over: 1 for a win, 1/2 for a tie, else 0. Their sum is the number of races won.

    ## Starting State

    The opponent, start lines, the side of the first race, the noise and the policy of an opponent that does not choose
    are drawn from the environment's generator. Nothing is driven before the first action.

    ``reset(options=...)`` takes ``policies`` (two indices of the archive: what the cars start the races with if their
    players do not choose; -1 draws one), ``start`` (arc length of the line of all races in m, and side of the first
    race: 0 puts car 0 on the left or in front), ``obstacles`` (boxes: x, y, heading, length and width in m and rad,
    shape (K, 5)), ``opponent`` and ``track``, which replace the arguments from then on, and ``state``, what
    ``get_state()`` returned. Others are refused.

    ## Episode End

    *Terminated* after the last race; never truncated. A crash ends a race, not the match.

    ## Information

    The numbers of :class:`pcs_racing.envs.duel.DuelEnv`, of the race that was driven last, and: ``race``, races that
    are over; ``race_result``, how the last one ended (:class:`pcs_racing.envs.infos.Result`); ``score`` and
    ``opponent_score``, races won so far. ``result`` is that of the match. ``env.unwrapped.metadata["codes"]`` holds the
    words of all codes; ``env.unwrapped.outcome()`` is the info in words.

    ## Arguments

    {arguments}

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Match-v0", num_envs=256)`` gives :class:`pcs_racing.envs.match.MatchVectorEnv`: the races
    of all matches in one compiled call, and the same numbers as this class gives with the same seeds.

    Examples
    --------
    >>> env = MatchEnv(opponent="never-switch")
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape, int(env.action_space.n) == len(env.game.archive)
    ((23,), True)
    """

    declared = replace(DuelEnv.declared, options=MatchOptions, without=UNUSED)


class MatchVectorEnv(OverMatches, DuelVectorEnv):
    """Many :class:`MatchEnv` in one, with the same numbers for the same seeds.

    The arguments are those of :class:`MatchEnv` and of :class:`pcs_racing.envs.vector.BatchVectorEnv`.

    Examples
    --------
    >>> envs = MatchVectorEnv(4, opponent="never-switch", races=2)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 16)
    """

    declared = replace(MatchEnv.declared, positional=())


class SelfPlayMatchVectorEnv(MatchVectorEnv):
    """Matches in which both cars belong to the agent: environment ``2 i`` is car 0 of match ``i``, ``2 i + 1`` car 1.

    One policy that acts in all environments plays against itself. Seeds belong to matches: ``reset(seed=...)`` takes
    one for each match. The arguments are those of :class:`MatchVectorEnv`, without ``opponent``.

    Examples
    --------
    >>> envs = SelfPlayMatchVectorEnv(4)
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 23)
    """

    declared = replace(MatchVectorEnv.declared, changed={"opponent": None})
    players = 2


class HeadToHeadMatchEnv(OverMatches, HeadToHeadEnv):
    """Two players race each other several times; before each race both choose the policy that their car drives with.

    ## Description

    :class:`pcs_racing.envs.match.MatchEnv` with a player for each car: both choose a policy at the same time, then the
    race is driven.

    ## Action Space

    That of `MatchEnv`; `info["action_mask"]` (int8) says which kind of action is asked for.

    ## Observation Space

    `Box(float32)` with `races (2 G + 3) + 2` elements, 23 by default; that of `pcs_racing/Match-v0`. `state()` is the
    observation of `car_0` followed by that of `car_1`.

    ## Rewards

    Those of `MatchEnv`. The two cars' add up to 1 in each race, or to 0 after a no-contest crash.

    ## Starting State

    As in `MatchEnv`, and so are the options of `reset(options=...)`.

    ## Episode End

    Both agents terminate after the last race. A crash ends a race, not the match. With `max_cycles` below the number of
    steps, they are truncated after so many steps.

    ## Information

    `info` of each agent holds the numbers of `MatchEnv`, seen from its own car. `env.metadata["codes"]` holds the words
    of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    {arguments}

    ## Vectorized environment

    `pcs_racing.game.match.MatchGame` plays any number of matches at once, with the same rules: this environment is a
    batch of one. `gymnasium.make_vec("pcs_racing/Match-v0", num_envs=256)` is the single-agent view of such a batch;
    in `pcs_racing.envs.match.SelfPlayMatchVectorEnv` one policy plays both cars.
    """

    metadata: dict[str, Any] = {**HeadToHeadEnv.metadata, "name": "head_to_head_match_v0"}  # noqa: RUF012
    declared = replace(HeadToHeadEnv.declared, options=MatchOptions, without=UNUSED)


parallel_env = HeadToHeadMatchEnv
"""PettingZoo's name for what makes an environment of its parallel interface."""


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both players choose, then a race is driven."""
    return parallel_to_aec(parallel_env(**arguments))
