"""Policy-space response oracles (PSRO, Lanctot et al. 2017) with learned responses.

Each round learns a response to the equilibrium mixture of all earlier responses, and races it
against them. The equilibrium of the extended game is the next mixture. The first response is
learned against a pool of opponents.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from annotated_types import Interval

from pcs_racing.base.settings import Settings, Text
from pcs_racing.game.players import Competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Job, Workers
from pcs_racing_agents.learning.responses import (
    ResponseSettings,
    learn_response,
    load_response_settings,
)
from pcs_racing_agents.networks import NetworkSet, RegretNetwork
from pcs_racing_agents.tournament.fitting import MetaStrategy, TrainingRaces, fit_psro

MIXING_SEED = 6_000_000
"""Offset of the settings' seed, so that these races differ from the responses' training games."""


@dataclass(frozen=True)
class PSROSettings(Settings):
    """Settings of policy-space response oracles (PSRO)."""

    rounds: Annotated[int, Interval(ge=2, le=32), "Responses that are learned."] = 6
    races: Annotated[
        int,
        Interval(ge=2, le=2000),
        "Races of each two responses on each circuit, for the equilibrium; even.",
    ] = 200
    learner: Annotated[
        Text,
        "Settings of each learned response (response configuration: a name or a YAML file).",
    ] = "psro"
    seed: Annotated[int, Interval(ge=0, le=2**40), "Seed of the games and of the networks."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.response(0)  # refuse an unknown learner before any training

    def response(self, number: int) -> ResponseSettings:
        """Return the settings of one response, with its own seed."""
        settings = load_response_settings(self.learner)
        return replace(settings, seed=settings.seed + self.seed * 64 + number)


def load_psro_settings(
    source: str | Path | PSROSettings | None = None, **changes: Any
) -> PSROSettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("psro", PSROSettings(), source, **changes)


def learn_psro(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    spec: GameSpec,
    settings: PSROSettings,
    job: Job,
    *,
    name: str = "psro",
    **workers: Unpack[Workers],
) -> NetworkSet:
    """Learn responses to the equilibrium mixture of earlier responses, in several rounds.

    Parameters
    ----------
    games, spec
        As for :func:`pcs_racing_agents.learning.responses.learn_response`.
    pool : sequence of Competitor
        Opponents of the first response.

    Returns
    -------
    NetworkSet
        Responses in the support of the equilibrium, with their probabilities.
    """
    networks: list[RegretNetwork] = []
    members: list[Agent] = []
    opponents: Sequence[Competitor] = pool
    weights = np.full(len(pool), 1.0 / max(len(pool), 1))
    meta: MetaStrategy | None = None
    training = TrainingRaces(
        tuple(game.track for game in games),
        tuple(pool),
        spec,
        settings.races,
        settings.seed + MIXING_SEED,
    )
    for round_ in range(settings.rounds):
        network = learn_response(
            games,
            opponents,
            spec,
            settings.response(round_),
            job,
            shares=weights.tolist(),
            name=f"{name}-{round_}",
            part=f"response-{round_}-",
            **workers,
        )
        networks.append(network)
        members.append(network_agent(network, spec, settings.seed))
        # A single response is its own equilibrium. Payoffs of earlier rounds are reused.
        if round_ > 0:
            meta = fit_psro(training, members, known=meta, job=job, **workers)
        opponents, weights = members, np.ones(1) if meta is None else meta.weights
    played = np.flatnonzero(weights > 0.0)
    facts = {"rounds": settings.rounds, "races": settings.races, "seed": settings.seed}
    return NetworkSet(
        name, tuple(networks[int(i)] for i in played), weights[played], "argmax", facts
    )
