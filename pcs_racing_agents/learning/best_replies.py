"""Loss to a learned best response: the result of an opponent trained against a single agent.

This is the approximate best response of Timbers et al. (2020): a response is learned from scratch
against the agent, and then races the agent with test start lines and test noise. Its result is a
lower bound of a perfect opponent's result: a loss is always reported with the learner's budget.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import check_whole
from pcs_racing.game.players import Competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing.race.config import Rules
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.base.jobs import Job, Workers
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.learning.responses import ResponseSettings, learn_response
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament.pairings import cross_pairing, play_pairings
from pcs_racing_agents.tournament.races import RaceTable, concatenate_races, series_of

LINES = 5
"""Start lines of each pair of variants, each raced from both sides."""
MIN_RACES = 2 * 2 * 2 * LINES
"""Minimum number of races on a track: two variants of each car, all lines, both sides."""
RACE_SEED = 9_000_000
"""Offset of the settings' seed, so that start policies, lines and noise differ from training."""


class BestReply(NamedTuple):
    """Learned best response to an agent, with its races."""

    network: RegretNetwork  #: Network of the response, predicting the values of its moves.
    races: RaceTable  #: Races of the response (ego) against the agent (opponent).
    #: Loss of the agent in races won: half of (response's wins minus agent's wins), from -0.5 to
    #: 0.5. If every race has a winner, it is the response's share of wins minus one half.
    loss: Estimate


def best_reply(
    games: Sequence[RaceGame],
    agent: Competitor,
    spec: RaceGame,
    settings: ResponseSettings,
    job: Job,
    *,
    races: int = 4000,
    name: str = "best-reply",
    **workers: Unpack[Workers],
) -> BestReply:
    """Learn a best response to an agent, and estimate the agent's loss in test races.

    Parameters
    ----------
    games : sequence of RaceGame
        Games with equal archive and rules, one on each track. The response is one network for all.
    settings : ResponseSettings
        Budget and seed of the learner.
    job : Job
        Job that stores branches, networks and races. Its settings must identify the agent
        (:func:`pcs_racing_agents.agents.agent.competitor_hash`).
    races : int
        Approximate number of races on all tracks together; at least 40 on each.
    name : str
        Name of the response's networks.
    """
    check_races(races, len(games))
    reply = learn_response(games, [agent], spec, settings, job, name=name, part="reply-", **workers)
    pilot = network_agent(reply, spec, settings.seed)
    # Crossed: every start policy of one car meets every start policy of the other car, from all
    # lines and both sides.
    count = max(2, round(math.sqrt(races / len(games) / (2 * LINES))))
    seed = settings.seed + RACE_SEED
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    # Both cars have the same start policies: an agent against itself wins as often as it loses.
    policies = np.sort(rng.permutation(len(games[0].archive))[:count]).tolist()
    opponents = count if isinstance(agent, PolicySet) else policies
    pairings = [
        cross_pairing(
            game, pilot, agent, egos=policies, opponents=opponents, lines=LINES, seed=seed + i
        )
        for i, game in enumerate(games)
    ]
    table = concatenate_races(play_pairings(pairings, name="races", job=job, **workers))
    return BestReply(reply, table, excess_estimate(series_of(table, games[0].rules)))


def check_races(races: int, tracks: int) -> int:
    """Check the number of races on all tracks together."""
    return check_whole("races", races, MIN_RACES * tracks)


def excess_estimate(races: RaceTable) -> Estimate:
    """Return half of (ego's wins minus opponent's wins) as a share of the races.

    The interval is cluster-robust. Races with a common start policy, planner policy or start line
    form clusters.
    """
    ego, opponent = races.variants.T.astype(np.int64)
    place = np.stack([races.track.codes.astype(np.float64), races.start_s.round(4)], axis=1)
    line = np.unique(place, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    excess = 0.5 * ((races.winner == 0).astype(np.float64) - (races.winner == 1))
    if len(np.unique(opponent)) == 1:  # a planner with a single policy
        return clustered_mean(excess, ego, line)
    one_pool = bool((races.path[:, :, 0] >= 0).all())  # both cars start with archive policies
    if one_pool:
        excess = _without_policies(excess, races.track.codes.astype(np.int64), ego, opponent)
    return clustered_mean(excess, ego, opponent, line, same_pool=one_pool)


def _without_policies(
    excess: NDArray[np.float64],
    track: NDArray[np.int64],
    ego: NDArray[np.int64],
    opponent: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the excess of races without the effect of the two start policies.

    If policy i as ego met policy j as opponent and vice versa, half of the difference of the two
    means is the advantage of the stronger policy, for either car. It has opposite signs in the two
    directions: its subtraction leaves the mean unchanged and removes variance balanced by the
    design.
    """
    size = int(max(ego.max(), opponent.max())) + 1
    cells = (track * size + ego) * size + opponent
    mirrored = (track * size + opponent) * size + ego
    count = np.bincount(cells, minlength=int(max(cells.max(), mirrored.max())) + 1)
    mean = np.bincount(cells, excess, len(count)) / np.maximum(count, 1)
    balanced = count[cells] == count[mirrored]
    return excess - np.where(balanced, 0.5 * (mean[cells] - mean[mirrored]), 0.0)


REPLY_NOTE = """loss: half of the reply's wins minus the agent's wins, as a share of the races;
0.1 means that the reply won 60 of 100 races. It is a lower bound: a learner with a larger budget
may find a better reply. The interval is robust to clusters of start policies and start lines."""


LOSS_COLUMNS = (
    *("agent", "track", "loss", "low", "high", "se", "df", "races"),
    *("reply_won", "agent_won", "agent_own_crash"),
)
"""Columns of the table of losses: the loss with its 95 % interval, standard error and degrees of
freedom, and shares of the races."""


def loss_table(agent: str, reply: BestReply, rules: Rules) -> list[tuple[str, ...]]:
    """Return the table of an agent's loss as texts: a line for each track, and for all tracks."""
    words, codes = reply.races.track
    parts = [(word, reply.races.take(codes == code)) for code, word in enumerate(words)]
    rows: list[tuple[str, ...]] = [LOSS_COLUMNS]
    for track, races in parts if len(parts) == 1 else [*parts, ("all", reply.races)]:
        scored = series_of(races, rules)
        loss = excess_estimate(scored)
        shares = (scored.winner == 0, scored.winner == 1, races.fault[:, 1] > 0)
        numbers = (f"{value:.4f}" for value in (loss.mean, loss.low, loss.high, loss.se))
        won = (f"{np.mean(share):.4f}" for share in shares)
        rows.append((agent, track, *numbers, str(loss.df), str(loss.units), *won))
    return rows
