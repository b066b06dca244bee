"""Policy-space response oracles (PSRO, Lanctot et al. 2017) by learned responses.

Each round learns a response to the equilibrium mixture of all responses so far, and races it against them; the
equilibrium of the larger game is the next mixture. The first response is one to a pool of opponents.
"""

from collections.abc import Sequence
from concurrent.futures import Executor

from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.from_network import NetworkStrategy
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.jobs import Job, Progress
from pcs_racing_agents.learning.responses.learner import learn_response
from pcs_racing_agents.learning.robust.settings import PSROSettings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork
from pcs_racing_agents.tournament.fitting import MetaStrategy, TrainingRaces, fit_psro

__all__ = ["learn_psro"]

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
    settings : PSROSettings
    job : Job
        Stores branches, networks and races, so that a stopped run can be resumed.
    name : str
        Of the set of networks.
    executor : Executor, optional
    progress : callable, optional

    Returns
    -------
    NetworkSet
        The responses that the equilibrium plays, with their probabilities.

    Raises
    ------
    InputError
        If there is no game or no opponent, or the games differ in archive, moves or rules.
    """
    networks: list[RegretNetwork] = []
    members: list[Agent] = []
    meta: MetaStrategy | None = None
    for number in range(settings.rounds):
        opponents: Sequence[Competitor] = members if members else pool
        network = learn_response(
            games,
            opponents,
            setting,
            settings.response(number),
            job,
            shares=[1.0 / len(pool)] * len(pool) if meta is None and not members else _weights(meta),
            name=f"{name}-{number}",
            part=f"response-{number}-",
            executor=executor,
            progress=progress,
        )
        networks.append(network)
        strategy = NetworkStrategy(network, "argmax", len(setting.moves))
        members.append(Agent(network.name, strategy, setting, settings.seed))
        if number == 0:
            continue
        training = TrainingRaces(
            tuple(game.track for game in games),
            tuple(pool),
            setting,
            races=settings.races,
            seed=settings.seed + MIXING_SEED,
        )
        meta = fit_psro(training, members, known=meta, job=job, executor=executor, progress=progress)
    weights = _weights(meta)
    played = [i for i, weight in enumerate(weights) if weight > 0.0]
    facts = {"rounds": settings.rounds, "races": settings.races, "seed": settings.seed}
    return NetworkSet(name, tuple(networks[i] for i in played), meta.weights[played], "argmax", facts)  # type: ignore[union-attr]


def _weights(meta: MetaStrategy | None) -> list[float]:
    return [1.0] if meta is None else [float(weight) for weight in meta.weights]
