"""Restricted Nash response (Johanson et al. 2007) by learned responses.

An opponent is assumed that plays like the pool with probability p, and otherwise as an adversary that knows the agent.
The agent answers that opponent; the adversary answers the agent. Both learn by turns (fictitious play): the adversary
of round r is a best reply to the mixture of all agents so far, and the agent of round r a response to the pool and to
all adversaries so far. The strategy to play is the mixture of the agents, in which round r has weight r.

With p = 1 it is the response to the pool, which may lose much to an opponent that knows it; with p = 0 only the
adversary counts, and the agent approaches an equilibrium. Between them lies the curve of gain against loss
(``docs/reports/robust_curve.md``).
"""

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.from_network import NetworkStrategy
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.learning.responses.learner import ResponseSettings, learn_response
from pcs_racing_agents.learning.robust.settings import RobustSettings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork


def learn_robust(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    setting: Setting,
    settings: RobustSettings,
    job: Job,
    *,
    name: str = "robust",
    part: str = "",
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> NetworkSet:
    """Learn a restricted Nash response to a pool of opponents.

    Parameters
    ----------
    games : sequence of RaceGame
        One on each circuit, all of one archive and one set of rules.
    pool : sequence of Competitor
        Opponents, all met equally often.
    part : str
        Beginning of the names of this work in the job.

    Returns
    -------
    NetworkSet
        A network for each round after the first response, with its weight; with ``pool_share`` 1 the response alone.
    """

    def respond(
        opponents: Sequence[Competitor], shares: Sequence[float], learner: ResponseSettings, label: str
    ) -> RegretNetwork:
        return learn_response(
            games,
            opponents,
            setting,
            learner,
            job,
            shares=shares,
            name=f"{name}-{label}",
            part=f"{part}{label}-",
            executor=executor,
            progress=progress,
        )

    def player(network: RegretNetwork) -> Agent:
        return Agent(network.name, NetworkStrategy(network, "argmax", len(setting.moves)), setting, settings.seed)

    p, facts = settings.pool_share, {"pool_share": settings.pool_share, "seed": settings.seed}
    evenly = np.full(len(pool), 1.0 / max(len(pool), 1))
    responses = [respond(pool, evenly.tolist(), settings.response(0), "response-0")]
    if p == 1.0:
        return NetworkSet(name, tuple(responses), np.ones(1), "argmax", {**facts, "rounds": 0})
    adversaries: list[Agent] = []
    for number in range(1, settings.rounds + 1):
        agents = [player(network) for network in responses]
        # The first response begins the play; the mixture to reply to is that which is played in the end.
        weights = [1.0] if number == 1 else [0.0, *map(float, range(1, number))]
        reply = respond(agents, weights, settings.response(2 * number - 1), f"adversary-{number}")
        adversaries.append(player(reply))
        shares = [*(p * evenly), *np.full(number, (1.0 - p) / number)]
        responses.append(respond([*pool, *adversaries], shares, settings.response(2 * number), f"response-{number}"))
    played = responses[1:]
    return NetworkSet(
        name, tuple(played), np.arange(1.0, len(played) + 1.0), "argmax", {**facts, "rounds": settings.rounds}
    )
