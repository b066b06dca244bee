"""Policy-space response oracles (PSRO, Lanctot et al. 2017) by learned responses.

Each round learns a response to the equilibrium mixture of all responses so far, and races it against them; the
equilibrium of the larger game is the next mixture. The first response is one to a pool of opponents.
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
from pcs_racing_agents.learning.responses.learner import learn_response
from pcs_racing_agents.learning.robust.settings import PSROSettings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork
from pcs_racing_agents.tournament.fitting import MetaStrategy, TrainingRaces, fit_psro

MIXING_SEED = 6_000_000
"""Added to the settings' seed: other races than those that responses learn from."""


def learn_psro(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    setting: Setting,
    settings: PSROSettings,
    job: Job,
    *,
    name: str = "psro",
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> NetworkSet:
    """Learn responses to the equilibrium mixture of responses, round after round.

    Parameters
    ----------
    games, setting
        As for :func:`pcs_racing_agents.learning.responses.learn_response`.
    pool : sequence of Competitor
        Opponents of the first response.

    Returns
    -------
    NetworkSet
        The responses that the equilibrium plays, with their probabilities.
    """
    networks: list[RegretNetwork] = []
    members: list[Agent] = []
    opponents: Sequence[Competitor] = pool
    weights = np.full(len(pool), 1.0 / max(len(pool), 1))
    meta: MetaStrategy | None = None
    training = TrainingRaces(
        tuple(game.track for game in games), tuple(pool), setting, settings.races, settings.seed + MIXING_SEED
    )
    for number in range(settings.rounds):
        network = learn_response(
            games,
            opponents,
            setting,
            settings.response(number),
            job,
            shares=weights.tolist(),
            name=f"{name}-{number}",
            part=f"response-{number}-",
            executor=executor,
            progress=progress,
        )
        networks.append(network)
        strategy = NetworkStrategy(network, "argmax", len(setting.moves))
        members.append(Agent(network.name, strategy, setting, settings.seed))
        if number > 0:
            meta = fit_psro(training, members, known=meta, job=job, executor=executor, progress=progress)
        opponents, weights = members, np.ones(1) if meta is None else meta.weights
    played = np.flatnonzero(weights > 0.0)
    facts = {"rounds": settings.rounds, "races": settings.races, "seed": settings.seed}
    return NetworkSet(name, tuple(networks[int(i)] for i in played), weights[played], "argmax", facts)
