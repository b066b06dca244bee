"""The environment of a series of races for two agents, in PettingZoo's parallel and turn-by-turn interfaces."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.head_to_head import HeadToHeadEnv
from pcs_racing.envs.match_batch import MatchBatch, MatchOptions
from pcs_racing.game.match import MatchGame


class HeadToHeadMatchEnv(HeadToHeadEnv):
    """Two players race each other several times; before each race both choose the policy that their car drives with.

    ## Description

    A match is a series of races between the same two players. Before each race both choose a policy of the archive, at
    the same time; then the race is driven. Each player observes how it drove itself and how the other one drove in the
    earlier races, and who won them. In each race the cars start on another line, and they swap their places on the
    grid. `pcs_racing.game.match` holds the rules.

    ## Action Space

    `Discrete(K)` for an archive of K policies: action `k` drives the next race with policy `k`. With `race_moves` a
    step is one step of a race (8 s), and the space is `Discrete(K + M)`: actions `K` to `K + M - 1` are the M moves of
    `pcs_racing/head_to_head-v1`, to be made while a race goes on. An action of the other kind changes nothing.
    `info["action_mask"]` (int8) says which kind is asked for.

    ## Observation Space

    `Box(float32)` with `races (2 G + 3) + 2` elements, 23 by default; that of `pcs_racing/Match-v0`. `state()` is the
    observation of `car_0` followed by that of `car_1`.

    ## Rewards

    The score of each race when it is over: 1 for a win, 1/2 for a tie, else 0. The rewards of the two cars add up to 1
    in each race, or to 0 after a crash that pays nobody.

    ## Starting State

    Start lines, the side of the first race and the noise are drawn at random. Nothing is driven before the first
    actions. `reset(options=...)` takes the options of `pcs_racing/Match-v0`.

    ## Episode End

    Both agents terminate after the last race. A crash ends a race, not the match. With `max_cycles` below the number of
    steps, they are truncated after so many steps.

    ## Information

    `info` of each agent holds the numbers of `pcs_racing/head_to_head-v1` for the race that was driven last, and `race`
    (races that are over), `race_result`, `score` and `opponent_score` (races won so far); `result` is that of the
    match. `env.metadata["codes"]` holds the words of all codes; `env.outcome()` is the infos in words.

    ## Arguments

    - `track` (`"Tarnfjord"`), `archive` (`"default"`), `race` (`"paper"`), `opponent` (`None`),
      `deterministic_opponent` (`True`), `vehicle` (`F1TENTH`), `randomize` (`None`), `obstacles` (`None`),
      `render_mode` (`None`), `view` (`"both"`), `render_size` (`(960, 640)`): as for `pcs_racing/head_to_head-v1`. What
      is drawn stays the same in all races of a match.
    - `races` (3): races of a match.
    - `race_moves` (`False`): whether the players also make the moves of the races.
    - `max_cycles` (`None`): steps after which an episode is truncated.
    - every field of `GameConfig` but `utility`, `fault_penalty` and `discount`.

    ## Vectorized environment

    `pcs_racing.game.match.MatchGame` plays any number of matches at once, with the same rules: this environment is a
    batch of one. `gymnasium.make_vec("pcs_racing/Match-v0", num_envs=256)` is the single-agent view of such a batch;
    in `pcs_racing.envs.match.SelfPlayMatchVectorEnv` one policy plays both cars.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {**HeadToHeadEnv.metadata, "name": "head_to_head_match_v0"}  # noqa: RUF012
    batch_type = MatchBatch
    batch: MatchBatch
    declared = replace(HeadToHeadEnv.declared, options=MatchOptions)

    @property
    def match(self) -> MatchGame:
        """The rules."""
        return self.batch.match


def parallel_env(**arguments: Any) -> HeadToHeadMatchEnv:
    """Make a :class:`HeadToHeadMatchEnv` (PettingZoo's parallel interface); the arguments are the class's."""
    return HeadToHeadMatchEnv(**arguments)


def env(**arguments: Any) -> AECEnv[str, NDArray[np.float32], int | None]:
    """Make the same environment in PettingZoo's turn-by-turn interface: both players choose, then a race is driven."""
    return parallel_to_aec(HeadToHeadMatchEnv(**arguments))
