"""Robust answers, made of learned responses: restricted Nash responses and policy-space response oracles.

Restricted Nash response (Johanson et al. 2007): an opponent is assumed that plays like the pool with probability p, and
otherwise as an adversary that knows the agent. The agent answers that opponent; the adversary answers the agent. Both
learn by turns (fictitious play): the adversary of round r is a best reply to the mixture of all agents so far, and the
agent of round r a response to the pool and to all adversaries so far. The strategy to play is the mixture of the
agents, in which round r has weight r. With p = 1 it is the response to the pool, which may lose much to an opponent
that knows it; with p = 0 only the adversary counts, and the agent approaches an equilibrium. Between them lies the
curve of gain against loss (``docs/reports/robust_curve.md``).

Policy-space response oracles (PSRO, Lanctot et al. 2017): each round learns a response to the equilibrium mixture of
all responses so far, and races it against them; the equilibrium of the larger game is the next mixture. The first
response is one to a pool of opponents.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from pcs_racing.base.settings import Settings, number, setting, text, whole
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Job, Workers
from pcs_racing_agents.learning.responses.learner import ResponseSettings, learn_response, load_response_settings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork
from pcs_racing_agents.tournament.fitting import MetaStrategy, TrainingRaces, fit_psro

MIXING_SEED = 6_000_000
"""Added to the settings' seed: other races than those that responses learn from."""


@dataclass(frozen=True)
class _ResponsesSettings(Settings):
    """What the settings of agents that are made of several learned responses share."""

    learner: str = setting(
        "robust", text(), "Settings of each learned response (response configuration: a name or a YAML file)."
    )
    seed: int = setting(0, whole(0, 2**40), "Seed of the games and of the networks.")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.response(0)  # an unknown learner is refused here, not after hours of work

    def response(self, number: int) -> ResponseSettings:
        """Return the settings of one of the responses, each with a seed of its own."""
        settings = load_response_settings(self.learner)
        return replace(settings, seed=settings.seed + self.seed * 64 + number)


@dataclass(frozen=True)
class RobustSettings(_ResponsesSettings):
    """Settings of a restricted Nash response."""

    pool_share: float = setting(
        0.75,
        number(0.0, 1.0),
        "Share of the games against the pool; the others are against adversaries. 1 is the response to the pool.",
    )
    rounds: int = setting(4, whole(1, 20), "Adversaries that are learned, each followed by a response.")


@dataclass(frozen=True)
class PSROSettings(_ResponsesSettings):
    """Settings of policy-space response oracles."""

    rounds: int = setting(6, whole(2, 32), "Responses that are learned.")
    races: int = setting(200, whole(2, 2000), "Races of each two responses on each circuit, for the equilibrium; even.")


def load_robust_settings(source: str | Path | RobustSettings | None = None, **changes: Any) -> RobustSettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("robust", RobustSettings(), source, **changes)


def load_psro_settings(source: str | Path | PSROSettings | None = None, **changes: Any) -> PSROSettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("psro", PSROSettings(), source, **changes)


def learn_robust(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    setting: Setting,
    settings: RobustSettings,
    job: Job,
    *,
    name: str = "robust",
    part: str = "",
    **workers: Unpack[Workers],
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
    learn = partial(learn_response, games, setting=setting, job=job, **workers)

    def respond(opponents: Sequence[Competitor], shares: Sequence[float], number: int, label: str) -> RegretNetwork:
        learner = settings.response(number)
        return learn(opponents, settings=learner, shares=shares, name=f"{name}-{label}", part=f"{part}{label}-")

    p, facts = settings.pool_share, {"pool_share": settings.pool_share, "seed": settings.seed}
    evenly = np.full(len(pool), 1.0 / max(len(pool), 1))
    responses = [respond(pool, evenly.tolist(), 0, "response-0")]
    if p == 1.0:
        return NetworkSet(name, tuple(responses), np.ones(1), "argmax", {**facts, "rounds": 0})
    adversaries: list[Agent] = []
    for round_ in range(1, settings.rounds + 1):
        agents = [network_agent(network, setting, settings.seed) for network in responses]
        # The first response begins the play; the mixture to reply to is that which is played in the end.
        weights = [1.0] if round_ == 1 else [0.0, *map(float, range(1, round_))]
        reply = respond(agents, weights, 2 * round_ - 1, f"adversary-{round_}")
        adversaries.append(network_agent(reply, setting, settings.seed))
        shares = [*(p * evenly), *np.full(round_, (1.0 - p) / round_)]
        responses.append(respond([*pool, *adversaries], shares, 2 * round_, f"response-{round_}"))
    # Round r was learned against the adversaries of all rounds so far: later rounds are better, and weigh more.
    played = responses[1:]
    return NetworkSet(
        name, tuple(played), np.arange(1.0, len(played) + 1.0), "argmax", {**facts, "rounds": settings.rounds}
    )


def learn_psro(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    setting: Setting,
    settings: PSROSettings,
    job: Job,
    *,
    name: str = "psro",
    **workers: Unpack[Workers],
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
    for round_ in range(settings.rounds):
        network = learn_response(
            games,
            opponents,
            setting,
            settings.response(round_),
            job,
            shares=weights.tolist(),
            name=f"{name}-{round_}",
            part=f"response-{round_}-",
            **workers,
        )
        networks.append(network)
        members.append(network_agent(network, setting, settings.seed))
        # A single response is its own equilibrium; what is known of earlier ones is not raced again.
        if round_ > 0:
            meta = fit_psro(training, members, known=meta, job=job, **workers)
        opponents, weights = members, np.ones(1) if meta is None else meta.weights
    played = np.flatnonzero(weights > 0.0)
    facts = {"rounds": settings.rounds, "races": settings.races, "seed": settings.seed}
    return NetworkSet(name, tuple(networks[int(i)] for i in played), weights[played], "argmax", facts)
