"""Environments with a choice among candidates: one agent against others, or one in each car."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec

from pcs_racing.envs.drive import count_agents, count_pairs
from pcs_racing.envs.line_batch import LineBatch
from pcs_racing.envs.line_options import LineHeadToHeadOptions, LineOptions
from pcs_racing.envs.single import ParallelBatchEnv, ScalarEnv
from pcs_racing.envs.vector import BatchVectorEnv


class LineEnv(ScalarEnv):
    """Choice among the candidates of the lattice planner, ten times a second.

    ## Description

    :class:`pcs_racing.envs.drive.DriveEnv` with another action: the lattice planner lays 64
    candidates, 16 moves across the track at 4 speeds, and the agent chooses a candidate, which
    its car follows for 0.1 s. The candidates know walls and grip; the agent learns racing.
    The planner ``line-ppo`` learned here; ``CandidatePolicy`` of ``pcs_racing_agents.learning``
    begins as the lattice, and its models race anywhere. Tracks, cars, opponents, rules and
    obstacles are as in `DriveEnv`; the default rules are "contest".

    ## Action Space

    ``Discrete(64)``: candidate ``c`` has the speed ``c // 16`` and the move ``c % 16``.
    ``action_masks()`` and ``info["action_mask"]`` are 0 for a rejected candidate: its cost is
    far above the cheapest, because it meets a wall or the opponent. The cheapest, the choice of
    the lattice, replaces a rejected one, and ``info["replaced"]`` is 1.

    ## Observation Space

    A flat ``Box`` of float32 with 752 numbers of order one.
    :func:`pcs_racing.envs.line_options.split_observation` returns its parts: the context (46: own
    car, opponent, style, track ahead), 14 numbers of each move, 8 of each speed and 7 of each
    candidate. The last of these is -1 if the candidate is rejected, else it grows with the cost
    above the cheapest. The last two numbers are the share of the race that is left, and the
    handicap. ``env.unwrapped.elements`` names all.

    ## Rewards

    The reward of a step is ``progress_reward`` for every metre, and ``gain_reward`` for every metre
    gained on the foremost rival, up to a lead of 20 m. A win adds ``win_reward``, a defeat
    subtracts it, by the rules. A crash by own fault costs ``fault_penalty``, and a step near
    another car up to ``near_penalty``.

    The style sets the prices. Gain and win count .25 at assertiveness 0 to 1.5 at 1; a fault costs
    all at risk 0 and a twelfth at 1; nearness costs nothing at assertiveness 1.

    ## Starting State

    As in `DriveEnv`. A style with ranges is drawn for each race and car.

    ## Episode End

    As in `DriveEnv`. The end of the time decides the race and terminates the episode.

    ## Information

    As in `DriveEnv`, with ``action_mask`` and ``replaced``.

    ## Arguments

    :class:`pcs_racing.envs.line_options.LineOptions` lists them; all are given by name.

    ## Vectorized environment

    ``gym.make_vec("pcs_racing/Line-v0", num_envs=256)`` makes a
    :class:`pcs_racing.envs.line.LineVectorEnv`: one compiled call for all races, with the same
    numbers as this class for the same seeds.

    Examples
    --------
    >>> env = LineEnv()
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape, int(info["action_mask"].sum()) > 0
    ((752,), True)
    """

    batch_type = LineBatch
    options_type = LineOptions

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the allowed candidates, shape (64,)."""
        masks: NDArray[np.bool_] = self.batch.action_masks()[0]
        return masks


class LineVectorEnv(BatchVectorEnv):
    """Vector environment of :class:`LineEnv`, with the same numbers for the same seeds."""

    batch_type = LineBatch
    options_type = LineOptions

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the allowed candidates of each environment, shape (num_envs, 64)."""
        masks: NDArray[np.bool_] = self.batch.action_masks()
        return masks


class LineHeadToHeadEnv(ParallelBatchEnv):
    """Races of two to eight cars; each agent chooses a candidate for its car ten times a second.

    Actions, observations and rewards are as in :class:`LineEnv`, agents and opponents as in
    :class:`pcs_racing.envs.drive.DriveHeadToHeadEnv`.
    """

    metadata: dict[str, Any] = ParallelBatchEnv.metadata | {"name": "line_head_to_head_v0"}
    batch_type = LineBatch
    options_type = LineHeadToHeadOptions

    def _count_players(self, options: LineHeadToHeadOptions) -> int:
        return count_agents(options)


class LineHeadToHeadVectorEnv(LineVectorEnv):
    """Vector environment of :class:`LineHeadToHeadEnv`, for self-play.

    Environments are numbered as in :class:`pcs_racing.envs.drive.DriveHeadToHeadVectorEnv`.
    """

    options_type = LineHeadToHeadOptions
    players = 2

    def _count_players(self, options: LineHeadToHeadOptions) -> int:
        return count_pairs(options)


parallel_env = LineHeadToHeadEnv
"""PettingZoo's name for the constructor of a parallel environment."""


def env(
    *, max_cycles: int | None = None, **arguments: Any
) -> AECEnv[str, NDArray[np.float32], Any]:
    """Make the same environment with PettingZoo's AEC interface."""
    return parallel_to_aec(parallel_env(max_cycles=max_cycles, **arguments))
